//! Which files, sections and frames are of which camera.

use mvtop_import::{Direction, Options};

use crate::{assert_pose, read, refusal, scaled};

const K: &str = r#""K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "D": [0, 0, 0, 0, 0], "image_size": [640, 480]"#;
const X: [f64; 3] = [1.0, 0.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

fn place(x: f64) -> String {
    format!(r#""rvec": [0, 0, 0], "tvec": [{}, 0, 0]"#, -x)
}

/// Where the cameras of files stand, x alone.
fn xs(files: &[(&str, &str)], options: &Options) -> Vec<f64> {
    let rig = read(files, options)
        .unwrap_or_else(|error| panic!("{error}"))
        .rig;
    let cameras = rig.cameras().iter();
    cameras
        .map(|camera| camera.world_from_cam().translation.vector.x.round())
        .collect()
}

#[test]
fn a_pair_that_is_named_from_the_second_to_the_first_is_refused() {
    let camera = format!("{{{K}}}");
    let rt = r#"{"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [-1, 0, 0]}"#;
    let section =
        |name: &str| format!(r#"{{"left": {camera}, "right": {camera}, "{name}": {rt}}}"#);
    for name in [
        "relative_right_to_left",
        "pair_right_left",
        "stereo_right_to_left",
    ] {
        let error = refusal(&[("rig.json", &section(name))], &scaled(1.0));
        assert!(
            error.contains("from the second camera to the first by their name"),
            "{name}: {error}"
        );
    }
    for name in ["relative_left_to_right", "pair_left_right", "stereo"] {
        assert_eq!(
            xs(&[("rig.json", &section(name))], &scaled(1.0)),
            [0.0, 1.0],
            "{name}"
        );
    }
    let files = |a, b, name| [(a, camera.as_str()), (b, camera.as_str()), (name, rt)];
    let error = refusal(
        &files("left.json", "right.json", "right_to_left.json"),
        &scaled(1.0),
    );
    assert!(error.contains("`right_to_left`"), "{error}");
    assert_eq!(
        xs(
            &files("left.json", "right.json", "left_to_right.json"),
            &scaled(1.0)
        ),
        [0.0, 1.0]
    );
    assert_eq!(
        xs(
            &files("right.json", "left.json", "right_to_left.json"),
            &scaled(1.0)
        ),
        [0.0, 1.0]
    );
    let error = refusal(
        &files("right.json", "left.json", "left_to_right.json"),
        &scaled(1.0),
    );
    assert!(error.contains("`left_to_right`"), "{error}");
    let error = refusal(
        &files("cam1.json", "cam2.json", "cam2_to_cam1.json"),
        &scaled(1.0),
    );
    assert!(error.contains("`cam2_to_cam1`"), "{error}");
    for (key, value) in [("from", "right"), ("reference_camera", "right")] {
        let text =
            section("stereo").replacen("{\"R\"", &format!(r#"{{"{key}": "{value}", "R""#), 1);
        let error = refusal(&[("rig.json", &text)], &scaled(1.0));
        assert!(error.contains(&format!("`{key}`")), "{error}");
    }
}

#[test]
fn rotations_of_a_pair_of_librealsense_are_not_read_by_rows() {
    let camera = r#"{"width": 640, "height": 480, "ppx": 320, "ppy": 240, "fx": 500, "fy": 500,
        "model": "distortion.brown_conrady", "coeffs": [0, 0, 0, 0, 0]}"#;
    let place = r#""rotation": [0, 1, 0, -1, 0, 0, 0, 0, 1], "translation": [0.05, 0, 0]"#;
    let top = format!(r#"{{"infra1": {camera}, "infra2": {camera}, {place}}}"#);
    let section =
        format!(r#"{{"infra1": {camera}, "infra2": {camera}, "extrinsics": {{{place}}}}}"#);
    let apart = format!("{{{place}}}");
    for files in [
        &[("rs.json", &*top)][..],
        &[("rs.json", &section)],
        &[
            ("infra1.json", camera),
            ("infra2.json", camera),
            ("extrinsics.json", &apart),
        ],
    ] {
        let error = refusal(files, &scaled(1.0));
        assert!(error.contains("columns to librealsense"), "{error}");
    }
}

#[test]
fn files_of_one_camera_are_joined_by_its_name() {
    let lens = format!("{{{K}}}");
    let [a, b] = [1.0, 2.0].map(|x| format!("{{{}}}", place(x)));
    for (intrinsics, extrinsics) in [
        (
            ["intr_CVLab1.json", "intr_CVLab2.json"],
            ["extr_CVLab1.json", "extr_CVLab2.json"],
        ),
        (
            ["cam1_int.json", "cam2_int.json"],
            ["cam1_ext.json", "cam2_ext.json"],
        ),
        (
            ["cam1_calib.json", "cam2_calib.json"],
            ["cam1_pose.json", "cam2_pose.json"],
        ),
        (
            ["a_params.json", "b_params.json"],
            ["a_info.json", "b_info.json"],
        ),
        (
            ["cam1/intrinsics.json", "cam2/intrinsics.json"],
            ["cam1/extrinsics.json", "cam2/extrinsics.json"],
        ),
    ] {
        let files = [
            (intrinsics[0], lens.as_str()),
            (intrinsics[1], lens.as_str()),
            (extrinsics[1], b.as_str()),
            (extrinsics[0], a.as_str()),
        ];
        assert_eq!(xs(&files, &scaled(1.0)), [1.0, 2.0], "{intrinsics:?}");
    }
    let whole = [1.0, 2.0].map(|x| format!("{{{K}, {}}}", place(x)));
    let files = [
        ("cam1/calib.json", &*whole[0]),
        ("cam2/calib.json", &*whole[1]),
    ];
    let rig = read(&files, &scaled(1.0)).unwrap().rig;
    let ids: Vec<_> = rig.cameras().iter().map(|camera| camera.id()).collect();
    assert_eq!(ids, ["cam1", "cam2"]);
}

#[test]
fn halcon_s_poses_are_matched_by_the_names_of_their_files() {
    let camera = "Focus:foc: 0.01;\nKappa:kappa: 0;\nSx:sx: 2e-5;\nSy:sy: 2e-5;\nCx:cx: 320;\nCy:cy: 240;\n\
                  ImageWidth:imgw: 640;\nImageHeight:imgh: 480;\n";
    let pose = |x: f64| format!("f 0\nr 0 0 0\nt {x} 0 0\n");
    let [a, b] = [1.0, 2.0].map(pose);
    let options = Options {
        direction: Some(Direction::WorldFromCam),
        ..Options::default()
    };
    let files = |names: [&'static str; 4]| {
        [
            (names[0], camera),
            (names[1], camera),
            (names[2], &*b),
            (names[3], &*a),
        ]
        .map(|(name, text)| (name, text.to_owned()))
    };
    let with = |names| {
        let files = files(names);
        let files: Vec<(&str, &str)> = files
            .iter()
            .map(|(name, text)| (*name, text.as_str()))
            .collect();
        read(&files, &options)
            .map_err(|error| error.to_string())
            .map(|imported| {
                let cameras = imported.rig.cameras().iter();
                cameras
                    .map(|camera| camera.world_from_cam().translation.vector.x)
                    .collect::<Vec<_>>()
            })
    };
    for names in [
        ["left.dat", "right.dat", "right_pose.dat", "left_pose.dat"],
        ["cam1.dat", "cam2.dat", "pose2.dat", "pose1.dat"],
    ] {
        assert_eq!(with(names).unwrap(), [1.0, 2.0], "{names:?}");
    }
    // Names that say nothing leave it to the order.
    assert_eq!(
        with(["u.dat", "v.dat", "x.dat", "y.dat"]).unwrap(),
        [2.0, 1.0]
    );
    for names in [
        ["left.dat", "right.dat", "left_pose.dat", "first_pose.dat"],
        ["cam1.dat", "cam2.dat", "pose3.dat", "pose4.dat"],
    ] {
        let error = with(names).unwrap_err();
        assert!(
            error.contains("give each the name of its camera"),
            "{names:?}: {error}"
        );
    }
}

#[test]
fn vins_cameras_without_their_files_are_told_by_the_names_of_these() {
    let camera = "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\nimage_width: 640\nimage_height: 480\n\
        distortion_parameters:\n   k1: 0\n   k2: 0\n   p1: 0\n   p2: 0\nprojection_parameters:\n   fx: 500\n   fy: \
        500\n   cx: 320\n   cy: 240\n";
    let vins = "%YAML:1.0\n---\nimu: 1\nbody_T_cam0: [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n\
        body_T_cam1: [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    let at = |names: &[&str]| {
        let mut files: Vec<(&str, &str)> = names.iter().map(|name| (*name, camera)).collect();
        files.push(("vins.yaml", vins));
        xs(&files, &Options::default())
    };
    assert_eq!(at(&["right.yaml", "left.yaml"]), [2.0, 1.0]);
    assert_eq!(at(&["cam1.yaml"]), [2.0]);
    assert_eq!(at(&["front.yaml", "back.yaml"]), [1.0, 2.0]);
    let files = [
        ("cam1.yaml", camera),
        ("cam2.yaml", camera),
        ("vins.yaml", vins),
    ];
    let error = refusal(&files, &Options::default());
    assert!(error.contains("give cam0_calib"), "{error}");
}

#[test]
fn ros_cameras_stand_in_their_optical_frames() {
    let info = |name: &str, more: &str| {
        format!(
            "image_width: 640\nimage_height: 480\ncamera_name: {name}\ncamera_matrix: {{rows: 3, cols: 3, data: [500, \
             0, 320, 0, 500, 240, 0, 0, 1]}}\ndistortion_model: plumb_bob\ndistortion_coefficients: {{rows: 1, cols: \
             5, data: [0.1, 0, 0, 0, 0]}}\nprojection_matrix: {{rows: 3, cols: 4, data: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, \
             0]}}\n{more}"
        )
    };
    let optical = "rpy: [-1.5707963267948966, 0, -1.5707963267948966]";
    let frames = format!(
        "left_camera: {{parent: base, xyz: [1, 0, 0]}}\n\
         left_camera_optical_frame: {{parent: left_camera, {optical}}}\n"
    );
    for more in [
        "",
        "header: {frame_id: left_camera}\n",
        "header: {frame_id: left_camera_optical_frame}\n",
    ] {
        let camera = info("left_camera", more);
        let rig = read(
            &[("a.yaml", &camera), ("frames.yaml", &frames)],
            &Options::default(),
        )
        .unwrap()
        .rig;
        assert_pose(&rig.cameras()[0], X, [0.0, -1.0, 0.0], X);
    }
    // A body's frame whose optical one is called otherwise.
    let other = frames.replace("left_camera_optical_frame", "eye");
    let error = refusal(
        &[
            ("a.yaml", &info("left_camera", "")),
            ("frames.yaml", &other),
        ],
        &Options::default(),
    );
    assert!(
        error.contains("set the message's frame_id to `eye`"),
        "{error}"
    );
    // An optical frame that is stated and missing.
    let missing = info("left_camera", "header: {frame_id: left_optical_frame}\n");
    let error = refusal(
        &[("a.yaml", &missing), ("frames.yaml", &frames)],
        &Options::default(),
    );
    assert!(
        error.contains("states the optical frame `left_optical_frame`"),
        "{error}"
    );
    let link = frames.replace("left_camera_optical_frame", "left_optical_link");
    let rig = read(
        &[("a.yaml", &info("left", "")), ("frames.yaml", &link)],
        &Options::default(),
    )
    .unwrap()
    .rig;
    assert_pose(&rig.cameras()[0], X, [0.0, -1.0, 0.0], X);
}

#[test]
fn yaml_s_aliases_are_read_within_bounds() {
    let camera = |more: &str| {
        format!("  K: [[500, 0, 320], [0, 500, 240], [0, 0, 1]]\n  D: [0, 0, 0, 0, 0]\n{more}")
    };
    let text = format!(
        "left: &left\n{}  tvec: [0, 0, 0]\n  rvec: &turn [0, 0, 0]\nright:\n  <<: *left\n  rvec: *turn\n  tvec: [-1, 0, 0]\n",
        camera("  image_size: [640, 480]\n")
    );
    let rig = read(&[("rig.yaml", &text)], &scaled(1.0)).unwrap().rig;
    assert_pose(&rig.cameras()[1], X, X, Z);
    let mut bomb = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n".to_owned();
    for i in 1..9 {
        let all = vec![format!("*a{}", i - 1); 10].join(", ");
        bomb += &format!("a{i}: &a{i} [{all}]\n");
    }
    let error = refusal(&[("rig.yaml", &bomb)], &scaled(1.0));
    assert!(error.contains("repeat more than"), "{error}");
    for text in ["a: *b\n", "a:\n  <<: 3\n"] {
        refusal(&[("rig.yaml", text)], &scaled(1.0));
    }
}

#[test]
fn cameras_in_several_documents_are_a_list_and_lists_by_position_are_named() {
    let camera = |name: &str, x: f64| {
        format!("name: {name}\n{}\n", {
            let json = format!("{{{K}, {}}}", place(x));
            let value: serde_json::Value = serde_json::from_str(&json).unwrap();
            let entries = value.as_object().unwrap().iter();
            entries
                .map(|(key, value)| format!("{key}: {value}"))
                .collect::<Vec<_>>()
                .join("\n")
        })
    };
    let text = format!("{}---\n{}", camera("left", 1.0), camera("right", 2.0));
    assert_eq!(xs(&[("rig.yaml", &text)], &scaled(1.0)), [1.0, 2.0]);
    let k = "[[500, 0, 320], [0, 500, 240], [0, 0, 1]]";
    let lists = format!(
        r#"{{"K": [{k}, {k}], "dist": [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0]], "image_size": [640, 480]}}"#
    );
    let error = refusal(&[("a.json", &lists)], &scaled(1.0));
    assert!(error.contains("by position are not read"), "{error}");
}
