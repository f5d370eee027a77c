//! What is stated and not read is refused by its name, wherever it stands; what is stated in another place than
//! beside the camera's matrix is read.

mod keys;

use mvtop_import::{Direction, Options, Unit};

use crate::{assert_params, assert_pose, read, refusal, scaled};

const K: &str = r#""K": [[1104.25, 0, 633.1], [0, 1105.5, 481.7], [0, 0, 1]]"#;
const SIZE: &str = r#""image_size": [1280, 960]"#;
const D: &str = "[-0.1875, 0.0625, 0.00075, -0.0005, 0]";
const R: &str = "[[0, -1, 0], [1, 0, 0], [0, 0, 1]]";

fn placed() -> Options {
    Options {
        unit: Some(Unit::Metre),
        direction: Some(Direction::CamFromWorld),
        ..Options::default()
    }
}

#[test]
fn a_lens_is_named_by_many_keys() {
    for more in [
        r#""type": "fisheye""#,
        r#""lens": "fisheye""#,
        r#""projection": "equidistant""#,
        r#""camera_type": "KannalaBrandt8""#,
        r#""fisheye": "true""#,
        r#""model": {"name": "fisheye", "type": "fisheye"}"#,
        r#""camera_model": "pinhole", "distortion_model": "equidistant""#,
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "k1": -0.01, "k2": 0.001, {more}}}"#);
        let rig = read(&[("a.json", &text)], &Options::default()).unwrap().rig;
        let lens = rig.cameras()[0].intrinsics().projection();
        assert_eq!(lens.family(), "fisheye", "{more}");
    }
    let text = format!(r#"{{{K}, {SIZE}, "model": "fisheye", "D": [0.01, 0.001, 0, 0]}}"#);
    let pinhole = Options {
        model: Some("pinhole".into()),
        ..Options::default()
    };
    let error = refusal(&[("a.json", &text)], &pinhole);
    assert!(error.contains("--model pinhole"), "{error}");
}

#[test]
fn lenses_are_read_wherever_they_stand() {
    let k = |focal: f64| format!(r#""K": [[{focal}, 0, 633], [0, {focal}, 481], [0, 0, 1]]"#);
    let matrix = |focal: f64| k(focal)[5..].to_owned();
    let place = |x: f64| format!(r#""R": {R}, "t": [{x}, 0, 0]"#);
    let (a, b) = (k(1000.0), k(1100.0));
    let (pa, pb) = (place(-1.0), place(-2.0));
    let cameras = format!(r#""cameras": {{"left": {{{a}, {pa}}}, "right": {{{b}, {pb}}}}}"#);
    let intrinsics = format!(r#"{{{SIZE}, "left": {{{a}}}, "right": {{{b}}}}}"#);
    let places = format!(r#"{{"left": {{{pa}}}, "right": {{{pb}}}}}"#);
    let places_and_lenses =
        format!(r#"{{"left": {{{pa}, "dist": {D}}}, "right": {{{pb}, "dist": {D}}}}}"#);
    let lenses = format!(r#"{{"left": {{"dist": {D}}}, "right": {{"dist": {D}}}}}"#);
    let shared = format!(r#"{{{SIZE}, "dist": {D}, {cameras}}}"#);
    let (ma, mb) = (matrix(1000.0), matrix(1100.0));
    let by_kind = format!(
        r#"{{{SIZE}, "K": {{"left": {ma}, "right": {mb}}}, "dist": {{"left": {D}, "right": {D}}},
            "R": {{"left": {R}, "right": {R}}}, "t": {{"left": [-1, 0, 0], "right": [-2, 0, 0]}}}}"#
    );
    let sections = format!(
        r#"{{"intrinsics": {intrinsics}, "distortion": {{"left": {D}, "right": {D}}}, "extrinsics": {places}}}"#
    );
    let suffixes = format!(
        r#"{{{SIZE}, "K_left": {ma}, "K_right": {mb}, "dist_l": {D}, "dist_r": {D}, "R_left": {R}, "R_right": {R},
            "t_left": [-1, 0, 0], "t_right": [-2, 0, 0]}}"#
    );
    let ways: [&[(&str, &str)]; 6] = [
        &[("all.json", &shared)],
        &[("i.json", &intrinsics), ("e.json", &places_and_lenses)],
        &[
            ("i.json", &intrinsics),
            ("e.json", &places),
            ("d.json", &lenses),
        ],
        &[("all.json", &by_kind)],
        &[("all.json", &sections)],
        &[("all.json", &suffixes)],
    ];
    for files in ways {
        let imported = read(files, &placed());
        let rig = imported
            .unwrap_or_else(|error| panic!("{files:?}: {error}"))
            .rig;
        for (id, focal, y) in [("left", 1000.0, -1.0), ("right", 1100.0, -2.0)] {
            let camera = &rig.cameras()[rig.index_of(id).unwrap()];
            assert_eq!(camera.intrinsics().fx(), focal);
            assert_eq!([camera.width(), camera.height()], [1280, 960]);
            assert_params(camera, &[-0.1875, 0.0625, 0.00075, -0.0005]);
            assert_pose(camera, [0.0, y, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
        }
    }
    let lens_of_none = lenses.replace("right", "middle");
    let files = [
        ("i.json", &*intrinsics),
        ("e.json", &places),
        ("d.json", &lens_of_none),
    ];
    let error = refusal(&files, &placed());
    assert!(
        error.contains("of middle, but the cameras are called left, right"),
        "{error}"
    );
    let twice = shared.replace(
        "\"cameras\": {\"left\": {",
        "\"cameras\": {\"left\": {\"dist\": [0.1, 0, 0, 0, 0], ",
    );
    assert!(refusal(&[("a.json", &twice)], &placed()).contains("`D` is there twice"));
}

#[test]
fn a_kind_is_not_dropped_where_another_thing_is_called_like_its_camera() {
    let text = format!(r#"{{"a": {{{K}, {SIZE}}}, "left": 0, "dist": {{"left": {D}}}}}"#);
    let error = refusal(&[("rig.json", &text)], &Options::default());
    assert!(error.contains("`dist`"), "{error}");
}

#[test]
fn lists_are_joined_by_what_names_their_entries() {
    let camera = |key: &str, name: &str, focal: f64| {
        format!(
            r#"{{"{key}": "{name}", {SIZE}, "K": [[{focal}, 0, 633], [0, {focal}, 481], [0, 0, 1]], "dist": {D}}}"#
        )
    };
    let place = |key: &str, name: &str, x: f64| {
        format!(r#"{{"{key}": "{name}", "R": {R}, "t": [{x}, 0, 0]}}"#)
    };
    for key in ["serial_number", "label", "cam", "cameraName"] {
        let intrinsics = format!(
            "[{}, {}]",
            camera(key, "left", 1000.0),
            camera(key, "right", 1100.0)
        );
        let places = format!(
            "[{}, {}]",
            place(key, "right", -2.0),
            place(key, "left", -1.0)
        );
        let files = [("i.json", &*intrinsics), ("e.json", &*places)];
        let rig = read(&files, &placed()).unwrap().rig;
        let left = &rig.cameras()[rig.index_of("left").unwrap()];
        assert_eq!(left.intrinsics().fx(), 1000.0);
        assert_pose(left, [0.0, -1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
    }
    let one = format!("{{{K}, {SIZE}, \"dist\": {D}}}");
    let several = format!(
        r#"{{"cam0": {{"R": {R}, "t": [1, 0, 0]}}, "cam1": {{"R": {R}, "t": [2, 0, 0]}}}}"#
    );
    let error = refusal(&[("top.json", &one), ("e.json", &several)], &placed());
    assert!(
        error.contains("places of cam0, cam1, but the cameras are called top"),
        "{error}"
    );
}

#[test]
fn a_place_is_stated_once() {
    let matrix = "[[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]";
    for (more, words) in [
        (
            format!(r#""R": {R}, "rvec": [0.1, 0, 0], "t": [1, 0, 0]"#),
            "different rotations",
        ),
        (
            format!(r#""T_cam_world": {matrix}, "rvec": [0.1, 0, 0], "t": [1, 0, 0]"#),
            "there twice",
        ),
        (
            format!(r#""T_cam_world": {matrix}, "T_world_cam": {matrix}"#),
            "there twice",
        ),
        (
            r#""ppx": 633, "R": [0, -1, 0, 1, 0, 0, 0, 0, 1], "t": [1, 0, 0]"#.into(),
            "columns to librealsense",
        ),
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "dist": {D}, {more}}}"#);
        let error = refusal(&[("a.json", &text)], &placed());
        assert!(error.contains(words), "{more}: {error}");
    }
}

#[test]
fn a_unit_that_is_stated_is_read() {
    let text = |unit: &str| {
        format!(
            r#"{{"unit": "{unit}", {K}, {SIZE}, "dist": {D}, "rvec": [0, 0, 0], "t": [-200, 0, 0]}}"#
        )
    };
    let rig = read(&[("a.json", &text("mm"))], &Options::default())
        .unwrap()
        .rig;
    assert_pose(
        &rig.cameras()[0],
        [0.2, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
    );
    let error = refusal(&[("a.json", &text("mm"))], &scaled(1.0));
    assert!(error.contains("unit of length"), "{error}");
    let error = refusal(&[("a.json", &text("furlong"))], &Options::default());
    assert!(error.contains("expected m, cm or mm"), "{error}");
}

#[test]
fn sizes_are_read_under_their_many_names_and_stated_once() {
    let size = |more: &str| {
        let text = format!(r#"{{{K}, "dist": {D}, {more}}}"#);
        let rig = read(&[("a.json", &text)], &Options::default()).unwrap().rig;
        [rig.cameras()[0].width(), rig.cameras()[0].height()]
    };
    for more in [
        r#""rows": 960, "cols": 1280"#,
        r#""H": 960, "W": 1280"#,
        r#""hw": [960, 1280]"#,
        r#""resolution": "1280x960""#,
        r#""img_width": 1280, "img_height": 960"#,
        r#""img_shape": [960, 1280, 3]"#,
        r#""image_size": {"width": 1280, "height": 960}"#,
    ] {
        assert_eq!(size(more), [1280, 960], "{more}");
    }
    let off = K.replace("633.1", "680").replace("481.7", "418");
    for (text, words) in [
        (
            format!(r#"{{{K}, {SIZE}, "width": 640, "height": 480}}"#),
            "differ; leave one out",
        ),
        (
            format!(r#"{{{off}, "image_size": [960, 1280]}}"#),
            "--image-size WxH",
        ),
        (
            format!(r#"{{{off}, "img_shape": [1280, 960]}}"#),
            "--image-size WxH",
        ),
    ] {
        let error = refusal(&[("a.json", &text)], &Options::default());
        assert!(error.contains(words), "{text}: {error}");
    }
}

#[test]
fn other_formats_do_not_put_their_own_lens_over_one_that_is_named() {
    let multical = format!(
        r#"{{"cameras": {{"left": {{{K}, {SIZE}, "dist": [0.01, -0.002, 0.001, 0.0005], "model": "fisheye"}}}},
            "camera_poses": {{"left": {{"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [0, 0, 0]}}}}}}"#
    );
    let anipose = "[cam_0]\nname = \"left\"\nsize = [1280, 960]\n\
        matrix = [[1104.25, 0.0, 633.1], [0.0, 1105.5, 481.7], [0.0, 0.0, 1.0]]\n\
        distortions = [0.01, -0.002, 0.001, 0.0005]\nrotation = [0.0, 0.0, 0.0]\n\
        translation = [0.0, 0.0, 0.0]\nfisheye = \"true\"\n";
    for (name, text) in [("calibration.json", &*multical), ("calib.toml", anipose)] {
        let rig = read(&[(name, text)], &placed()).unwrap().rig;
        let lens = rig.cameras()[0].intrinsics().projection();
        assert_eq!(lens.family(), "fisheye", "{name}");
    }
    let kappa = format!("{anipose}kappa = 0.1\n");
    let error = refusal(&[("calib.toml", &kappa)], &placed());
    assert!(error.contains("the key `kappa` is not known"), "{error}");
}

#[test]
fn a_region_of_interest_is_the_whole_image_or_of_rectified_images() {
    let p = "[[1100, 0, 633, 0], [0, 1100, 481, 0], [0, 0, 1, 0]]";
    let with = |more: &str| format!(r#"{{{K}, {SIZE}, "D": {D}, {more}}}"#);
    for more in [
        r#""roi": [0, 0, 1280, 960]"#.to_owned(),
        r#""roi": [0, 0, 0, 0]"#.to_owned(),
        r#""roi": {"x_offset": 0, "y_offset": 0, "width": 1280, "height": 960, "do_rectify": false}"#.to_owned(),
        format!(r#""P1": {p}, "roi1": [12, 8, 1200, 900]"#),
    ] {
        let imported = read(&[("a.json", &with(&more))], &Options::default());
        assert!(imported.is_ok(), "{more}: {}", imported.unwrap_err());
    }
    for more in [
        r#""roi": [320, 200, 640, 480]"#,
        r#""roi": [0, 0, 640, 480]"#,
        r#""crop_roi": {"x": 320, "y": 200, "width": 640, "height": 400}"#,
        r#""roi": {"x1": 320, "y1": 200, "width": 1280, "height": 960}"#,
    ] {
        let error = refusal(&[("a.json", &with(more))], &Options::default());
        assert!(
            error.contains("expected the whole image"),
            "{more}: {error}"
        );
    }
}

#[test]
fn a_text_about_a_lens_an_image_or_a_place_says_the_plain_default_or_is_named() {
    let with = |more: &str| format!(r#"{{{K}, {SIZE}, "D": {D}, {more}}}"#);
    for (key, text) in [
        ("projection", "equisolid"),
        ("projection", "stereographic"),
        ("type", "division"),
        ("type", "polynomial"),
        ("kind", "ocam"),
        ("lens", "ultra wide 190 deg"),
        ("camera_type", "Panoramic"),
        ("flip", "horizontal"),
        ("rotate", "ROTATE_90_CLOCKWISE"),
        ("mirrored", "yes"),
        ("rotate", "left"),
        ("orientation", "portrait_upside_down"),
        ("axes", "right-handed, y up"),
        ("convention", "opengl"),
        ("direction", "robot_to_camera"),
        ("extrinsics_type", "inverse"),
        ("angle_unit", "deg"),
        ("rotation_order", "xyz"),
    ] {
        let error = refusal(
            &[("a.json", &with(&format!(r#""{key}": "{text}""#)))],
            &Options::default(),
        );
        assert!(
            error.contains(&format!("the key `{key}` is not known")),
            "{key}: {error}"
        );
    }
    for (key, text) in [
        ("flip", "none"),
        ("rotate", "0"),
        ("orientation", "landscape"),
        ("type", "rgb"),
        ("convention", "OpenCV"),
        ("angle_unit", "rad"),
        ("camera_type", "pinhole"),
    ] {
        let imported = read(
            &[("a.json", &with(&format!(r#""{key}": "{text}""#)))],
            &Options::default(),
        );
        assert!(imported.is_ok(), "{key}: {}", imported.unwrap_err());
    }
}

#[test]
fn a_direction_that_is_stated_is_read() {
    let file = |direction: &str, place: &str| {
        format!(
            r#"{{"extrinsics_type": "{direction}", "cameras": [{{"id": "a", {K}, {SIZE}, "D": {D}, {place}}}]}}"#
        )
    };
    let metre = Options {
        unit: Some(Unit::Metre),
        ..Options::default()
    };
    let turn = format!(r#""R": {R}, "t": [1, 0, 0]"#);
    let vector = r#""rvec": [0, 0, 1.5707963267948966], "tvec": [1, 0, 0]"#;
    for place in [turn.as_str(), vector] {
        let x = |direction: &str| {
            let rig = read(&[("a.json", &file(direction, place))], &metre)
                .unwrap()
                .rig;
            let at = rig.cameras()[0].world_from_cam().translation.vector;
            [at.x, at.y]
        };
        crate::assert_near(x("camera_to_world"), [1.0, 0.0]);
        // -Rᵀ t.
        crate::assert_near(x("world_to_camera"), [0.0, 1.0]);
    }
    let matrix = r#""T_world_cam": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"#;
    let error = refusal(&[("a.json", &file("w2c", matrix))], &metre);
    assert!(error.contains("do not agree"), "{error}");
    let other = Options {
        direction: Some(Direction::CamFromWorld),
        ..metre
    };
    let error = refusal(&[("a.json", &file("c2w", &turn))], &other);
    assert!(error.contains("--direction"), "{error}");
}
