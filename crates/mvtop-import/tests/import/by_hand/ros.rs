//! ROS: camera_info files, and the frames in which the cameras stand.

use super::*;

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

#[test]
fn ros_pairs_without_transforms_are_not_put_into_each_other() {
    let with = |cameras: &[(&str, &str)]| {
        let infos: Vec<_> = cameras.iter().map(|(name, tx)| info(name, tx)).collect();
        let names: Vec<_> = cameras
            .iter()
            .map(|(name, _)| format!("{name}.yaml"))
            .collect();
        let files = names.iter().zip(&infos);
        let files: Vec<_> = files
            .map(|(name, text)| (name.as_str(), text.as_str()))
            .collect();
        read(&files, &Options::default())
    };
    let pairs = [("fl", "0"), ("fr", "-48"), ("rl", "0"), ("rr", "-48")];
    for cameras in [
        &pairs[..],
        &[("fl", "0"), ("fr", "-48"), ("rr", "-48")],
        &[("fl", "0"), ("fr", "-48"), ("rl", "0")],
        &[("fr", "-48"), ("rr", "-96")],
    ] {
        let error = with(cameras).unwrap_err().to_string();
        assert!(error.contains("one rectified pair or row"), "{error}");
        assert!(
            error.contains("`fr` at 0.1000 m") && error.contains("tf_static"),
            "{error}"
        );
    }
    // A row has one camera at 0, whichever comes first; a camera alone needs no place.
    let rig = with(&[("c", "-96"), ("a", "0"), ("b", "-48")]).unwrap().rig;
    assert_pose(&rig.cameras()[0], [0.2, 0.0, 0.0], X, Z);
    assert_pose(&rig.cameras()[2], [0.1, 0.0, 0.0], X, Z);
    assert_pose(
        &with(&[("fr", "-48")]).unwrap().rig.cameras()[0],
        [0.0; 3],
        X,
        Z,
    );
}

#[test]
fn ros_regions_binning_and_camera_types_are_compared() {
    let with = |more: &str| {
        let text = info("left", "0") + more;
        read(&[("left.yaml", &text)], &Options::default()).map_err(|error| error.to_string())
    };
    for more in [
        "roi: {x_offset: 0, y_offset: 0, height: 480, width: 640, do_rectify: false}\nbinning_x: 1\n",
        "roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}\nbinning_x: 0\n",
        "camera_type: pinhole\n",
    ] {
        assert!(with(more).is_ok(), "{more}: {}", with(more).unwrap_err());
    }
    for (more, words) in [
        (
            "roi: {x_offset: 8, y_offset: 0, height: 480, width: 640}\n",
            "the whole image",
        ),
        (
            "roi: {x_offset: 0, y_offset: 0, height: 240, width: 640}\n",
            "the whole image",
        ),
        ("camera_type: fisheye\n", "the lens of `distortion_model`"),
        ("binning_x: \"2\"\n", "finite number"),
    ] {
        let error = with(more).unwrap_err();
        assert!(error.contains(words), "{more}: {error}");
    }
}
