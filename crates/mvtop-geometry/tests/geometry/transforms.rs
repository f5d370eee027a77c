use mvtop_geometry::pose::wxyz;
use mvtop_geometry::transform::{TransformError, from_matrix, from_quaternion_wxyz, from_rotation};
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;

/// A quarter turn about z, then (0.1, 0.2, 0.3).
const QUARTER: [[f64; 4]; 4] = [
    [0.0, -1.0, 0.0, 0.1],
    [1.0, 0.0, 0.0, 0.2],
    [0.0, 0.0, 1.0, 0.3],
    [0.0, 0.0, 0.0, 1.0],
];
const ROTATION: [[f64; 3]; 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
const T: [f64; 3] = [0.1, 0.2, 0.3];

fn changed(row: usize, column: usize, number: f64) -> [[f64; 4]; 4] {
    let mut rows = QUARTER;
    rows[row][column] = number;
    rows
}

#[test]
fn one_pose_from_three_kinds_of_numbers() {
    let half = 0.5_f64.sqrt();
    for pose in [
        from_matrix(&QUARTER).unwrap(),
        from_rotation(&ROTATION, T).unwrap(),
        from_quaternion_wxyz([half, 0.0, 0.0, half], T).unwrap(),
    ] {
        let moved = pose * Point3::new(1.0, 0.0, 0.0);
        assert!((moved - Point3::new(0.1, 1.2, 0.3)).norm() < 1e-12);
    }
}

#[test]
fn rounding_is_taken_out() {
    let pose = from_matrix(&changed(1, 0, 1.0004)).unwrap();
    let matrix = pose.rotation.to_rotation_matrix().into_inner();
    assert!((matrix.transpose() * matrix - nalgebra::Matrix3::identity()).norm() < 1e-12);
    let pose = from_quaternion_wxyz([1.0009, 0.0, 0.0, 0.0], T).unwrap();
    assert!((pose.rotation.norm() - 1.0).abs() < 1e-15);
}

#[test]
fn mistakes_are_told_apart() {
    assert_eq!(
        from_matrix(&changed(2, 2, -1.0)),
        Err(TransformError::Reflection)
    );
    let columns = std::array::from_fn(|row| std::array::from_fn(|column| QUARTER[column][row]));
    assert_eq!(
        from_matrix(&columns),
        Err(TransformError::LastRow {
            last_row: [0.1, 0.2, 0.3, 1.0],
            in_columns: true,
        })
    );
    assert_eq!(
        from_matrix(&changed(3, 3, 2.0)),
        Err(TransformError::LastRow {
            last_row: [0.0, 0.0, 0.0, 2.0],
            in_columns: false,
        })
    );
    let scaled = from_matrix(&changed(1, 0, 1.01)).unwrap_err();
    assert!(
        matches!(scaled, TransformError::NotRotation { determinant, off }
            if (determinant - 1.01).abs() < 1e-12 && (off - 0.0201).abs() < 1e-12),
        "{scaled:?}"
    );
    assert_eq!(
        from_matrix(&changed(0, 3, -2e7)),
        Err(TransformError::TooFar(Vector3::new(-2e7, 0.2, 0.3).norm()))
    );
    assert_eq!(
        from_quaternion_wxyz([0.6, 0.0, 0.9, 0.0], T),
        Err(TransformError::Norm(1.17_f64.sqrt()))
    );
    assert_eq!(
        from_quaternion_wxyz([0.0; 4], T),
        Err(TransformError::Norm(0.0))
    );
    for (what, error) in [
        (
            "upper left 3x3",
            from_matrix(&changed(0, 0, 1e200)).unwrap_err(),
        ),
        ("norm 1", from_quaternion_wxyz([1e200; 4], T).unwrap_err()),
        (
            "not credible",
            from_rotation(&ROTATION, [1e200; 3]).unwrap_err(),
        ),
    ] {
        assert!(error.to_string().contains(what), "{error}");
    }
}

#[test]
fn no_place_takes_a_number_that_is_not_finite() {
    let refused = |got: Result<Isometry3<f64>, TransformError>| matches!(got, Err(TransformError::NotFinite(number)) if !number.is_finite());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for (row, column) in (0..16).map(|i| (i / 4, i % 4)) {
            assert!(refused(from_matrix(&changed(row, column, bad))));
        }
        for i in 0..4 {
            let mut wxyz = [1.0, 0.0, 0.0, 0.0];
            wxyz[i] = bad;
            assert!(refused(from_quaternion_wxyz(wxyz, T)));
        }
        for i in 0..3 {
            let (mut rotation, mut t) = (ROTATION, T);
            rotation[i][0] = bad;
            t[i] = bad;
            assert!(refused(from_rotation(&rotation, T)));
            assert!(refused(from_rotation(&ROTATION, t)));
        }
    }
}

proptest! {
    #[test]
    fn every_rigid_transform_is_read_from_its_numbers(
        t in prop::array::uniform3(-9.0..9.0f64),
        axis in prop::array::uniform3(-3.0..3.0f64),
    ) {
        let pose = Isometry3::new(Vector3::from(t), Vector3::from(axis));
        let matrix = pose.to_homogeneous();
        let rows: [[f64; 4]; 4] =
            std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]));
        let rotation = [0, 1, 2].map(|row| [rows[row][0], rows[row][1], rows[row][2]]);
        let q = pose.rotation;
        for read in [
            from_matrix(&rows),
            from_rotation(&rotation, t),
            from_quaternion_wxyz([q.w, q.i, q.j, q.k], t),
        ] {
            let read = read.unwrap();
            prop_assert!((read.to_homogeneous() - matrix).norm() < 1e-12);
            // What is written is read back to the last bit.
            let written = wxyz(&read.rotation);
            let again = from_quaternion_wxyz(written, t).unwrap();
            prop_assert_eq!(wxyz(&again.rotation), written);
        }
    }

    #[test]
    fn no_numbers_make_it_panic(
        rows in prop::array::uniform4(prop::array::uniform4(any::<f64>())),
        near in prop::array::uniform4(prop::array::uniform4(-1.1..1.1f64)),
    ) {
        for rows in [rows, near] {
            for pose in [from_matrix(&rows), from_quaternion_wxyz(rows[0], T)].into_iter().flatten() {
                prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-12);
                prop_assert!(pose.translation.vector.norm() <= 1e7);
            }
        }
    }
}
