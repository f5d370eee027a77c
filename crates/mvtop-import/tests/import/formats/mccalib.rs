use mvtop_import::Format;

use super::samples::mccalib as file;
use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn mccalib_states_poses_of_cameras_and_which_lens_is_a_fisheye() {
    let text = file(1, 0);
    let imported = read(&[("calibrated_cameras_data.yml", &text)], &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::McCalib);
    let [first, second] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!([first.id(), second.id()], ["camera_0", "camera_1"]);
    assert_plane(first, [500.0, 510.0, 320.0, 240.0]);
    assert_params(first, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(first, [0.0; 3], X, Z);
    let lens = second.intrinsics().projection();
    assert_eq!(lens.distortion(), Some("kannala_brandt"));
    assert_pose(second, [0.4, 0.2, 0.0], MINUS_Y, Z);
}

#[test]
fn mccalib_s_other_lenses_and_groups_without_a_common_frame_are_refused() {
    for (kind, group, expected) in [
        (2, 0, "expected 0 (Brown-Conrady) or 1 (fisheye), got 2"),
        (0, 1, "expected one `camera_group`, got several"),
    ] {
        let text = file(kind, group);
        let error = refusal(&[("data.yml", &text)], &scaled(0.1));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn mccalib_s_camera_without_a_matrix_is_named() {
    let text = file(0, 0).replacen("camera_matrix", "matrix", 1);
    let error = refusal(&[("data.yml", &text)], &scaled(0.1));
    assert!(error.contains("the key `camera_0` is not known"), "{error}");
}
