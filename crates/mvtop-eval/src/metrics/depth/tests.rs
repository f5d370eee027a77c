use super::*;
use approx::assert_abs_diff_eq;
use mvtop_core::Projection;
use nalgebra::{Point3, Translation3, UnitQuaternion};
use proptest::prelude::*;

const SIZE: [u32; 2] = [64, 48];

fn intrinsics() -> Intrinsics {
    Intrinsics::new(50.0, 60.0, 31.0, 24.0, Projection::Pinhole).unwrap()
}

/// The square from (-half, -half) to (half, half) in the plane z = 0.
fn square(half: f64) -> Mesh {
    let corner = |x: f64, y: f64| Point3::new(x * half, y * half, 0.0);
    let vertices = vec![
        corner(-1., -1.),
        corner(1., -1.),
        corner(1., 1.),
        corner(-1., 1.),
    ];
    Mesh::new(vertices, Vec::new(), vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// A sphere of that radius, in steps of a few degrees.
fn sphere(radius: f64) -> Mesh {
    let (rings, sectors) = (90_u32, 180_u32);
    let mut vertices = Vec::new();
    for ring in 0..=rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        for sector in 0..sectors {
            let around = std::f64::consts::TAU * f64::from(sector) / f64::from(sectors);
            let across = radius * polar.sin();
            let z = radius * polar.cos();
            vertices.push(Point3::new(across * around.cos(), across * around.sin(), z));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for sector in 0..sectors {
            let at = |r: u32, s: u32| r * sectors + s % sectors;
            let (a, b) = (at(ring, sector), at(ring, sector + 1));
            let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    Mesh::new(vertices, Vec::new(), triangles).unwrap()
}

fn depth(mesh: &Mesh, pose: Isometry3<f64>, center: PixelCenter) -> DepthImage {
    super::depth(mesh, &pose, &intrinsics(), SIZE, center).unwrap()
}

#[test]
fn square_before_the_camera_covers_its_pixels() {
    // 0.2 m at 2 m: 5 px to either side, 6 px up and down.
    let image = depth(
        &square(0.2),
        Isometry3::translation(0., 0., 2.),
        PixelCenter::Integer,
    );
    for ((row, column), &z) in image.indexed_iter() {
        let inside = (26..=36).contains(&column) && (18..=30).contains(&row);
        assert_eq!(
            z,
            if inside { 2.0 } else { 0.0 },
            "row {row} column {column}"
        );
    }
    // Pixel 36 is now centered at 36.5, beyond the square's end at 36; pixel 25 at 25.5, before
    // its begin at 26.
    let image = depth(
        &square(0.2),
        Isometry3::translation(0., 0., 2.),
        PixelCenter::Half,
    );
    let seen: Vec<usize> = (0..64)
        .filter(|&column| image[(24, column)] > 0.0)
        .collect();
    assert_eq!((seen[0], seen[seen.len() - 1]), (26, 35));
}

#[test]
fn plane_has_the_depth_of_its_equation_also_where_it_passes_the_camera() {
    // Turned about x by 60 degrees, it fills the image and reaches far behind the camera.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 60_f64.to_radians());
    let pose = Isometry3::from_parts(Translation3::new(0.1, 0.2, 1.5), turn);
    let image = depth(&square(1e4), pose, PixelCenter::Integer);
    let normal = turn * Vector3::z();
    let mut seen = 0;
    for ((row, column), &z) in image.indexed_iter() {
        let ray = Vector3::new(
            (column as f64 - 31.0) / 50.0,
            (row as f64 - 24.0) / 60.0,
            1.0,
        );
        let expected = normal.dot(&pose.translation.vector) / normal.dot(&ray);
        if expected > 0.0 && expected < 1e3 {
            seen += 1;
            assert_abs_diff_eq!(f64::from(z) / expected, 1.0, epsilon = 1e-6);
        } else if expected < 0.0 {
            assert_eq!(z, 0.0);
        }
    }
    assert!(seen > 2000, "{seen}");
}

#[test]
fn sphere_has_the_depth_of_its_equation() {
    let (center, radius) = (Vector3::new(0.1, -0.05, 1.2), 0.3);
    let pose = Isometry3::from_parts(
        Translation3::from(center),
        UnitQuaternion::from_euler_angles(0.4, 1.1, -0.3),
    );
    let image = depth(&sphere(radius), pose, PixelCenter::Integer);
    let mut hits = 0;
    for ((row, column), &z) in image.indexed_iter() {
        let ray = Vector3::new(
            (column as f64 - 31.0) / 50.0,
            (row as f64 - 24.0) / 60.0,
            1.0,
        );
        // |s ray - center| = radius, the nearer root.
        let (a, b) = (ray.norm_squared(), ray.dot(&center));
        let root = b * b - a * (center.norm_squared() - radius * radius);
        // Near the outline a mesh and its sphere differ.
        if root > 0.01 {
            hits += 1;
            let expected = (b - root.sqrt()) / a;
            assert_abs_diff_eq!(f64::from(z), expected, epsilon = 3e-3);
        } else if root < -0.01 {
            assert_eq!(z, 0.0);
        }
    }
    assert!(hits > 300, "{hits}");
}

#[test]
fn nearer_surface_hides_the_farther_in_either_order() {
    let both = |near_first: bool| {
        let (near, far) = (square(0.1), square(0.4));
        let (first, second, shift) = if near_first {
            (near, far, 1.0)
        } else {
            (far, near, -1.0)
        };
        let mut vertices = first.vertices().to_vec();
        vertices.extend(second.vertices().iter().map(|p| p + Vector3::z() * shift));
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let z = if near_first { 1.0 } else { 2.0 };
        let mesh = Mesh::new(vertices, Vec::new(), triangles).unwrap();
        depth(
            &mesh,
            Isometry3::translation(0., 0., z),
            PixelCenter::Integer,
        )
    };
    assert_eq!(both(true), both(false));
    assert_eq!(both(true)[(24, 31)], 1.0);
    assert_eq!(both(true)[(24, 38)], 2.0);
}

#[test]
fn what_cannot_be_seen_leaves_the_image_empty() {
    for pose in [
        Isometry3::translation(0., 0., -2.),
        Isometry3::translation(50., 0., 2.),
        Isometry3::rotation(Vector3::y() * std::f64::consts::FRAC_PI_2),
    ] {
        let image = depth(&square(0.2), pose, PixelCenter::Integer);
        assert!(image.iter().all(|&z| z == 0.0), "{pose}");
    }
}

#[test]
fn distance_of_a_pixel_is_along_its_ray() {
    // x = 30 / 50, y = 0: 1.2, 0, 2 are sqrt(1.44 + 4) away.
    let distance = |depth, row, column| distance(depth, &intrinsics(), row, column);
    assert_abs_diff_eq!(distance(2.0, 24, 31), 2.0, epsilon = 1e-12);
    assert_abs_diff_eq!(distance(2.0, 24, 61), 5.44_f64.sqrt(), epsilon = 1e-12);
    assert_eq!(distance(0.0, 1, 1), 0.0);
}

#[test]
fn meshes_and_lenses_that_cannot_be_are_refused() {
    let error = Mesh::new(vec![Point3::origin(); 3], Vec::new(), vec![[0, 1, 3]]).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("the 3 vertices, counted from 0, got [0, 1, 3]")
    );
    let error = Mesh::new(vec![Point3::new(0.0, f64::NAN, 0.0)], Vec::new(), vec![]).unwrap_err();
    assert!(error.to_string().contains("vertex 0"));
    let bent = |k1| {
        let projection = Projection::from_params("pinhole", None, &[k1, 0.0, 0.0, 0.0, 0.0]);
        Intrinsics::new(50.0, 60.0, 31.0, 24.0, projection.unwrap()).unwrap()
    };
    let pose = Isometry3::translation(0., 0., 1.);
    let error = super::depth(&square(1.0), &pose, &bent(0.1), SIZE, PixelCenter::Integer);
    assert!(error.unwrap_err().to_string().contains("undistort"));
    // Five zeros, as OpenCV gives them, are no distortion.
    let depth =
        |intrinsics| super::depth(&square(1.0), &pose, &intrinsics, SIZE, PixelCenter::Integer);
    assert_eq!(depth(bent(0.0)).unwrap(), depth(intrinsics()).unwrap());
}

#[test]
fn skew_shifts_each_row_by_its_height() {
    let pose = Isometry3::new(Vector3::new(0.02, -0.05, 1.0), Vector3::new(0.3, -0.4, 0.2));
    let render = |lens: &Intrinsics| {
        let image = super::depth(&sphere(0.2), &pose, lens, SIZE, PixelCenter::Integer);
        image.unwrap()
    };
    let askew = intrinsics().with_skew(5.0).unwrap();
    let (straight, image) = (render(&intrinsics()), render(&askew));
    // 5 px for each 60 rows.
    for (row, by) in [(12, -1), (24, 0), (36, 1)] {
        for column in 5..59_usize {
            let moved = image[[row, column.checked_add_signed(by).unwrap()]];
            assert_abs_diff_eq!(moved, straight[[row, column]], epsilon = 1e-6);
        }
        let along = distance(1.0, &askew, row, 31_usize.checked_add_signed(by).unwrap());
        assert_abs_diff_eq!(
            along,
            distance(1.0, &intrinsics(), row, 31),
            epsilon = 1e-12
        );
    }
    assert!((0..64).any(|column| image[[12, column]] != straight[[12, column]]));
}

proptest! {
    /// Shared edges leave no holes: a convex body cut into triangles shows no background within.
    #[test]
    fn sphere_has_no_holes(x in -0.2..0.2, y in -0.2..0.2, turn in [-3.0..3.0, -3.0..3.0, -3.0..3.0]) {
        let pose = Isometry3::new(Vector3::new(x, y, 1.0), Vector3::from(turn));
        let image = depth(&sphere(0.25), pose, PixelCenter::Half);
        for row in image.rows() {
            let seen: Vec<usize> = (0..64).filter(|&c| row[c] > 0.0).collect();
            if let (Some(first), Some(last)) = (seen.first(), seen.last()) {
                prop_assert_eq!(last - first + 1, seen.len());
            }
        }
    }
}
