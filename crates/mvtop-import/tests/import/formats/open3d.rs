use mvtop_import::Format;

use super::samples::OPEN3D;
use super::{MINUS_Y, X, Z};
use crate::{assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn open3d_has_matrices_by_column() {
    let imported = read(&[("trajectory.json", OPEN3D)], &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::Open3d);
    let [first, second] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_plane(first, [500.0, 510.0, 320.0, 240.0]);
    assert_pose(first, [0.0; 3], X, Z);
    assert_pose(second, [0.4, 0.2, 0.0], MINUS_Y, Z);
}

#[test]
fn open3d_has_no_lens() {
    let text = OPEN3D.replacen(r#""height""#, r#""dist": [0.1, 0, 0, 0], "height""#, 1);
    let error = refusal(&[("trajectory.json", &text)], &scaled(0.1));
    assert!(error.contains("the key `dist` is not known"), "{error}");
}
