//! One case of each format whose rig is worked out by hand: direction, axes, order, half a pixel, unit.

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

const INFO: &str = "image_width: 640\nimage_height: 480\ncamera_name: NAME\ncamera_matrix:\n  rows: 3\n  \
    cols: 3\n  data: [500, 0, 320, 0, 500, 240, 0, 0, 1]\ndistortion_model: plumb_bob\n\
    distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, 0, 0, 0, 0]\nrectification_matrix:\n  rows: \
    3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [480, \
    0, 310, TX, 0, 480, 230, 0, 0, 0, 1, 0]\n";

fn info(name: &str, tx: &str) -> String {
    INFO.replace("NAME", name).replace("TX", tx)
}

#[test]
fn ros_poses_are_those_of_the_optical_frames_in_the_root() {
    let tf = "transforms:\n- header:\n    frame_id: base\n  child_frame_id: left_link\n  transform:\n    \
              translation: {x: 1.0, y: 0.0, z: 0.0}\n    rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}\n- header:\n    \
              frame_id: left_link\n  child_frame_id: left_optical_frame\n  transform:\n    translation: {x: 0.0, \
              y: 0.5, z: 0.0}\n    rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}\n---\n";
    let (left, options) = (info("left", "0"), Options::default());
    let imported = read(&[("left.yaml", &left), ("tf.yaml", tf)], &options).unwrap();
    assert_eq!(imported.format, Format::Ros);
    let camera = &imported.rig.cameras()[0];
    // The usual turn to optical axes: x to the right is -y of the body, z is its x.
    assert_pose(camera, [1.0, 0.5, 0.0], [0.0, -1.0, 0.0], X);
    assert_plane(camera, [500.0, 500.0, 320.0, 240.0]);
    let body = read(
        &[("a.yaml", &info("left_link", "0")), ("tf.yaml", tf)],
        &options,
    );
    assert!(body.unwrap_err().to_string().contains("optical frame"));
}

#[test]
fn ros_poses_may_be_listed_as_a_urdf_has_them() {
    // A quarter turn about the parent's x, y and z, one after the other: x stays x, goes to -z and stays
    // there; z goes to -y, stays there and goes to x.
    let list = "left_link: {parent: base, xyz: [1, 0, 0.5]}\n\
                left_optical_frame: {parent: left_link, xyz: [0, 0.5, 0], rpy: [-1.5707963267948966, 0, \
                -1.5707963267948966]}\n\
                right: {parent: base, rpy: [1.5707963267948966, 1.5707963267948966, 1.5707963267948966]}\n\
                third: {parent: right, xyz: [0, 0, 2], q_wxyz: [0, 1, 0, 0]}\n\
                fourth: {parent: right, q_xyzw: [1, 0, 0, 0]}\n";
    let infos = ["left", "right", "third", "fourth"].map(|name| info(name, "0"));
    let mut files: Vec<(&str, &str)> = vec![("frames.yaml", list)];
    let names = ["a.yaml", "b.yaml", "c.yaml", "d.yaml"];
    files.extend(
        names
            .iter()
            .zip(&infos)
            .map(|(name, text)| (*name, text.as_str())),
    );
    let imported = read(&files, &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Ros);
    let [left, right, third, fourth] = imported.rig.cameras() else {
        panic!("four cameras")
    };
    // As the usual transform of ROS from body to optical axes.
    assert_pose(left, [1.0, 0.5, 0.5], [0.0, -1.0, 0.0], X);
    assert_pose(right, [0.0; 3], MINUS_Z, X);
    // 2 m along right's z, and half a turn about its x.
    assert_pose(third, [2.0, 0.0, 0.0], MINUS_Z, [-1.0, 0.0, 0.0]);
    assert_pose(fourth, [0.0; 3], MINUS_Z, [-1.0, 0.0, 0.0]);
}

#[test]
fn ros_cameras_stand_in_one_root_which_may_be_one_of_them() {
    let infos = ["left", "right"].map(|name| info(name, "0"));
    let with = |list: &str| {
        let files = [
            ("a.yaml", infos[0].as_str()),
            ("b.yaml", infos[1].as_str()),
            ("frames.yaml", list),
        ];
        read(&files, &Options::default())
    };
    let list = "right_optical_frame: {parent: left_optical_frame, xyz: [0.2, 0, 0]}";
    let imported = with(list).unwrap();
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_pose(left, [0.0; 3], X, Z);
    assert_pose(right, [0.2, 0.0, 0.0], X, Z);
    let notes = |list: &str| with(list).unwrap().notes.join(" ");
    assert!(!notes(list).contains("taken for"));
    let plain = "right: {parent: left_optical_frame, xyz: [0.2, 0, 0]}";
    assert!(notes(plain).contains("`right` is taken for camera `right`'s optical frame"));
    let apart = "left_optical_frame: {parent: base}\nright_optical_frame: {parent: hand}";
    let error = with(apart).unwrap_err().to_string();
    assert!(
        error.contains("camera `left` stands in `base`, camera `right` in `hand`"),
        "{error}"
    );
}

/// Two cameras on a hand that a joint moves, one at its base.
const ROBOT: &str = r#"<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="third_optical_frame"/></joint>
  <joint name="wrist" type="revolute">
    <origin xyz="9 9 9" rpy="0 0 0"/><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="a" type="fixed">
    <parent link="hand"/><child link="left_link"/><origin xyz="1 0.5 0" rpy="0 0 0"/>
  </joint>
  <joint name="b" type="fixed">
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966" />
    <parent link="left_link"/><child link="left_optical_frame"/>
  </joint>
  <joint name="c" type="fixed">
    <parent link="left_optical_frame"/><child link="right_optical_frame"/><origin xyz="0.2 0 0"/>
  </joint>
</robot>"#;

#[test]
fn ros_poses_may_be_those_of_a_urdf() {
    let infos = ["left", "right", "third"].map(|name| info(name, "0"));
    let with = |robot: &str, cameras: &[usize]| {
        let mut files = vec![("arm.urdf", robot)];
        let names = ["a.yaml", "b.yaml", "c.yaml"];
        files.extend(cameras.iter().map(|&i| (names[i], infos[i].as_str())));
        read(&files, &Options::default())
    };
    let imported = with(ROBOT, &[0, 1]).unwrap();
    assert_eq!(imported.format, Format::Ros);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_pose(left, [1.0, 0.5, 0.0], [0.0, -1.0, 0.0], X);
    assert_pose(right, [1.0, 0.3, 0.0], [0.0, -1.0, 0.0], X);
    let notes = imported.notes.join(" ");
    assert!(notes.contains("the world is `hand` (moved by the revolute joint `wrist`)"));

    let refusal = |robot: &str, cameras: &[usize]| {
        let error = with(robot, cameras).unwrap_err().to_string();
        assert_eq!(error.lines().count(), 1, "{error}");
        error
    };
    let apart = refusal(ROBOT, &[0, 2]);
    for words in [
        "`hand` (moved by the revolute joint `wrist`)",
        "`base`, and no transform",
    ] {
        assert!(apart.contains(words), "{words} is missing in: {apart}");
    }
    let entities = "<!DOCTYPE r [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;\">]>";
    for (from, to, words) in [
        (
            "0.2 0 0",
            "0.2 0",
            "joint `c`: `xyz` must be 3 finite numbers",
        ),
        (
            "0.2 0 0",
            "0.2 0 nan",
            "joint `c`: `xyz` must be 3 finite numbers",
        ),
        ("0.2 0 0", "${x} 0 0", "xacro"),
        (
            "-1.5707963267948966 0",
            "-90 0",
            "joint `b`: `rpy` must be radians",
        ),
        (
            "<parent link=\"left_link\"/>",
            "",
            "joint `b`: its `parent` is missing",
        ),
        (
            "type=\"revolute\"",
            "",
            "joint `wrist`: the attribute `type` is missing",
        ),
        ("</robot>", "", "no XML"),
        ("<robot name", "<sdf><robot name", "no XML"),
        ("<?xml version=\"1.0\"?>", entities, "no XML"),
        ("\"right_optical_frame\"", "\"left_optical_frame\"", "twice"),
    ] {
        let error = refusal(&ROBOT.replacen(from, to, 1), &[0, 1]);
        assert!(error.contains(words), "{words} is missing in: {error}");
    }
    let deep = format!("<robot>{}", "<link>".repeat(200_000));
    assert!(refusal(&deep, &[0]).contains("no XML"));
}

#[test]
fn ros_lists_of_frames_that_cannot_be_meant_are_refused() {
    let left = info("left", "0");
    let error = |list: &str| {
        let files = [("left.yaml", left.as_str()), ("frames.yaml", list)];
        read(&files, &Options::default()).unwrap_err().to_string()
    };
    for (list, words) in [
        ("left: {parent: base, rpy: [-90, 0, -90]}", "radians"),
        (
            "left: {parent: base, rpy: [0, 0, 0], q_wxyz: [1, 0, 0, 0]}",
            "one of rpy",
        ),
        ("left: {parent: base, q_wxyz: [1, 1, 0, 0]}", "norm 1"),
        (
            "left: {parent: base, quaternion: [1, 0, 0, 0]}",
            "`quaternion`",
        ),
        ("left: {parent: left}", "circle"),
        // A URDF's link of a camera is no optical frame: the turn is not guessed, but said.
        (
            "left_link: {parent: base}",
            "left_optical_frame: {parent: left_link, rpy: [-1.570796",
        ),
    ] {
        assert!(error(list).contains(words), "{list}: {}", error(list));
    }
}

#[test]
fn ros_rectified_images_are_seen_through_p() {
    let files = [info("left", "0"), info("right", "-48")];
    let files = [("l.yaml", files[0].as_str()), ("r.yaml", files[1].as_str())];
    let options = Options {
        rectified: true,
        ..Options::default()
    };
    let rig = read(&files, &options).unwrap().rig;
    let right = &rig.cameras()[1];
    assert_plane(right, [480.0, 480.0, 310.0, 230.0]);
    assert!(right.intrinsics().is_pinhole());
    // Tx = -48 px m = -480 px times 0.1 m to the right.
    assert_pose(right, [0.1, 0.0, 0.0], X, Z);
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
}
