//! Lenses that rig files have no name for: how far the fitted ones are off, measured anew.

use mvtop_geometry::Camera;
use mvtop_import::{Imported, Options};
use nalgebra::{Point3, Vector3};

use crate::read;

fn kalibr(model: &str, intrinsics: &str, distortion: &str) -> Imported {
    let text = format!(
        "cam0:\n  camera_model: {model}\n  distortion_model: {distortion}\n  intrinsics: {intrinsics}\n  \
         resolution: [640, 480]\n"
    );
    read(&[("cam.yaml", &text)], &Options::default()).unwrap()
}

/// Largest error, px, of a lens at points whose images are known.
fn worst(camera: &Camera, image: impl Fn(Vector3<f64>) -> [f64; 2]) -> f64 {
    let mut worst: f64 = 0.0;
    for u in (0..640).step_by(7) {
        for v in (0..480).step_by(7) {
            let pixel = nalgebra::Point2::new(f64::from(u), f64::from(v));
            let ray = camera.intrinsics().unproject(&pixel).unwrap();
            let [x, y] = image(ray.into_inner());
            worst = worst.max((x - pixel.x).hypot(y - pixel.y));
        }
    }
    worst
}

#[test]
fn double_sphere_eucm_and_omni_are_fitted() {
    let imported = kalibr(
        "ds",
        "[-0.2, 0.55, 300, 301, 321, 239]",
        "none\n  distortion_coeffs: []",
    );
    // Usenko et al., equations 40 to 45.
    let error = worst(&imported.rig.cameras()[0], |p| {
        let (xi, alpha) = (-0.2, 0.55);
        let d1 = p.norm();
        let d2 = Vector3::new(p.x, p.y, xi * d1 + p.z).norm();
        let under = alpha * d2 + (1.0 - alpha) * (xi * d1 + p.z);
        [300.0 * p.x / under + 321.0, 301.0 * p.y / under + 239.0]
    });
    assert!(error < 0.01, "{error} px: {:?}", imported.notes);
    let imported = kalibr(
        "eucm",
        "[0.6, 1.1, 300, 301, 321, 239]",
        "none\n  distortion_coeffs: []",
    );
    let error = worst(&imported.rig.cameras()[0], |p| {
        let d = (1.1 * (p.x * p.x + p.y * p.y) + p.z * p.z).sqrt();
        let under = 0.6 * d + 0.4 * p.z;
        [300.0 * p.x / under + 321.0, 301.0 * p.y / under + 239.0]
    });
    assert!(error < 0.01, "{error} px: {:?}", imported.notes);
    let radtan = "radtan\n  distortion_coeffs: [-0.1, 0.01, 0.0002, -0.0001]";
    let imported = kalibr("omni", "[0.9, 600, 601, 321, 239]", radtan);
    let error = worst(&imported.rig.cameras()[0], |p| {
        let p = p.normalize();
        let (x, y) = (p.x / (p.z + 0.9), p.y / (p.z + 0.9));
        let r2 = x * x + y * y;
        let g = 1.0 - 0.1 * r2 + 0.01 * r2 * r2;
        let (p1, p2) = (0.0002, -0.0001);
        [
            600.0 * (g * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + 321.0,
            601.0 * (g * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + 239.0,
        ]
    });
    // Decentering on the sphere's plane is not quite that on a pinhole's.
    assert!(error < 0.06, "{error} px: {:?}", imported.notes);
}

#[test]
fn fov_is_fitted() {
    let imported = kalibr(
        "pinhole",
        "[400, 400, 320, 240]",
        "fov\n  distortion_coeffs: [0.9]",
    );
    let error = worst(&imported.rig.cameras()[0], |p| {
        let r = p.x.hypot(p.y) / p.z;
        let g = if r == 0.0 {
            0.0
        } else {
            (2.0 * r * 0.45f64.tan()).atan() / 0.9 / r
        };
        [400.0 * g * p.x / p.z + 320.0, 400.0 * g * p.y / p.z + 240.0]
    });
    assert!(error < 0.001, "{error} px: {:?}", imported.notes);
    assert!(
        imported
            .notes
            .iter()
            .any(|note| note.contains("FOV") && note.contains(" px"))
    );
}

fn halcon(lens: &str) -> Imported {
    let text = format!(
        "Focus:foc: 0.008;\n{lens}\nSx:sx: 1.0e-05;\nSy:sy: 1.1e-05;\nCx:cx: 318;\nCy:cy: 243;\nImageWidth:imgw: \
         640;\nImageHeight:imgh: 480;\n"
    );
    read(&[("cam.dat", &text)], &Options::default()).unwrap()
}

#[test]
fn halcon_s_models_take_distortion_out_of_metres_on_the_sensor() {
    // The ray through a pixel, which HALCON's models state in closed form.
    let off = |imported: &Imported, straight: &dyn Fn(f64, f64) -> [f64; 2]| {
        let lens = imported.rig.cameras()[0].intrinsics();
        let mut worst: f64 = 0.0;
        for u in (0..640).step_by(9) {
            for v in (0..480).step_by(9) {
                let [u, v] = [f64::from(u), f64::from(v)];
                let [x, y] = straight((u - 318.0) * 1.0e-5, (v - 243.0) * 1.1e-5);
                let pixel = lens.project(&Point3::new(x, y, 0.008)).unwrap();
                worst = worst.max((pixel.x - u).hypot(pixel.y - v));
            }
        }
        worst
    };
    let division = halcon("Kappa:kappa: -2250.5;");
    let error = off(&division, &|x, y| {
        let under = 1.0 - 2250.5 * (x * x + y * y);
        [x / under, y / under]
    });
    assert!(error < 0.001, "{error} px: {:?}", division.notes);
    let polynomial = halcon(
        "Poly1:poly1: 1500;\nPoly2:poly2: 2.0e7;\nPoly3:poly3: 0;\nPoly4:poly4: 0.03;\nPoly5:poly5: -0.02;",
    );
    let error = off(&polynomial, &|x, y| {
        let r2 = x * x + y * y;
        let g = 1.0 + 1500.0 * r2 + 2.0e7 * r2 * r2;
        let (p1, p2) = (0.03, -0.02);
        [
            x * g + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y,
            y * g + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y,
        ]
    });
    assert!(error < 0.01, "{error} px: {:?}", polynomial.notes);
}
