//! Every object that is opened is looked through: what is not known there is named.

use mvtop_import::Options;

use crate::formats::samples::{ALICEVISION, DEPTHAI, MULTICAL, OPEN3D, OPENMVG, ZED};
use crate::{read, refusal, scaled};

const ANIPOSE: &str = "[cam_0]\nname = \"left\"\nsize = [640, 480]\n\
    matrix = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]\n\
    distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, -200.0]\n\n\
    [metadata]\nadjusted = true\nerror = 0.3\n";
const CALLAB: &str =
    "camera.0.A=[500 0 320; 0 500 240; 0 0 1]\ncamera.0.width=640\ncamera.0.height=480\n";
const INFO: &str = "header: {frame_id: left_optical_frame}\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\n\
    d: [0.1, 0, 0, 0, 0]\nk: [500, 0, 320, 0, 500, 240, 0, 0, 1]\np: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]\n";
const TF: &str = "transforms:\n- header: {stamp: {sec: 0}, frame_id: base}\n  child_frame_id: left_optical_frame\n  \
    transform:\n    translation: {x: 1, y: 0, z: 0}\n    rotation: {x: 0, y: 0, z: 0, w: 1}\n";
const HAND_EYE: &str = "parameters: {name: a, eye_on_hand: false, robot_base_frame: base, robot_effector_frame: hand,\n  \
    tracking_base_frame: left_optical_frame, tracking_marker_frame: board}\n\
    transformation: {qw: 1, qx: 0, qy: 0, qz: 0, x: 1, y: 0, z: 0}\n";

/// A file, its text, and the texts that open its levels, each with which of them it is.
type Levels = (&'static str, &'static str, &'static [(&'static str, usize)]);

/// Puts text behind the n-th place of other text.
fn put(text: &str, after: &str, n: usize, more: &str) -> String {
    let (at, found) = text.match_indices(after).nth(n).expect(after);
    let end = at + found.len();
    format!("{}{more}{}", &text[..end], &text[end..])
}

#[test]
fn each_level_of_json_names_what_it_does_not_know() {
    let key = r#""lens_rotation_deg": 90, "#;
    // The levels by the text that opens them.
    let levels: [Levels; 5] = [
        (
            "sfm_data.json",
            OPENMVG,
            &[
                ("{", 0),
                ("\"views\": [\n  {", 0),
                ("\"value\": {", 0),
                ("\"ptr_wrapper\": {", 0),
                ("\"data\":\n   {", 0),
                ("\"intrinsics\": [\n  {", 0),
                ("\"value0\": {", 0),
                ("\"extrinsics\": [\n  {", 0),
                ("\"value\": {\"rotation", 0),
            ],
        ),
        (
            "cameras.sfm",
            ALICEVISION,
            &[
                ("{", 0),
                ("\"views\": [\n  {", 0),
                ("\"intrinsics\": [\n  {", 0),
                ("\"poses\": [\n  {", 0),
                ("\"pose\": {", 0),
                ("\"transform\": {", 0),
            ],
        ),
        (
            "traj.json",
            OPEN3D,
            &[
                ("{", 0),
                ("\"parameters\": [\n {", 0),
                ("\"intrinsic\": {", 0),
            ],
        ),
        (
            "calib.json",
            DEPTHAI,
            &[
                ("{", 0),
                ("[0, {", 0),
                ("\"extrinsics\": {", 1),
                ("\"translation\": {", 1),
            ],
        ),
        (
            "calibration.json",
            MULTICAL,
            &[
                ("{", 0),
                ("\"left\": {", 0),
                ("\"camera_poses\": {", 0),
                ("\"left\": {", 1),
            ],
        ),
    ];
    for (name, text, places) in levels {
        // Without a unit of its own, the sample has one of our choice.
        let options = match name {
            "calib.json" => Options::default(),
            _ => scaled(0.1),
        };
        assert!(read(&[(name, text)], &options).is_ok(), "{name}");
        for (after, n) in places {
            let changed = match after
                .strip_suffix("\"rotation")
                .or(after.strip_suffix("rotation"))
            {
                Some(_) => {
                    text.replacen("\"rotation\": [[1", &format!("{key}\"rotation\": [[1"), 1)
                }
                None => put(text, after, *n, key),
            };
            let error = refusal(&[(name, &changed)], &options);
            assert!(
                error.contains("`lens_rotation_deg`"),
                "{name}, {after:?}: {error}"
            );
        }
    }
}

#[test]
fn each_level_of_ros_files_names_what_it_does_not_know() {
    for (text, levels) in [
        (
            TF,
            &[
                "transforms",
                "header: {",
                "  child_frame_id",
                "    translation",
                "translation: {",
                "rotation: {",
            ][..],
        ),
        (
            HAND_EYE,
            &["parameters: {", "parameters", "transformation: {"],
        ),
    ] {
        let files = [("left.yaml", INFO), ("tf.yaml", text)];
        assert!(read(&files, &Options::default()).is_ok(), "{text}");
        for level in levels {
            let key = match level.strip_suffix('{') {
                Some(_) => format!("{level}lens_rotation_deg: 90, "),
                None => {
                    let indent = " ".repeat(level.len() - level.trim_start().len());
                    format!("{indent}lens_rotation_deg: 90\n{level}")
                }
            };
            let changed = text.replacen(level, &key, 1);
            let files = [("left.yaml", INFO), ("tf.yaml", &*changed)];
            let error = refusal(&files, &Options::default());
            assert!(error.contains("`lens_rotation_deg`"), "{level}: {error}");
        }
    }
    let header = INFO.replacen("frame_id", "flip: true, frame_id", 1);
    let error = refusal(&[("left.yaml", &header)], &Options::default());
    assert!(error.contains("`flip`"), "{error}");
    let urdf = r#"<robot name="r"><joint name="a" type="fixed"><parent link="base"/><child link="left_optical_frame"/>
        <origin xyz="1 0 0" quat_xyzw="0 0 0 1"/></joint></robot>"#;
    let error = refusal(
        &[("left.yaml", INFO), ("r.urdf", urdf)],
        &Options::default(),
    );
    assert!(error.contains("got `quat_xyzw`"), "{error}");
}

#[test]
fn tables_and_lines_beside_the_cameras_are_read_or_named() {
    let metadata = |more: &str| format!("{ANIPOSE}{more}\n");
    for (text, key) in [
        (format!("scale = 0.001\n{ANIPOSE}"), "scale"),
        (
            format!("direction_note = \"camera_to_world\"\n{ANIPOSE}"),
            "direction_note",
        ),
        (metadata("extrinsics = \"camera_to_world\""), "extrinsics"),
        (metadata("image_scale = 0.5"), "image_scale"),
        (metadata("rotated_deg = 90"), "rotated_deg"),
    ] {
        let error = refusal(&[("calibration.toml", &text)], &scaled(1.0));
        assert!(error.contains(&format!("`{key}`")), "{key}: {error}");
    }
    let crop = metadata("crop = [100, 100, 320, 240]");
    let error = refusal(&[("calibration.toml", &crop)], &scaled(1.0));
    assert!(error.contains("the whole image"), "{error}");
    let units = metadata("units = \"mm\"");
    let rig = read(&[("calibration.toml", &units)], &Options::default())
        .unwrap()
        .rig;
    let z = rig.cameras()[0].world_from_cam().translation.vector.z;
    assert!((z - 0.2).abs() < 1e-12, "{z}");
    let error = refusal(&[("calibration.toml", &units)], &scaled(1.0));
    assert!(error.contains("unit of length"), "{error}");

    assert!(read(&[("a.cal", CALLAB)], &scaled(1.0)).is_ok());
    for line in [
        "model=fisheye",
        "type=fisheye",
        "rotated=90",
        "binning=2",
        "offset_x=100",
        "s=0.5",
        "pose=w2c",
    ] {
        let text = format!("{CALLAB}camera.0.{line}\n");
        let key = line.split('=').next().unwrap();
        let error = refusal(&[("a.cal", &text)], &scaled(1.0));
        assert!(error.contains(&format!("the key `{key}`")), "{error}");
    }
    let size = Options {
        image_sizes: mvtop_import::ImageSize::parse("1280x720")
            .into_iter()
            .collect(),
        ..Options::default()
    };
    let stereo = ZED.replace("Baseline=120", "Baseline=120\nRoll=90");
    assert!(refusal(&[("SN1.conf", &stereo)], &size).contains("`ROLL`"));
}

#[test]
fn a_matrix_that_is_an_object_has_its_order_and_its_channels() {
    let file = |more: &str, dt: &str| {
        format!(
            r#"{{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "image_size": [640, 480], "D": [0, 0, 0, 0, 0],
            "rvec": {{"type_id": "opencv-matrix", "rows": 1, "cols": 1, "dt": "{dt}", "data": [0.1, 0.2, 0.3]{more}}},
            "tvec": [1, 2, 3]}}"#
        )
    };
    assert!(read(&[("a.json", &file("", "3d"))], &scaled(1.0)).is_ok());
    let error = refusal(&[("a.json", &file("", "d"))], &scaled(1.0));
    assert!(error.contains("expected 1 x 1 numbers"), "{error}");
    let error = refusal(
        &[("a.json", &file(r#", "order": "F""#, "3d"))],
        &scaled(1.0),
    );
    assert!(error.contains("the key `order` of a matrix"), "{error}");
}
