use mvtop_geometry::pose::{rotation_error_deg, rotation_from_6d, translation_error, wxyz};
use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn about_z(degrees: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), degrees.to_radians())
}

#[test]
fn six_numbers_by_hand() {
    let rotation = rotation_from_6d([1.0, 2.0, 2.0, 0.0, 3.0, 4.0]).unwrap();
    let columns = [
        [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0],
        [-0.866578, -0.061898, 0.495188],
        [0.371391, -0.742781, 0.557086],
    ];
    for (got, expected) in rotation.matrix().column_iter().zip(columns) {
        assert!((got - Vector3::from(expected)).norm() < 1e-6, "{got}");
    }
}

#[test]
fn six_numbers_that_span_no_rotation_are_refused() {
    for values in [
        [0.0; 6],
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        [1.0, 2.0, 3.0, -2.0, -4.0, -6.0],
        [f64::NAN, 0.0, 0.0, 0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, f64::INFINITY, 0.0],
    ] {
        let error = rotation_from_6d(values).unwrap_err().to_string();
        assert!(
            error.contains("6D rotation") && error.contains("parallel"),
            "{error}"
        );
    }
}

#[test]
fn rotation_error_is_exact_at_both_ends() {
    for degrees in [0.0, 1e-9, 1e-3, 45.0, 90.0, 179.999_999, 180.0] {
        let error = rotation_error_deg(&about_z(20.0), &about_z(20.0 + degrees));
        assert!(
            (error - degrees).abs() < 1e-12 * (1.0 + 100.0 * degrees),
            "{degrees}: {error}"
        );
    }
    assert!((rotation_error_deg(&about_z(170.0), &about_z(-170.0)) - 20.0).abs() < 1e-9);
}

#[test]
fn quaternions_of_one_rotation_are_printed_alike() {
    let q = UnitQuaternion::new_unchecked(Quaternion::new(-0.6, 0.0, -0.8, 0.0));
    let printed = wxyz(&q);
    assert_eq!(printed, [0.6, 0.0, 0.8, 0.0]);
    assert!(printed.iter().all(|x| x.is_sign_positive()), "no -0");
    let other = UnitQuaternion::new_unchecked(-q.into_inner());
    assert_eq!(wxyz(&other), printed);
}

#[test]
fn translation_error_is_the_distance_of_the_origins() {
    let moved = Isometry3::translation(0.0, 3.0, 4.0);
    assert_eq!(translation_error(&Isometry3::identity(), &moved), 5.0);
}

proptest! {
    #[test]
    fn six_numbers_give_a_rotation_whatever_their_lengths(
        values in prop::array::uniform6(-10.0..10.0f64),
        a in 0.1..10.0f64,
        b in 0.1..10.0f64,
    ) {
        if let Ok(rotation) = rotation_from_6d(values) {
            let matrix = rotation.matrix();
            prop_assert!((matrix.transpose() * matrix - Matrix3::identity()).norm() < 1e-9);
            prop_assert!(matrix.determinant() > 0.0);
            let [a0, a1, a2, b0, b1, b2] = values;
            let values = [a * a0, a * a1, a * a2, b * b0, b * b1, b * b2];
            let scaled = rotation_from_6d(values).unwrap();
            prop_assert!((scaled.matrix() - matrix).norm() < 1e-6);
        }
    }
}
