//! Examples of lenses, which the core's tests use, too.

use mvtop_geometry::{Intrinsics, Projection};

pub fn brown_conrady(params: &[f64]) -> Projection {
    Projection::from_params("pinhole", Some("brown_conrady"), params).unwrap()
}

pub fn kannala_brandt(params: &[f64]) -> Projection {
    Projection::from_params("fisheye", Some("kannala_brandt"), params).unwrap()
}

/// One lens of each kind, for images of 640 x 480 px that they cover to the corners.
pub fn lenses() -> Vec<Intrinsics> {
    [
        (600.0, Projection::Pinhole),
        (600.0, brown_conrady(&[])),
        (700.0, brown_conrady(&[-0.21, 0.07, 1.1e-3, -6e-4])),
        (
            600.0,
            brown_conrady(&[0.0885, -0.226, -1.5e-4, 5.7e-4, 0.11]),
        ),
        (
            500.0,
            brown_conrady(&[0.62, -2.41, 7e-4, -2.3e-4, 1.39, 0.49, -2.22, 1.31]),
        ),
        (
            600.0, // a thin prism
            brown_conrady(&[
                -0.2, 0.07, 1e-3, -6e-4, 0.0, 0.0, 0.0, 0.01, 4e-3, -1e-3, 2e-3, 3e-3,
            ]),
        ),
        (
            600.0, // and a tilted sensor
            brown_conrady(&[
                -0.2, 0.07, 1e-3, -6e-4, 0.0, 0.0, 0.0, 0.01, 4e-3, -1e-3, 2e-3, 3e-3, 0.03, -0.05,
            ]),
        ),
        (278.0, kannala_brandt(&[-0.006, 0.016, -0.024, 0.0155])),
        (150.0, kannala_brandt(&[0.0; 4])), // its corners look behind the camera
    ]
    .map(|(focal, projection)| {
        Intrinsics::new(focal, 1.01 * focal, 318.2, 243.9, projection).unwrap()
    })
    .to_vec()
}

pub fn pinhole(focal: f64, cx: f64, cy: f64) -> Intrinsics {
    Intrinsics::new(focal, focal, cx, cy, Projection::Pinhole).unwrap()
}
