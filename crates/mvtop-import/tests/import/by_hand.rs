//! One case of each format whose rig is worked out by hand: direction, axes, order, half a pixel, unit.

mod ros;

use mvtop_import::{Direction, Format, ImageSize, Options};
use nalgebra::Point3;

use crate::{assert_near, assert_plane, assert_pose, read, read_bytes, scaled};

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];
const MINUS_Z: [f64; 3] = [0.0, 0.0, -1.0];

const STEREO: &str = "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ \
    700., 0., 320., 0., 710., 240., 0., 0., 1. ]\nD1: !!opencv-matrix\n   rows: 1\n   cols: 14\n   dt: d\n   \
    data: [ -1.0e-01, 2.0e-02, 0., 0., 0., 0., 0., 3.0e-02, 0., 0., 0., 0., 0., 0. ]\nM2: \
    !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 600., 0., 330., 0., 610., 250., 0., 0., \
    1. ]\nD2: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n";
/// A quarter turn about z, and 4 squares.
const PAIR: &str = "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 0., -1., \
    0., 1., 0., 0., 0., 0., 1. ]\nT: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -4., 0., 0. ]\n\
    R1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n";

#[test]
fn opencv_pair_maps_the_first_camera_to_the_second() {
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..scaled(0.025)
    };
    let imported = read(&[("in.yml", STEREO), ("ex.yml", PAIR)], &options).unwrap();
    assert_eq!(imported.format, Format::OpenCv);
    let [first, second] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((first.id(), second.id()), ("cam1", "cam2"));
    assert_pose(first, [0.0; 3], X, Z);
    // -Rᵀ T is (0, -4, 0) squares; the second camera's x is the first row of R.
    assert_pose(second, [0.0, -0.1, 0.0], [0.0, -1.0, 0.0], Z);
    assert_plane(first, [700.0, 710.0, 320.0, 240.0]);
    let params = first.intrinsics().projection().params();
    assert_eq!(params, [-0.1, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.03]);
    assert!(second.intrinsics().is_pinhole());
}

#[test]
fn opencv_cameras_come_in_the_order_of_their_files() {
    let camera = |focal: f64| {
        format!(
            r#"{{"K": [[{focal}, 0, 320], [0, {focal}, 240], [0, 0, 1]], "dist": [0, 0, 0, 0, 0],
            "image_size": [640, 480]}}"#
        )
    };
    let (rgb, ir) = (camera(900.0), camera(600.0));
    let files = [("rgb.json", &*rgb), ("ir.json", &*ir), ("ex.yml", PAIR)];
    let rig = read(&files, &scaled(0.025)).unwrap().rig;
    let [first, second] = rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((first.id(), second.id()), ("rgb", "ir"));
    assert_eq!(rig.reference_camera().id(), "rgb");
    assert_pose(first, [0.0; 3], X, Z);
    assert_pose(second, [0.0, -0.1, 0.0], [0.0, -1.0, 0.0], Z);
    assert_plane(second, [600.0, 600.0, 320.0, 240.0]);
    // So do those of a list; of keys, only numbers and sides say which camera comes first.
    let list = [("rgb", &rgb), ("ir", &ir)]
        .map(|(name, camera)| camera.replacen('{', &format!("{{\"name\": \"{name}\", "), 1));
    let list = format!("[{}]", list.join(", "));
    let first = |text: &str| {
        let rig = read(&[("in.json", text), ("ex.yml", PAIR)], &scaled(0.025));
        rig.map(|imported| imported.rig.reference_camera().id().to_owned())
    };
    assert_eq!(first(&list).unwrap(), "rgb");
    let keys = |a: &str, b: &str| format!(r#"{{"{a}": {rgb}, "{b}": {ir}}}"#);
    assert_eq!(first(&keys("my_left", "my_right")).unwrap(), "my_left");
    assert_eq!(first(&keys("Right", "Left")).unwrap(), "Left");
    assert_eq!(first(&keys("eye_r", "eye_l")).unwrap(), "eye_l");
    assert_eq!(first(&keys("cam1_info", "cam0_info")).unwrap(), "cam0_info");
    assert_eq!(first(&keys("cam1", "cam0")).unwrap(), "cam0");
    assert_eq!(first(&keys("cam10", "cam9")).unwrap(), "cam9");
    for (a, b) in [("rgb", "ir"), ("cam9a", "cam10b"), ("final", "sensor")] {
        let error = first(&keys(a, b)).unwrap_err().to_string();
        assert!(error.contains("a file of its own"), "{error}");
    }
}

#[test]
fn opencv_cameras_of_one_file_come_in_the_order_of_their_numbers() {
    let numbers = 1..=11;
    // `end`: of the keys of one camera.
    let camera = |i: u32, end: &str| {
        format!(
            r#""K{end}": [[{}, 0, 320], [0, 500, 240], [0, 0, 1]], "dist{end}": [0, 0, 0, 0, 0],
            "size{end}": [640, 480], "rvec{end}": [0, 0, 0], "tvec{end}": [{i}, 0, 0]"#,
            500 + i
        )
    };
    let joined = |each: &dyn Fn(u32) -> String| {
        let all: Vec<String> = numbers.clone().map(each).collect();
        format!("{{{}}}", all.join(", "))
    };
    let flat = joined(&|i| camera(i, &i.to_string()));
    let nested = joined(&|i| format!(r#""Cam{i}": {{{}}}"#, camera(i, "")));
    for (text, id) in [(flat, "cam"), (nested, "Cam")] {
        let rig = read(&[("rig.json", &text)], &scaled(1.0)).unwrap().rig;
        let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
        let expected: Vec<String> = numbers.clone().map(|i| format!("{id}{i}")).collect();
        assert_eq!(ids, expected);
        for (i, camera) in numbers.clone().zip(rig.cameras()) {
            assert_eq!(camera.intrinsics().fx(), f64::from(500 + i));
        }
    }
}

#[test]
fn opencv_rectification_of_a_pair_is_not_used() {
    let turns = PAIR.replace("R1:", "R2:").replace("%YAML:1.0\n---\n", "");
    let turns = &turns[turns.find("R2:").unwrap()..];
    let one = format!("{STEREO}{}{turns}", PAIR.replace("%YAML:1.0\n---\n", ""));
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..scaled(0.025)
    };
    let rig = read(&[("stereo.yml", &one)], &options).unwrap().rig;
    let apart = [("in.yml", STEREO), ("ex.yml", PAIR)];
    assert_eq!(rig, read(&apart, &options).unwrap().rig);
}

#[test]
fn opencv_rvec_and_tvec_of_each_camera_map_world_to_camera() {
    let quarter = std::f64::consts::FRAC_PI_2;
    let text = format!(
        r#"{{"left": {{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "dist": [[0.1, 0, 0, 0, 0]],
             "image_size": [640, 480], "rvec": [0, 0, 0], "tvec": [[0], [0], [0]]}},
            "right": {{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "dist": [0.1, 0, 0, 0, 0],
             "image_size": [640, 480], "rvec": [0, {quarter}, 0], "tvec": [1, 0, 0]}}}}"#
    );
    let imported = read(&[("rig.json", &text)], &scaled(0.5)).unwrap();
    assert_eq!(imported.format, Format::OpenCv);
    // A quarter turn about y takes x to -z and z to x, so z of the camera is -x of the world.
    let right = &imported.rig.cameras()[1];
    assert_pose(right, [0.0, 0.0, -0.5], Z, [-1.0, 0.0, 0.0]);
}

#[test]
fn skew_of_a_camera_matrix_is_kept() {
    let text = r#"{"a": {"K": [[500, 2.5, 320], [0, 500, 240], [0, 0, 1]], "dist": [0, 0, 0, 0, 0],
        "image_size": [640, 480], "rvec": [0, 0, 0], "tvec": [0, 0, 0]}}"#;
    let rig = read(&[("rig.json", text)], &scaled(1.0)).unwrap().rig;
    let lens = rig.cameras()[0].intrinsics();
    let pixel = lens.project(&Point3::new(0.0, 0.2, 1.0)).unwrap();
    assert_near([pixel.x, pixel.y], [320.5, 340.0]);
}

#[test]
fn size_of_other_images_is_noticed_by_the_principal_point() {
    let notes = |size: &str| {
        let options = Options {
            image_sizes: vec![ImageSize::parse(size).unwrap()],
            ..scaled(0.025)
        };
        let imported = read(&[("in.yml", STEREO), ("ex.yml", PAIR)], &options);
        imported.unwrap().notes.join("\n")
    };
    // Principal points at 320 240 and 330 250.
    assert!(!notes("640x480").contains("principal point"));
    let said = notes("320x240");
    assert!(
        said.contains("`cam1`: warning: its principal point, 320 240"),
        "{said}"
    );
    assert!(said.contains("middle of images of 320x240 px"), "{said}");
}

#[test]
fn kalibr_chain_goes_from_camera_to_camera() {
    let camera = "camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [0.1, 0.02, \
                  0.003, 0.0004]\n  intrinsics: [300, 301, 320, 240]\n  resolution: [640, 480]\n";
    let next =
        "  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n";
    let text = format!("cam0:\n  {camera}cam1:\n  {camera}{next}cam2:\n  {camera}{next}");
    let imported = read(&[("camchain.yaml", &text)], &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Kalibr);
    let cameras = imported.rig.cameras();
    assert_pose(&cameras[1], [0.1, 0.0, 0.0], X, Z);
    assert_pose(&cameras[2], [0.2, 0.0, 0.0], X, Z);
    // Four coefficients are a fisheye's by the name of the model.
    let projection = cameras[0].intrinsics().projection();
    assert_eq!(projection.distortion(), Some("kannala_brandt"));
    assert_eq!(projection.params(), [0.1, 0.02, 0.003, 0.0004]);
}

#[test]
fn kalibr_states_imu_to_camera_and_openvins_camera_to_imu() {
    let camera = "camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0.1, 0.02, \
                  0.003, 0.0004]\n  intrinsics: [300, 301, 320, 240]\n  resolution: [640, 480]\n";
    // Camera x is IMU y; the origin moves by (0, 0, 1) in camera coordinates.
    let turn = "\n  - [0, 1, 0, 0]\n  - [-1, 0, 0, 0]\n  - [0, 0, 1, 1]\n  - [0, 0, 0, 1]\n";
    let kalibr = format!("cam0:\n  {camera}  T_cam_imu:{turn}");
    let rig = read(&[("a.yaml", &kalibr)], &Options::default())
        .unwrap()
        .rig;
    assert_pose(&rig.cameras()[0], [0.0, 0.0, -1.0], Y, Z);
    let openvins = format!("%YAML:1.0\ncam0:\n  {camera}  T_imu_cam:{turn}");
    let rig = read(&[("a.yaml", &openvins)], &Options::default())
        .unwrap()
        .rig;
    assert_pose(&rig.cameras()[0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], Z);
    let distortion = rig.cameras()[0].intrinsics().projection().distortion();
    assert_eq!(distortion, Some("brown_conrady"));
}

const CAMERAS: &str = "# CAMERA_ID, MODEL, ...\n7 SIMPLE_RADIAL 640 480 500 320 240 0.05\n";
/// Half a turn about x: world to camera.
const IMAGES: &str = "# IMAGE_ID, QW, QX, ...\n1 1 0 0 0 0 0 0 7 a/left.png\n\n2 0 1 0 0 2 0 3 7 a/top view.png\n\
    10 20 -1\n";

#[test]
fn colmap_pixels_count_from_the_corner_and_poses_go_to_the_camera() {
    let files = [("cameras.txt", CAMERAS), ("images.txt", IMAGES)];
    let imported = read(&files, &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::Colmap);
    let [left, top] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((left.id(), top.id()), ("a_left", "a_top_view"));
    assert_plane(left, [500.0, 500.0, 319.5, 239.5]);
    assert_eq!(left.intrinsics().projection().params()[..2], [0.05, 0.0]);
    // -Rᵀ t with R = diag(1, -1, -1).
    assert_pose(top, [-0.2, 0.0, 0.3], X, MINUS_Z);
}

#[test]
fn colmap_binary_says_the_same_as_its_text() {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend([7u32, 2].iter().flat_map(|n| n.to_le_bytes()));
    cameras.extend([640u64, 480].iter().flat_map(|n| n.to_le_bytes()));
    cameras.extend(
        [500.0f64, 320.0, 240.0, 0.05]
            .iter()
            .flat_map(|n| n.to_le_bytes()),
    );
    let mut images = 2u64.to_le_bytes().to_vec();
    let rows = [
        (
            1u32,
            [1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            "a/left.png",
            0u64,
        ),
        (2, [0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 3.0], "a/top view.png", 1),
    ];
    for (id, pose, name, points) in rows {
        images.extend(id.to_le_bytes());
        images.extend(pose.iter().flat_map(|n| n.to_le_bytes()));
        images.extend(7u32.to_le_bytes());
        images.extend(name.bytes().chain([0]));
        images.extend(points.to_le_bytes());
        images.extend(vec![0; 24 * points as usize]);
    }
    let binary = [("cameras.bin", &cameras[..]), ("images.bin", &images[..])];
    let text = [("cameras.txt", CAMERAS), ("images.txt", IMAGES)];
    let rig = read_bytes(&binary, &scaled(0.1)).unwrap().rig;
    assert_eq!(rig, read(&text, &scaled(0.1)).unwrap().rig);
    for end in [0, 7, 20, images.len() - 1] {
        let cut = [
            ("cameras.bin", &cameras[..]),
            ("images.bin", &images[..end]),
        ];
        let error = read_bytes(&cut, &scaled(0.1)).unwrap_err().to_string();
        assert!(error.contains("ends"), "{error}");
    }
}

#[test]
fn bop_is_in_millimetres_from_world_to_camera() {
    let camera = r#"{"cam_K": [500, 0, 320, 0, 510, 240, 0, 0, 1], "depth_scale": 1.0,
        "cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "cam_t_w2c": [200, 0, 300]}"#;
    let still = camera.replace("[200, 0, 300]", "[0, 0, 300]");
    let (one, two) = (
        format!("{{\"0\": {camera}}}"),
        format!("{{\"0\": {still}}}"),
    );
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..Options::default()
    };
    let files = [
        ("scene_camera_cam1.json", &*one),
        ("scene_camera_cam2.json", &*two),
    ];
    let imported = read(&files, &options).unwrap();
    assert_eq!(imported.format, Format::Bop);
    let first = &imported.rig.cameras()[0];
    assert_eq!(first.id(), "cam1");
    assert_pose(first, [-0.2, 0.0, 0.3], X, MINUS_Z);
    assert_plane(first, [500.0, 510.0, 320.0, 240.0]);
    let frames = format!("{{\"3\": {camera}, \"12\": {still}}}");
    let rig = read(&[("scene_camera.json", &*frames)], &options)
        .unwrap()
        .rig;
    let ids: Vec<_> = rig.cameras().iter().map(|camera| camera.id()).collect();
    assert_eq!(ids, ["000003", "000012"]);
}

#[test]
fn bop_camera_that_moves_is_noticed_whatever_its_keys_are_called() {
    let camera = r#"{"cam_K": [500, 0, 320, 0, 510, 240, 0, 0, 1], "cam_dist": [0.1, 0, 0, 0, 0],
        "R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "t_w2c": [200, 0, 300], "depth_scale": SCALE}"#;
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..Options::default()
    };
    let with = |from: &str, to: &str| {
        let first = camera.replace("SCALE", "1.0");
        let next = camera.replace("SCALE", "0.1").replace(from, to);
        let moving = format!("{{\"0\": {first}, \"1\": {next}}}");
        let other = format!("{{\"0\": {}}}", first.replace("[200", "[0"));
        let files = [
            ("scene_camera_a.json", &*moving),
            ("scene_camera_b.json", &*other),
        ];
        read(&files, &options)
    };
    // What is no part of the camera may change.
    assert_eq!(with("", "").unwrap().rig.cameras().len(), 2);
    for (from, to) in [
        ("[200, 0, 300]", "[600, 0, 300]"),
        (
            "[1, 0, 0, 0, -1, 0, 0, 0, -1]",
            "[1, 0, 0, 0, 1, 0, 0, 0, 1]",
        ),
        ("[0.1,", "[0.2,"),
        ("[500,", "[501,"),
    ] {
        let error = with(from, to).unwrap_err().to_string();
        assert!(error.contains("image 0 is not that of image 1"), "{error}");
    }
}

#[test]
fn nerf_axes_are_opengl_s() {
    let text = r#"{"w": 640, "h": 480, "fl_x": 500, "fl_y": 510, "cx": 320, "cy": 240, "k1": 0.1,
        "frames": [
        {"file_path": "./images/a.png", "transform_matrix":
         [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
        {"file_path": "./images/b.png", "fl_x": 400, "transform_matrix":
         [[0, 0, 1, 2], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]}]}"#;
    let imported = read(&[("transforms.json", text)], &scaled(0.5)).unwrap();
    assert_eq!(imported.format, Format::Nerf);
    let [a, b] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    // OpenGL's camera looks along its -z.
    assert_pose(a, [0.0; 3], X, MINUS_Z);
    assert_pose(b, [1.0, 0.0, 0.0], MINUS_Z, [-1.0, 0.0, 0.0]);
    assert_plane(a, [500.0, 510.0, 319.5, 239.5]);
    assert_plane(b, [400.0, 510.0, 319.5, 239.5]);
}

#[test]
fn callab_poses_are_those_of_cameras() {
    let text = "# made with CalLab\ncamera.0.version=2\ncamera.0.A=[500 0 320; 0 510 240; 0 0 1]\n\
                camera.0.width=640\ncamera.0.height=480\ncamera.0.k1=-0.2\ncamera.0.k2=0.1\n\
                camera.0.origin=corner\ncamera.0.R=[1 0 0; 0 -1 0; 0 0 -1]\ncamera.0.T=[200 0 300]\n";
    let options = Options {
        unit: mvtop_import::Unit::named("mm"),
        ..Options::default()
    };
    let imported = read(&[("a.cal", text)], &options).unwrap();
    assert_eq!(imported.format, Format::CalLab);
    let camera = &imported.rig.cameras()[0];
    assert_pose(camera, [0.2, 0.0, 0.3], X, MINUS_Z);
    assert_plane(camera, [500.0, 510.0, 319.5, 239.5]);
}

#[test]
fn halcon_rotations_are_in_degrees_and_in_its_orders() {
    let cam = "Focus:foc: 0.008;\nKappa:kappa: 0;\nSx:sx: 1.0e-05;\nSy:sy: 1.0e-05;\nCx:cx: 320;\nCy:cy: 240;\n\
               ImageWidth:imgw: 640;\nImageHeight:imgh: 480;\n";
    let options = Options {
        direction: Some(Direction::WorldFromCam),
        ..Options::default()
    };
    let of = |code: u32, r: &str| {
        let pose = format!("# 3D POSE PARAMETERS\nf {code}\nr {r}\nt 0.1 0.2 0.3\n");
        let imported = read(&[("a.dat", cam), ("pose.dat", &pose)], &options).unwrap();
        assert_eq!(imported.format, Format::Halcon);
        imported.rig.cameras()[0].clone()
    };
    let at = [0.1, 0.2, 0.3];
    let plain = of(0, "90 0 90");
    assert_plane(&plain, [800.0, 800.0, 320.0, 240.0]);
    // gba: about z first, x to y, then about x, y to z; z stays at first and goes to -y.
    assert_pose(&plain, at, Z, [0.0, -1.0, 0.0]);
    // abg: about x first, z to -y, then about z, -y to x.
    assert_pose(&of(2, "90 0 90"), at, Y, X);
    // Rodrigues as HALCON has it: tan(45°) is 1.
    assert_pose(&of(4, "0 0 1"), at, Y, Z);
    // R (p - T): x of the camera still goes to y, and its origin to -R T.
    assert_pose(&of(8, "0 0 90"), [0.2, -0.1, -0.3], Y, Z);
}

#[test]
fn euroc_states_the_sensor_in_the_body() {
    let text = "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, \
                0.3, 0, 0, 0, 1]\nresolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [458, 457, 367, \
                248]\ndistortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, \
                1.8e-05]\n";
    let imported = read(&[("mav0/cam0/sensor.yaml", text)], &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Euroc);
    let camera = &imported.rig.cameras()[0];
    assert_eq!(camera.id(), "cam0");
    assert_pose(camera, [0.1, 0.2, 0.3], Y, Z);
    let rows_first = text.replace("[752, 480]", "[480, 752]");
    let error = read(&[("sensor.yaml", &rows_first)], &Options::default()).unwrap_err();
    assert!(error.to_string().contains("--image-size"), "{error}");
}
