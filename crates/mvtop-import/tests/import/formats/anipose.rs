use mvtop_import::Format;

use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

const TOML: &str = r#"[cam_0]
name = "left"
size = [1280, 960]
matrix = [[1100.0, 0.0, 640.0], [0.0, 1110.0, 480.0], [0.0, 0.0, 1.0]]
distortions = [-0.2, 0.05, 0.001, -0.002, 0.01]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]

[cam_10]
name = "wide"
size = [640, 480]
matrix = [[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.02, 0.003, 0.0004]
fisheye = true
rotation = [0.0, 0.0, 1.5707963267948966]
translation = [-400.0, 0.0, 0.0]

[cam_2]
name = "narrow"
size = [640, 480]
matrix = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.02, 0.003, 0.0004]
rotation = [0.0, 0.0, 0.0]
translation = [-200.0, 0.0, 0.0]

[metadata]
adjusted = false
error = 0.31
"#;

#[test]
fn anipose_maps_world_to_camera_and_says_which_lens_is_a_fisheye() {
    let imported = read(&[("calibration.toml", TOML)], &scaled(0.001)).unwrap();
    assert_eq!(imported.format, Format::Anipose);
    let mut cameras = imported.rig.cameras().to_vec();
    cameras.sort_by_key(|camera| camera.id().to_owned());
    let [left, narrow, wide] = &cameras[..] else {
        panic!("three cameras")
    };
    assert_plane(left, [1100.0, 1110.0, 640.0, 480.0]);
    assert_eq!([left.width(), left.height()], [1280, 960]);
    assert_params(left, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(left, [0.0; 3], X, Z);
    let lens = |camera: &mvtop_geometry::Camera| camera.intrinsics().projection().distortion();
    assert_eq!(lens(wide), Some("kannala_brandt"));
    // A quarter turn about z: -Rᵀ t is (0, -400, 0) mm, and the camera's x is the first row of R.
    assert_pose(wide, [0.0, -0.4, 0.0], MINUS_Y, Z);
    assert_eq!(lens(narrow), Some("brown_conrady"));
    assert_pose(narrow, [0.2, 0.0, 0.0], X, Z);
}

#[test]
fn caliscope_has_its_cameras_in_a_table() {
    let text = "[cameras.0]\ncam_id = 0\nrotation_count = 0\nexposure = -7.0\nignore = true\nsize = [640, 480]\n\n\
        [cameras.1]\ncam_id = 1\nrotation_count = -1\nerror = 0.4\ngrid_count = 34\nignore = false\n\
        size = [640, 480]\nmatrix = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]\n\
        distortions = [0.1, -0.2, 0.01, 0.02, 0.3]\ntranslation = [-1.0, 0.0, 0.0]\n\
        rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n\
        verified_resolutions = [[640, 480], [1280, 720]]\n";
    let rig = read(&[("camera_array.toml", text)], &scaled(1.0))
        .unwrap()
        .rig;
    let [camera] = rig.cameras() else {
        panic!("{:?}", rig.cameras());
    };
    assert_eq!(camera.id(), "cam_1");
    assert_params(camera, &[0.1, -0.2, 0.01, 0.02, 0.3]);
    // -Rᵀ t of t = (-1, 0, 0) is (0, -1, 0).
    assert_pose(camera, [0.0, -1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
}

#[test]
fn freemocap_s_place_in_the_world_is_compared() {
    let with = |at: &str, turn: &str| {
        TOML.replace(
            "translation = [-400.0, 0.0, 0.0]",
            &format!("translation = [-400.0, 0.0, 0.0]\nworld_position = {at}\nworld_orientation = {turn}"),
        )
    };
    // -Rᵀ t, and Rᵀ of a quarter turn about z.
    let (at, turn) = (
        "[0.0, -400.0, 0.0]",
        "[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
    );
    let files = [("calibration.toml", &*with(at, turn))];
    assert_eq!(
        read(&files, &scaled(0.001)).unwrap().rig,
        read(&[("calibration.toml", TOML)], &scaled(0.001))
            .unwrap()
            .rig
    );
    for (text, key) in [
        (with("[0.0, -401.0, 0.0]", turn), "world_position"),
        (
            with(at, "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"),
            "world_orientation",
        ),
    ] {
        let error = refusal(&[("calibration.toml", &text)], &scaled(0.001));
        assert!(error.contains(&format!("`{key}`: expected")), "{error}");
    }
    let updated = TOML.replace(
        "fisheye = true",
        "fisheye = true\nupdated_distortions = [0.1, 0.0, 0.0, 0.0]",
    );
    let error = refusal(&[("calibration.toml", &updated)], &scaled(0.001));
    assert!(error.contains("`updated_distortions`"), "{error}");
    let bare = TOML.replace("distortions = [-0.2, 0.05, 0.001, -0.002, 0.01]\n", "");
    let rig = read(&[("calibration.toml", &bare)], &scaled(0.001))
        .unwrap()
        .rig;
    assert_eq!(rig.cameras().len(), 3);
}
