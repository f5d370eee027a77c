use mvtop_import::{Format, Options};

use super::{Y, Z};
use crate::{assert_pose, read, refusal};

const INFO: &str = "image_width: 640\nimage_height: 480\ncamera_name: cell\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: \
    [500, 0, 320, 0, 500, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  \
    data: [0, 0, 0, 0, 0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
    projection_matrix:\n  rows: 3\n  cols: 4\n  data: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]\n";
/// A quarter turn about z.
const EASY: &str = "parameters:\n  eye_on_hand: false\n  robot_base_frame: base\n  robot_effector_frame: tool0\n  \
    tracking_base_frame: cell_optical_frame\n  tracking_marker_frame: tag\ntransformation: {qw: 0.7071067811865476, qx: 0, \
    qy: 0, qz: 0.7071067811865476, x: 0.1, y: 0.2, z: 0.3}\n";
const EASY_2: &str = "parameters:\n  name: a\n  calibration_type: eye_in_hand\n  robot_base_frame: base\n  \
    robot_effector_frame: tool0\n  tracking_base_frame: cell_optical_frame\n  tracking_marker_frame: tag\ntransform:\n  \
    translation: {x: 0.1, y: 0.2, z: 0.3}\n  rotation: {w: 0.7071067811865476, x: 0, y: 0, z: 0.7071067811865476}\n";

#[test]
fn hand_eye_results_are_the_camera_in_the_robot() {
    for (text, root) in [(EASY, "base"), (EASY_2, "tool0")] {
        let imported = read(
            &[("info.yaml", INFO), ("hand_eye.yaml", text)],
            &Options::default(),
        )
        .unwrap();
        assert_eq!(imported.format, Format::Ros);
        assert_pose(&imported.rig.cameras()[0], [0.1, 0.2, 0.3], Y, Z);
        let notes = imported.notes.join("; ");
        assert!(notes.contains(root), "{notes}");
    }
    let error = refusal(&[("hand_eye.yaml", EASY)], &Options::default());
    assert!(error.contains("give the camera_info as well"), "{error}");
}
