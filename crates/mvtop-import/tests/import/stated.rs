//! What a file states is read or named: lenses, places and sizes under other names, in other files, or in
//! text that cannot be read.

use mvtop_import::{Direction, ImageSize, Options};

use crate::{assert_params, assert_pose, read, read_bytes, refusal, scaled};

const K: &str = r#""K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]]"#;
const SIZE: &str = r#""image_size": [640, 480]"#;

fn size(text: &str, options: &Options) -> [u32; 2] {
    let rig = read(&[("a.json", text)], options).unwrap().rig;
    [rig.cameras()[0].width(), rig.cameras()[0].height()]
}

#[test]
fn lenses_are_read_under_their_many_names() {
    for name in [
        "distCoef",
        "dist_coef",
        "kc",
        "Distortion_Vector",
        "distortions",
        "coeffs",
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "{name}": [-0.2, 0.05, 0.001, -0.002, 0.01]}}"#);
        let rig = read(&[("a.json", &text)], &Options::default()).unwrap().rig;
        assert_params(&rig.cameras()[0], &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    }
}

#[test]
fn a_lens_that_is_stated_and_not_read_is_named() {
    for (key, value) in [
        ("RadialDistortion", "[-0.2, 0.05]"),
        ("my_dist", r#"{"a": 0.1}"#),
        ("lens_parameters_v2", "[0.1, 0.2]"),
        ("alpha_c", "0.01"),
        ("k7", "0.1"),
        ("tangential", "[0.1, 0.1]"),
        ("dist", "0.1"),
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "{key}": {value}}}"#);
        let error = refusal(&[("a.json", &text)], &Options::default());
        assert!(error.contains(&format!("`{key}`")), "{key}: {error}");
    }
    let text = format!(r#"{{{K}, {SIZE}, "lens_type": "mirror"}}"#);
    assert!(refusal(&[("a.json", &text)], &Options::default()).contains("\"mirror\""));
}

#[test]
fn what_is_no_lens_is_left_alone() {
    for (key, value) in [
        ("reprojection_error", "0.3"),
        ("stdDeviationsIntrinsics", "[0.1, 0.2]"),
        ("distance_to_board", "1.5"),
        ("board_width", "9"),
        ("lens", "\"8 mm\""),
        ("RadialDistortion", "[0, 0]"),
        ("P1", "[[500, 0, 320, 0], [0, 500, 240, 0], [0, 0, 1, 0]]"),
        ("rvecs", "[[0.1, 0.2, 0.3]]"),
        ("rms", "0.4"),
    ] {
        let text = format!(r#"{{{K}, {SIZE}, "dist": [0, 0, 0, 0, 0], "{key}": {value}}}"#);
        let imported = read(&[("a.json", &text)], &Options::default());
        assert!(
            imported.is_ok(),
            "{key}: {:?}",
            imported.unwrap_err().to_string()
        );
    }
}

#[test]
fn places_and_sizes_that_are_not_read_are_named() {
    for (text, key) in [
        (
            format!(r#"{{{K}, "frame_size_px": [640, 480]}}"#),
            "frame_size_px",
        ),
        (
            format!(r#"{{{K}, {SIZE}, "camera_position": [0.1, 0.2, 0.3]}}"#),
            "camera_position",
        ),
        (
            format!(r#"{{{K}, {SIZE}, "quaternion": [1, 0, 0, 0]}}"#),
            "quaternion",
        ),
    ] {
        let error = refusal(&[("a.json", &text)], &scaled(1.0));
        assert!(error.contains(&format!("`{key}`")), "{error}");
    }
}

#[test]
fn a_camera_matrix_is_3_by_3_whatever_its_name() {
    let text = format!(r#"{{{K}, {SIZE}, "m": 3, "intrinsics": [500, 500, 320, 240]}}"#);
    let error = refusal(&[("a.json", &text)], &Options::default());
    assert!(error.contains("the keys `intrinsics`, `m`"), "{error}");
    let ignoring = Options {
        ignore: vec!["m".into(), "intrinsics".into()],
        ..Options::default()
    };
    assert_eq!(size(&text, &ignoring), [640, 480]);
    let error = refusal(
        &[("a.json", r#"{"K": [500, 500, 320, 240]}"#)],
        &Options::default(),
    );
    assert!(
        error.contains("docs/how-to/import-a-calibration.md") && error.contains("rig.json"),
        "{error}"
    );
}

#[test]
fn rows_and_columns_are_told_from_width_and_height() {
    let of =
        |key: &str, value: &str| format!(r#"{{{K}, "{key}": {value}, "dist": [0, 0, 0, 0, 0]}}"#);
    let none = Options::default();
    assert_eq!(size(&of("image_size", "[640, 480]"), &none), [640, 480]);
    assert_eq!(size(&of("img_shape", "[480, 640]"), &none), [640, 480]);
    assert_eq!(size(&of("ImageSize", "[480, 640]"), &none), [640, 480]);
    assert_eq!(size(&of("ImageSize", "[640, 480]"), &none), [640, 480]);
    assert_eq!(size(&of("img_shape", "[500, 500]"), &none), [500, 500]);
    // The name says one thing, the principal point in the middle of the other another.
    for text in [
        of("image_size", "[480, 640]"),
        of("img_shape", "[640, 480]"),
    ] {
        let error = refusal(&[("a.json", &text)], &none);
        assert!(error.contains("--image-size"), "{error}");
        let told = Options {
            image_sizes: vec![ImageSize::parse("640x480").unwrap()],
            ..none.clone()
        };
        assert_eq!(size(&text, &told), [640, 480]);
    }
    // A principal point beside the middle of both tells nothing of a name that does not, either.
    let cropped = of("ImageSize", "[480, 640]")
        .replace("320", "100")
        .replace("240]", "100]");
    assert!(refusal(&[("a.json", &cropped)], &none).contains("--image-size"));
}

#[test]
fn intrinsics_and_places_are_joined_by_camera() {
    let lens = |focal: f64| {
        format!(
            r#"{{"K": [[{focal}, 0, 320], [0, {focal}, 240], [0, 0, 1]], "dist": [0, 0, 0, 0, 0], {SIZE}}}"#
        )
    };
    let place =
        |x: f64| format!(r#"{{"R": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "t": [{x}, 0, 0]}}"#);
    let lenses = format!(
        r#"{{"b": {}, "a": {}, "c": {}}}"#,
        lens(600.0),
        lens(500.0),
        lens(700.0)
    );
    let places = format!(
        r#"{{"c": {}, "a": {}, "b": {}}}"#,
        place(-3.0),
        place(-1.0),
        place(-2.0)
    );
    let one = format!(r#"{{"optics": {lenses}, "where": {places}}}"#);
    let (a, b) = (place(-1.0), place(-2.0));
    let nested = format!(
        r#"{{"a": {{"intrinsics": {}, "extrinsics": {a}}}, "b": {{"intrinsics": {}, "extrinsics": {b}}}}}"#,
        lens(500.0),
        lens(600.0)
    );
    let listed = format!(
        r#"{{"cameras": [{{"name": "a", {}, {{"name": "b", {}], "extrinsics": [{{"name": "b", {}, {{"name": "a", {}]}}"#,
        &lens(500.0)[1..],
        &lens(600.0)[1..],
        &b[1..],
        &a[1..]
    );
    let options = Options {
        direction: Some(Direction::CamFromWorld),
        ..scaled(0.1)
    };
    let ways: [&[(&str, &str)]; 5] = [
        &[("first.json", &lenses), ("second.json", &places)],
        &[("second.json", &places), ("first.json", &lenses)],
        &[("one.json", &one)],
        &[("one.json", &nested)],
        &[("one.json", &listed)],
    ];
    for files in ways {
        let rig = read(files, &options).unwrap().rig;
        // -Rᵀ t of t = (-x, 0, 0) is (0, -x, 0); the camera's x is the first row of R.
        for (id, focal, y) in [("a", 500.0, -0.1), ("b", 600.0, -0.2)] {
            let camera = &rig.cameras()[rig.index_of(id).unwrap()];
            assert_eq!(camera.intrinsics().fx(), focal);
            assert_pose(camera, [0.0, y, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
        }
    }
    let other = places.replace("\"a\"", "\"x\"");
    let error = refusal(
        &[("first.json", &lenses), ("second.json", &other)],
        &options,
    );
    assert!(
        error.contains("places of x, but the cameras are called a, b, c"),
        "{error}"
    );
    let twice = [
        ("first.json", &*lenses),
        ("second.json", &places),
        ("third.json", &places),
    ];
    let error = refusal(&twice, &options);
    assert!(error.contains("there twice"), "{error}");
}

#[test]
fn what_cannot_be_read_says_why() {
    let good = format!(r#"{{{K}, {SIZE}}}"#);
    let utf16: Vec<u8> = [0xfeff_u16]
        .into_iter()
        .chain(good.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    let comma = format!(r#"{{{K}, {SIZE},}}"#);
    let nan = good.replace("500, 0, 320", "NaN, 0, 320");
    for (name, bytes, words) in [
        ("a.json", utf16.as_slice(), "UTF-16; save it as UTF-8"),
        ("a.json", comma.as_bytes(), "trailing comma"),
        ("a.json", nan.as_bytes(), "NaN is no number"),
        (
            "a.yaml",
            b"[INFO] started\nimage_width: 640\n",
            "no YAML: line 1",
        ),
        ("a.toml", b"[cam_0]\nname = left\n", "no TOML: line 2"),
        ("a.xml", b"<opencv_storage><a></opencv_storage>", "no XML"),
    ] {
        let error = read_bytes(&[(name, bytes)], &Options::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "{error}");
        assert_eq!(error.matches(name).count(), 1, "{error}");
    }
}

#[test]
fn a_lens_that_folds_inside_its_image_is_refused_or_warned_of() {
    let text = |k1: f64| format!(r#"{{{K}, {SIZE}, "dist": [{k1}, 0, 0, 0, 0]}}"#);
    // r (1 + k1 r²) turns back at r² = -1 / (3 k1), which is imaged at 2/3 of that r: for -0.6 at 248 px
    // of 500, beyond which lies more than a third of 640 x 480 px; for -0.3 at 351 px, before the corners (400);
    // for -0.2 beyond them (430).
    let error = refusal(&[("a.json", &text(-0.6))], &Options::default());
    assert!(
        error.contains("folds inside its image") && error.contains("--max-angle"),
        "{error}"
    );
    let notes = |k1: f64| {
        read(&[("a.json", &text(k1))], &Options::default())
            .unwrap()
            .notes
            .join("; ")
    };
    assert!(
        notes(-0.3).contains("has no line of sight"),
        "{}",
        notes(-0.3)
    );
    assert_eq!(notes(-0.2), "");
    let limited = Options {
        max_angle: Some(35.0),
        ..Options::default()
    };
    let rig = read(&[("a.json", &text(-0.6))], &limited).unwrap().rig;
    assert_eq!(rig.cameras()[0].intrinsics().max_angle_deg(), Some(35.0));
}

#[test]
fn a_wide_lens_is_limited_to_the_angle_that_can_be_fitted() {
    let text = r#"{"K": [[1100, 0, 640], [0, 1100, 480], [0, 0, 1]], "image_size": [1280, 960], "xi": 1.25,
        "D": [-0.2, 0.06, 0.001, -0.0005]}"#;
    let error = refusal(&[("a.json", text)], &Options::default());
    let (_, degrees) = error.split_once("--max-angle ").expect(&error);
    let degrees: f64 = degrees.trim_end_matches(')').parse().unwrap();
    assert!(!error.contains("inf px"), "{error}");
    let limited = Options {
        max_angle: Some(degrees),
        ..Options::default()
    };
    let imported = read(&[("a.json", text)], &limited).unwrap();
    let lens = imported.rig.cameras()[0].intrinsics();
    assert_eq!(lens.max_angle_deg(), Some(degrees));
    // 30 degrees to the right, by Mei and Rives: r = s / (c + xi), then OpenCV's distortion.
    let r = 0.5 / (0.75f64.sqrt() + 1.25);
    let radial = 1.0 - 0.2 * r * r + 0.06 * r.powi(4);
    let (x, y) = (r * radial - 0.0005 * 3.0 * r * r, 0.001 * r * r);
    let pixel = lens
        .project(&nalgebra::Point3::new(0.5, 0.0, 0.75f64.sqrt()))
        .unwrap();
    let off = (pixel.x - 1100.0 * x - 640.0).hypot(pixel.y - 1100.0 * y - 480.0);
    assert!(off < 0.5, "{off} px: {:?}", imported.notes);
}

#[test]
fn every_format_names_what_of_a_lens_it_does_not_know() {
    let kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [500, 500, 320, 240]\n  \
                  resolution: [640, 480]\n  distortion_model: radtan\n  \
                  distortion_coeffs: [0.1, 0, 0, 0]\n  xi: 0.5\n";
    let ros = "image_width: 640\nimage_height: 480\ncamera_name: left\n\
               camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n\
               distortion_model: plumb_bob\ndistortion_coefficients: {data: [0.1, 0, 0, 0, 0]}\n\
               thin_prism_dist: [0.1, 0.2]\n";
    let nerf = r#"{"w": 640, "h": 480, "fl_x": 500, "cx": 320, "cy": 240, "k5": 0.1, "frames":
        [{"file_path": "a.png", "transform_matrix":
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}"#;
    let bop = r#"{"0": {"cam_K": [500, 0, 320, 0, 500, 240, 0, 0, 1], "k1": 0.1}}"#;
    let callab = "camera.0.A=[500 0 320; 0 500 240; 0 0 1]\ncamera.0.width=640\n\
                  camera.0.height=480\ncamera.0.k4=0.1\n";
    let euroc = "sensor_type: camera\nT_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, \
                 1, 0, 0, 0, 0, 1]}\nresolution: [752, 480]\ncamera_model: pinhole\n\
                 intrinsics: [458, 457, 367, 248]\ndistortion_model: radial-tangential\n\
                 distortion_coefficients: [-0.28, 0.07, 0, 0]\nmirror_parameters: {xi: 0.7}\n";
    for (file, text, key) in [
        ("camchain.yaml", kalibr, "xi"),
        ("left.yaml", ros, "thin_prism_dist"),
        ("transforms.json", nerf, "k5"),
        ("scene_camera.json", bop, "k1"),
        ("a.cal", callab, "k4"),
        ("sensor.yaml", euroc, "mirror_parameters"),
    ] {
        let error = refusal(&[(file, text)], &Options::default());
        let expected = format!("the key `{key}` is not known");
        assert!(error.contains(&expected), "{file}: {error}");
    }
}

#[test]
fn bop_s_camera_files_state_the_size_of_images() {
    let scene = |x: f64| {
        format!(
            r#"{{"0": {{"cam_K": [500, 0, 320, 0, 500, 240, 0, 0, 1],
                "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_w2c": [{x}, 0, 0]}}}}"#
        )
    };
    let camera = |width: u32| {
        format!(
            r#"{{"fx": 500, "fy": 500, "cx": 320, "cy": 240, "depth_scale": 0.1, "width": {width},
                "height": 480}}"#
        )
    };
    let (a, b) = (scene(0.0), scene(-200.0));
    let (small, large) = (camera(640), camera(656));
    let files = [
        ("scene_camera_cam1.json", a.as_str()),
        ("scene_camera_cam2.json", b.as_str()),
        ("camera_cam2.json", large.as_str()),
        ("camera_cam1.json", small.as_str()),
    ];
    let rig = read(&files, &Options::default()).unwrap().rig;
    let widths: Vec<_> = rig.cameras().iter().map(|c| (c.id(), c.width())).collect();
    assert_eq!(widths, [("cam1", 640), ("cam2", 656)]);
    let one = [
        ("scene_camera.json", a.as_str()),
        ("camera.json", small.as_str()),
    ];
    let rig = read(&one, &Options::default()).unwrap().rig;
    assert_eq!(rig.cameras()[0].width(), 640);
    let distorted = small.replace("\"fx\"", "\"k1\": 0.1, \"fx\"");
    let error = refusal(&[one[0], ("camera.json", &distorted)], &Options::default());
    assert!(error.contains("the key `k1` is not known"), "{error}");
}

#[test]
fn a_place_is_of_its_own_camera_and_none_is_left_out() {
    let r = "[[0, -1, 0], [1, 0, 0], [0, 0, 1]]";
    let camera = |x: f64| {
        format!(
            r#"{{{K}, {SIZE}, "dist": [0, 0, 0, 0, 0], "rvec": [0, 0, 0], "tvec": [{x}, 0, 0]}}"#
        )
    };
    let rig = format!(r#"{{"left": {}, "right": {}}}"#, camera(0.0), camera(-1.0));
    let unit = scaled(1.0);
    for (third, words) in [
        (
            format!(r#"{{"R": {r}, "T": [0.3, 0.2, 0.1]}}"#),
            "leave the wrong ones out",
        ),
        (
            r#"{"T_base_cam": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}"#
                .to_owned(),
            "places of base",
        ),
    ] {
        let error = refusal(&[("rig.json", &rig), ("base.json", &third)], &unit);
        assert!(error.contains(words), "{error}");
    }
    // What a pair's R and T say is not another thing where they agree: x_right = x_left - 1.
    let pair = r#"{"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [-1, 0, 0]}"#;
    let read = read(&[("rig.json", &rig), ("stereo.json", pair)], &unit);
    assert!(read.is_ok(), "{}", read.unwrap_err());

    let alone = format!(r#"{{"left": {{{K}, {SIZE}, "dist": [0, 0, 0, 0, 0]}}}}"#);
    for of_right in [
        format!(r#"{{"right": {{"R": {r}, "T": [1, 0, 0]}}}}"#),
        r#"{"right": {"dist": [0.1, 0, 0, 0, 0]}}"#.to_owned(),
    ] {
        let error = refusal(&[("in.json", &alone), ("ex.json", &of_right)], &unit);
        assert!(
            error.contains("of right, but the cameras are called left"),
            "{error}"
        );
    }
    let both = format!(
        r#"{{"left": {{{K}, {SIZE}}}, "right": {{{K}, {SIZE}}}, "third": {{"R": {r}, "T": [1, 0, 0]}}}}"#
    );
    let error = refusal(&[("rig.json", &both)], &unit);
    assert!(error.contains("places of third"), "{error}");
}

#[test]
fn sections_of_one_camera_are_joined_by_their_common_name() {
    let text = format!(
        r#"{{"rgbIntrinsic": {{{K}, {SIZE}}}, "rgbDistortion": {{"k1": 0.1, "k2": 0.02}},
            "irIntrinsic": {{{K}, {SIZE}}}, "irDistortion": {{"k1": 0.2, "k2": 0.03}},
            "irPose": {{"rvec": [0, 0, 0], "tvec": [1, 0, 0]}}, "rgb_pose": {{"rvec": [0, 0, 0], "tvec": [2, 0, 0]}}}}"#
    );
    let rig = read(&[("a.json", &text)], &scaled(1.0)).unwrap().rig;
    for (id, k1, x) in [("rgbIntrinsic", 0.1, -2.0), ("irIntrinsic", 0.2, -1.0)] {
        let camera = &rig.cameras()[rig.index_of(id).unwrap()];
        assert_eq!(camera.intrinsics().projection().params()[0], k1);
        assert_pose(camera, [x, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    }
}

#[test]
fn formats_are_told_by_their_structure_and_named_with_their_files() {
    let camera = format!(r#"{{{K}, {SIZE}, "dist": [0, 0, 0, 0, 0]}}"#);
    let cameras = format!(r#""left": {camera}, "right": {camera}"#);
    let place = |x: f64| format!(r#"{{"rvec": [0, 0, 0], "tvec": [{x}, 0, 0]}}"#);
    let places = format!(r#"{{"left": {}, "right": {}}}"#, place(0.0), place(-1.0));
    for key in ["transforms", "transform", "frames"] {
        let intrinsics = format!("{{{cameras}}}");
        let extrinsics = format!(r#"{{"{key}": {places}}}"#);
        let one = format!(r#"{{{cameras}, "{key}": {places}}}"#);
        for files in [
            &[("in.json", &*intrinsics), ("ex.json", &extrinsics)][..],
            &[("rig.json", &one)],
        ] {
            let imported = read(files, &scaled(1.0));
            let imported = imported.unwrap_or_else(|error| panic!("{key}: {error}"));
            assert_eq!(imported.format, mvtop_import::Format::OpenCv);
            let right = &imported.rig.cameras()[1];
            assert_pose(right, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        }
    }
    let list = "left: {parent: base, xyz: [0, 0, 0]}";
    let error = refusal(
        &[("left.json", &camera), ("frames.yaml", list)],
        &scaled(1.0),
    );
    assert!(
        error.contains("several formats (left.json: opencv, frames.yaml: ros)"),
        "{error}"
    );
}

#[test]
fn lists_of_pairs_have_the_names_of_their_keys_and_ini_files_are_called_so() {
    let camera = format!(
        r#"{{{K}, {SIZE}, "dist": [0, 0, 0, 0, 0], "rvec": [0, 0, 0], "tvec": [1, 0, 0]}}"#
    );
    let text = format!(r#"[[0, {camera}], [1, {camera}], ["top", {camera}]]"#);
    let text = text.replacen("[1, 0, 0]}", "[2, 0, 0]}", 1);
    let rig = read(&[("a.json", &text)], &scaled(1.0)).unwrap().rig;
    let ids: Vec<_> = rig.cameras().iter().map(|camera| camera.id()).collect();
    assert_eq!(ids, ["cam0", "cam1", "top"]);
    let nested = format!("[[{camera}], [{camera}]]");
    let error = refusal(&[("a.json", &nested)], &scaled(1.0));
    assert!(
        error.contains("a name of its own, as that of its file or in its entry"),
        "{error}"
    );
    let ini = "; a rig\n[left]\nfx = 905.5\nfy = 911\n";
    let error = refusal(&[("a.ini", ini)], &scaled(1.0));
    assert!(
        error.contains("an INI file of a program that is not known"),
        "{error}"
    );
}
