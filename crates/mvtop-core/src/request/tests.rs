use std::path::Path;

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};

use super::choice::is_inside;
use super::*;
use crate::prediction::{ObjectPose, Sigma, Timings, Warning, WarningCode};
use crate::symmetry::Symmetry;
use crate::{Camera, Intrinsics, Projection};

/// Four classes, calibrated.
fn bundle() -> Bundle {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    Bundle::load(&root.join("models/ycbv4")).unwrap()
}

/// Two cameras that look along z, the right one half a metre beside the left one, which is the world.
fn rig() -> Rig {
    let camera = |id: &str, x: f64| {
        let lens = Intrinsics::new(500.0, 500.0, 320.0, 240.0, Projection::Pinhole).unwrap();
        Camera::new(id, [640, 480], lens, Isometry3::translation(x, 0.0, 0.0)).unwrap()
    };
    Rig::new(vec![camera("left", 0.0), camera("right", 0.5)], 0).unwrap()
}

fn object(class: &str, confidence: f64, at: [f64; 3]) -> ObjectPose {
    let pose = Isometry3::from_parts(Translation3::from(at), UnitQuaternion::identity());
    ObjectPose {
        class: class.into(),
        class_id: 1,
        score: 0.5,
        ref_from_obj: pose,
        world_from_obj: pose,
        sigma: Sigma::default(),
        deviation: None,
        coordinate_inliers: None,
        refinement: None,
        confidence: Some(confidence),
        evidence: None,
        hypotheses: Vec::new(),
        next_view: None,
        symmetry: Symmetry::default(),
        cameras: Vec::new(),
    }
}

/// A can, a box beside it, and another can farther away, with a warning of the box.
fn found() -> Prediction {
    Prediction {
        reference: 0,
        objects: vec![
            object("soup_can", 0.6, [0.0, 0.0, 1.0]),
            object("cracker_box", 0.9, [0.3, 0.0, 1.0]),
            object("soup_can", 0.8, [0.0, 0.0, 2.0]),
        ],
        rig_consistency: None,
        timings: Timings::default(),
        provider: "cpu".into(),
        warnings: vec![Warning {
            code: WarningCode::LinesMiss,
            camera: None,
            object: Some(1),
            message: "a sentence".into(),
        }],
    }
}

/// z of the objects that are given, and what was left out.
fn chosen(request: &str) -> (Vec<f64>, LeftOut) {
    let request = Request::from_json(request).unwrap();
    request.check(&bundle(), &rig(), false).unwrap();
    let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
    let objects = answer.prediction.objects.iter();
    let z = objects.map(|object| object.world_from_obj.translation.z);
    (z.collect(), answer.left_out)
}

#[test]
fn nothing_asked_gives_everything_and_the_document_as_it_was() {
    let request = Request::default();
    let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
    assert_eq!(answer.prediction.objects.len(), 3);
    assert_eq!(answer.report, Report::new(&found(), &rig()));
    let json = serde_json::to_value(&answer.report).unwrap();
    assert!(json.get("frame").is_none() && json.get("left_out").is_none());
    assert_eq!(serde_json::to_string(&request).unwrap(), "{}");
}

#[test]
fn objects_are_chosen_by_class_place_and_number() {
    let (z, out) = chosen(r#"{"classes": ["soup_can"]}"#);
    assert_eq!((z, out.classes), (vec![1.0, 2.0], 1));
    let (z, out) = chosen(r#"{"region": {"min_m": [-0.2, -0.2, 1.5], "max_m": [0.2, 0.2, 2.5]}}"#);
    assert_eq!((z, out.region), (vec![2.0], 2));
    // The two most probable ones, in the order that they had.
    let (z, out) = chosen(r#"{"most": 2}"#);
    assert_eq!((z, out.most), (vec![1.0, 2.0], 1));
    let (z, out) = chosen(r#"{"classes": ["soup_can"], "most": 1}"#);
    assert_eq!((z, out.classes, out.most), (vec![2.0], 1, 1));
}

#[test]
fn polygons_count_in_each_camera_that_has_one() {
    // The left camera sees the box 150 px right of the middle, the right one 100 px left of it.
    let left = "[[420, 100], [600, 100], [600, 400], [420, 400]]";
    let right = "[[150, 100], [300, 100], [300, 400], [150, 400]]";
    let (z, out) = chosen(&format!(r#"{{"polygons": {{"left": {left}}}}}"#));
    assert_eq!((z.len(), out.polygons), (1, 2));
    let both = format!(r#"{{"polygons": {{"left": {left}, "right": {right}}}}}"#);
    assert_eq!(chosen(&both).0.len(), 1);
    let elsewhere = format!(r#"{{"polygons": {{"left": {left}, "right": {left}}}}}"#);
    assert_eq!(chosen(&elsewhere).0.len(), 0);
}

#[test]
fn polygon_with_a_notch_leaves_the_notch_out() {
    let notched = [[0., 0.], [4., 0.], [4., 4.], [2., 1.], [0., 4.]];
    for (point, inside) in [
        ([2.0, 0.5], true),
        ([2.0, 3.0], false),
        ([0.5, 2.5], true),
        ([5.0, 0.5], false),
    ] {
        assert_eq!(
            is_inside(&notched, &Point2::from(point)),
            inside,
            "{point:?}"
        );
    }
}

#[test]
fn warnings_follow_their_objects() {
    let request = Request::from_json(r#"{"classes": ["cracker_box"]}"#).unwrap();
    let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
    assert_eq!(answer.report.warnings[0].object, Some(0));
    let request = Request::from_json(r#"{"classes": ["soup_can"]}"#).unwrap();
    let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
    assert_eq!(answer.report.warnings[0].object, None);
}

#[test]
fn poses_are_given_in_the_frame_that_is_asked_for() {
    let place = |request: &str| {
        let request = Request::from_json(request).unwrap();
        let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
        let pose = answer.report.objects[1].t_frame_obj.unwrap();
        [0, 1, 2].map(|row| pose[row][3])
    };
    assert_eq!(place(r#"{"frame": "world"}"#), [0.3, 0.0, 1.0]);
    assert_eq!(place(r#"{"frame": "right"}"#), [0.3 - 0.5, 0.0, 1.0]);
    // A quarter turn about z: x of the world is y of the base, y of the world is -x of the base.
    let base = "[[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]";
    let got = place(&format!(r#"{{"frame": "base", "T_base_world": {base}}}"#));
    let off = Vector3::from(got) - Vector3::new(1.0, 2.3, 4.0);
    assert!(off.norm() < 1e-12, "{got:?}");
}

#[test]
fn verdicts_are_given_where_a_confidence_is_asked_for() {
    let request = Request::from_json(r#"{"min_confidence": 0.7}"#).unwrap();
    let answer = request.choose(found(), &bundle(), None, &rig()).unwrap();
    let accepted = |index: usize| answer.report.objects[index].verdict == Some(Verdict::Accept);
    assert_eq!([0, 1, 2].map(accepted), [false, true, true]);
    assert!(!answer.is_accepted(&request));
    let fewer = Request {
        most: Some(2),
        classes: Some(vec!["cracker_box".into()]),
        ..request
    };
    let answer = fewer.choose(found(), &bundle(), None, &rig()).unwrap();
    assert!(answer.is_accepted(&fewer));
}

#[test]
fn what_cannot_be_meant_is_refused_in_one_sentence() {
    for (request, said) in [
        (r#"{"classes": ["nut"]}"#, "no class `nut`"),
        (r#"{"classes": []}"#, "got none"),
        (r#"{"most": 0}"#, "1 or more"),
        (
            r#"{"region": {"min_m": [0, 0, 0], "max_m": [1, 0, 1]}}"#,
            "region",
        ),
        (
            r#"{"polygons": {"left": [[0, 0], [1, 1]]}}"#,
            "3 to 1000 corners",
        ),
        (
            r#"{"polygons": {"top": [[0, 0], [1, 1], [0, 1]]}}"#,
            "no camera `top`",
        ),
        (r#"{"frame": "base"}"#, "T_base_world"),
        (r#"{"frame": "robot"}"#, "no camera `robot`"),
        (
            r#"{"T_base_world": [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]}"#,
            "reflection",
        ),
        (r#"{"min_confidence": 1.5}"#, "probability"),
        (r#"{"grasps": true}"#, "grasps.json"),
        (r#"{"reference": "top"}"#, "no camera `top`"),
    ] {
        let request = Request::from_json(request).unwrap();
        let error = request
            .check(&bundle(), &rig(), false)
            .unwrap_err()
            .to_string();
        assert!(error.contains(said) && !error.contains('\n'), "{error}");
    }
    for text in [
        "",
        "[]",
        r#"{"klasses": []}"#,
        r#"{"most": -1}"#,
        r#"{"most": 1, "most": 2}"#,
    ] {
        let error = Request::from_json(text).unwrap_err().to_string();
        assert!(error.starts_with("request: expected JSON"), "{error}");
    }
}

#[test]
fn settings_as_text_are_those_of_json() {
    let mut request = Request::default();
    for (name, value) in [
        ("reference", "right"),
        ("min_views", "2"),
        ("refine", "false"),
        ("classes", "soup_can, cracker_box"),
        ("most", "3"),
        ("region", "-1,-1,0,1,1,2"),
        ("frame", "left"),
        ("min_confidence", "0.5"),
        ("grasps", "true"),
    ] {
        request.set(name, value).unwrap();
    }
    let same = r#"{"reference": "right", "min_views": 2, "refine": false, "most": 3, "frame": "left",
        "classes": ["soup_can", "cracker_box"], "min_confidence": 0.5, "grasps": true,
        "region": {"min_m": [-1, -1, 0], "max_m": [1, 1, 2]}}"#;
    assert_eq!(request, Request::from_json(same).unwrap());
    let text = serde_json::to_string(&request).unwrap();
    assert_eq!(Request::from_json(&text).unwrap(), request);
    for (name, value) in [
        ("most", "two"),
        ("region", "1,2,3"),
        ("refine", "yes"),
        ("nonsense", "1"),
    ] {
        assert!(
            Request::default().set(name, value).is_err(),
            "{name}={value}"
        );
    }
}

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
    assert_eq!(objects[1].grasps, Some(Vec::new()));
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
