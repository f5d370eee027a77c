use mvtop_import::{Direction, Format, Options};

use super::samples::MATLAB;
use super::{MINUS_Y, X, Y, Z};
use crate::{assert_params, assert_plane, assert_pose, read, read_bytes, refusal};

#[test]
fn matlab_counts_pixels_from_1_and_multiplies_from_the_other_side() {
    let imported = read(&[("stereo.json", MATLAB)], &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Matlab);
    let [first, second] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    for camera in [first, second] {
        assert_plane(camera, [500.0, 510.0, 320.0, 240.0]);
        assert_eq!([camera.width(), camera.height()], [640, 480]);
    }
    assert_params(first, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(first, [0.0; 3], X, Z);
    assert_pose(second, [0.4, 0.2, 0.0], MINUS_Y, Z);
}

#[test]
fn what_a_pose_of_newer_releases_maps_to_what_is_asked_for() {
    let from = MATLAB.find(r#""RotationOfCamera2""#).unwrap();
    let pose = r#""PoseCamera2": {"Dimensionality": 3,
        "A": [[0, -1, 0, 200], [1, 0, 0, -400], [0, 0, 1, 0], [0, 0, 0, 1]]}}"#;
    let text = format!("{}{pose}", &MATLAB[..from]);
    let error = refusal(&[("stereo.json", &text)], &Options::default());
    assert!(error.contains("`direction` (--direction"), "{error}");
    let read_as = |direction| {
        let options = Options {
            direction: Some(direction),
            ..Options::default()
        };
        read(&[("stereo.json", &text)], &options).unwrap().rig
    };
    let rig = read_as(Direction::CamFromWorld);
    assert_pose(&rig.cameras()[1], [0.4, 0.2, 0.0], MINUS_Y, Z);
    let rig = read_as(Direction::WorldFromCam);
    assert_pose(&rig.cameras()[1], [0.2, -0.4, 0.0], Y, Z);
}

#[test]
fn a_mat_file_is_refused_with_what_to_type_in_matlab() {
    let bytes = b"MATLAB 5.0 MAT-file, Platform: GLNXA64\0\0\x01IM\x0f\0\0\0\xff";
    let error = read_bytes(&[("stereo.mat", bytes)], &Options::default());
    let error = error.unwrap_err().to_string();
    assert!(
        error.contains("got a MAT-file") && error.contains("jsonencode"),
        "{error}"
    );
}

#[test]
fn matlab_s_sizes_are_rows_and_columns() {
    let text = MATLAB
        .replace("[480, 640]", "[640, 480]")
        .replace("[321, 241, 1]", "[330, 231, 1]");
    let error = refusal(&[("stereo.json", &text)], &Options::default());
    assert!(error.contains("`ImageSize` of 640 and 480 px"), "{error}");
}
