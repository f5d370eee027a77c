//! Grasps of the objects that are given.

use super::*;

/// A tool that comes from above, 0.2 m over the object, with a ball of 5 cm at its tip.
const GRASPS: &str = r#"{"format": "mvtop-grasps", "version": 1, "unit": "mm",
    "gripper": [{"center": [0, 0, 200], "radius": 50}],
    "grasps": [
        {"class": "soup_can", "name": "top", "opening": 70,
         "T_obj_tool": [[1,0,0,0],[0,1,0,0],[0,0,1,-200],[0,0,0,1]]},
        {"class": "soup_can", "name": "beside", "opening": 70,
         "T_obj_tool": [[1,0,0,300],[0,1,0,0],[0,0,1,-200],[0,0,0,1]]}]}"#;

/// The bundle with a file of grasps.
fn with_grasps(text: &str) -> (tempfile::TempDir, Result<Option<Grasps>>) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(GRASPS_FILE), text).unwrap();
    let mut bundle = bundle();
    bundle.dir = folder.path().to_owned();
    let grasps = Grasps::of_bundle(&bundle);
    (folder, grasps)
}

#[test]
fn grasps_are_given_in_the_frame_and_collisions_are_marked() {
    let (_folder, grasps) = with_grasps(GRASPS);
    let grasps = grasps.unwrap();
    let request = Request::from_json(r#"{"grasps": true, "frame": "right"}"#).unwrap();
    let bundle = bundle();
    let mut found = found();
    // The surface of the box where the gripper's ball is in the second grasp of the first can.
    let [x, y, z] = bundle.classes[bundle.class_index("cracker_box").unwrap()].points[0].position;
    found.objects[1].world_from_obj = Isometry3::translation(0.3 - x, -y, 1.0 - z);
    let answer = request
        .choose(found, &bundle, grasps.as_ref(), &rig())
        .unwrap();
    let objects = &answer.report.objects;
    let of_can = objects[0].grasps.as_ref().unwrap();
    assert_eq!(of_can[0].t_frame_tool[0][3], -0.5);
    assert!((of_can[0].t_frame_tool[2][3] - 0.8).abs() < 1e-12);
    assert!((of_can[0].opening_m - 0.07).abs() < 1e-12);
    assert_eq!(of_can[1].collides_with, Some(vec![1]));
    assert_eq!(
        [of_can[0].collides, of_can[1].collides],
        [Some(false), Some(true)]
    );
    assert_eq!(objects[1].grasps, Some(Vec::new()));
}

#[test]
fn what_is_found_and_not_given_is_in_the_way_of_a_gripper() {
    let (_folder, grasps) = with_grasps(GRASPS);
    let bundle = bundle();
    let mut found = found();
    let [x, y, z] = bundle.classes[bundle.class_index("cracker_box").unwrap()].points[0].position;
    found.objects[1].world_from_obj = Isometry3::translation(0.3 - x, -y, 1.0 - z);
    let can = found.objects[0].world_from_obj.translation.vector;
    let [low, high] = [-0.1, 0.1].map(|d| can.map(|x| x + d));
    let request = format!(
        r#"{{"grasps": true, "region": {{"min_m": {:?}, "max_m": {:?}}}}}"#,
        [low.x, low.y, low.z],
        [high.x, high.y, high.z]
    );
    let request = Request::from_json(&request).unwrap();
    let answer = request
        .choose(found, &bundle, grasps.unwrap().as_ref(), &rig())
        .unwrap();
    let [object] = &answer.report.objects[..] else {
        panic!("{:?}", answer.report.objects)
    };
    let beside = &object.grasps.as_ref().unwrap()[1];
    assert_eq!(
        (beside.collides, &beside.collides_with),
        (Some(true), &Some(vec![]))
    );
}

#[test]
fn grasps_without_a_gripper_do_not_know_of_collisions() {
    let text = GRASPS.replace(r#"[{"center": [0, 0, 200], "radius": 50}]"#, "[]");
    let (_folder, grasps) = with_grasps(&text);
    let request = Request::from_json(r#"{"grasps": true}"#).unwrap();
    let grasps = grasps.unwrap();
    let answer = request
        .choose(found(), &bundle(), grasps.as_ref(), &rig())
        .unwrap();
    assert_eq!(answer.report.frame.as_deref(), Some("world"));
    assert_eq!(
        answer.report.objects[0].grasps.as_ref().unwrap()[0].collides_with,
        None
    );
}

#[test]
fn files_of_grasps_that_are_wrong_are_refused_in_one_sentence() {
    for (from, to, said) in [
        (r#""unit": "mm""#, r#""unit": "inch""#, "`m` or `mm`"),
        (r#""unit": "mm""#, r#""unit": "m""#, "10 m at most"),
        ("soup_can", "nut", "no class `nut`"),
        (r#""version": 1"#, r#""version": 2"#, "version 1"),
        (r#""opening": 70"#, r#""opening": -1"#, "opening"),
        (r#""radius": 50"#, r#""radius": 0"#, "radius above 0"),
        ("[0,0,1,-200]", "[0,0,-1,-200]", "T_obj_tool"),
        (r#""name": "top""#, r#""name": "on top""#, "without spaces"),
        (r#""opening""#, r#""openings""#, "expected"),
    ] {
        let (_folder, grasps) = with_grasps(&GRASPS.replace(from, to));
        let error = grasps.unwrap_err().to_string();
        assert!(error.contains(said) && !error.contains('\n'), "{error}");
    }
    assert_eq!(Grasps::of_bundle(&bundle()).unwrap(), None);
}
