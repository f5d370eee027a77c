mod grasps;

use std::path::Path;

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};

use super::choice::is_inside;
use super::*;
use crate::prediction::{MissReason, ObjectPose, Timings, Warning, WarningCode};
use crate::symmetry::Symmetry;
use crate::{Camera, Intrinsics, Projection};

/// Four classes, calibrated.
pub(crate) fn bundle() -> Bundle {
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
        confidence: Some(confidence),
        ..ObjectPose::new(class, 1, 0.5, pose, pose)
    }
}

/// A can, a box beside it, and another can farther away, with a warning of the box.
pub(crate) fn found() -> Prediction {
    Prediction {
        reference: 0,
        objects: vec![
            object("soup_can", 0.6, [0.0, 0.0, 1.0]),
            object("cracker_box", 0.9, [0.3, 0.0, 1.0]),
            object("soup_can", 0.8, [0.0, 0.0, 2.0]),
        ],
        rig_consistency: None,
        timings: Timings::default(),
        model: "models/one".into(),
        provider: "cpu".into(),
        warnings: vec![Warning {
            code: WarningCode::LinesMiss,
            camera: None,
            object: Some(1),
            message: "a sentence".into(),
        }],
        near_misses: Vec::new(),
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
        (
            r#"{"T_base_world": [[1,0,0,500],[0,1,0,200],[0,0,1,800],[0,0,0,1]]}"#,
            "a camera within 100 m",
        ),
        (
            r#"{"priors": [{"class": "soup_can", "sigma_m": 10, "sigma_deg": 10,
                "T_world_obj": [[1,0,0,500],[0,1,0,200],[0,0,1,800],[0,0,0,1]]}]}"#,
            "a camera within 100 m",
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
        ("why", "true"),
    ] {
        request.set(name, value).unwrap();
    }
    let same = r#"{"reference": "right", "min_views": 2, "refine": false, "most": 3, "frame": "left",
        "classes": ["soup_can", "cracker_box"], "min_confidence": 0.5, "grasps": true, "why": true,
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

#[test]
fn priors_and_planes_are_read_and_written_as_they_are() {
    let text = r#"{"priors": [{"class": "soup_can", "sigma_m": 0.01, "sigma_deg": 10.0,
        "T_world_obj": [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]}],
        "planes": [{"point_m": [0, 0, 0.1], "normal": [0, 0, 2], "axis": [0, -1, 0],
                    "within_m": 0.01, "within_deg": 15}]}"#;
    let request = Request::from_json(text).unwrap();
    request.check(&bundle(), &rig(), false).unwrap();
    let again = serde_json::to_string(&request).unwrap();
    assert_eq!(Request::from_json(&again).unwrap(), request);
    let prior = &request.priors[0];
    assert_eq!(prior.world_from_obj().translation.z, 0.3);
    let quarter = prior.world_from_obj().rotation.scaled_axis();
    assert!((quarter.z - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    for (from, to, said) in [
        (
            r#""sigma_m": 0.01"#,
            r#""sigma_m": 0"#,
            "prior of `soup_can`: sigma_m: expected a standard deviation above 0, got 0",
        ),
        (
            "[0, 0, 1, 0.3]",
            "[0, 0, -1, 0.3]",
            "T_world_obj: it is a reflection",
        ),
        ("[0, 0, 2]", "[0, 0, 0]", "plane: normal: expected"),
        (
            r#""within_deg": 15"#,
            r#""within_deg": -1"#,
            "within_deg: expected a limit above 0",
        ),
        (r#""within_m""#, r#""within""#, "unknown field `within`"),
    ] {
        let error = Request::from_json(&text.replace(from, to)).unwrap_err();
        let error = error.to_string();
        assert!(error.contains(said) && !error.contains('\n'), "{error}");
    }
    for (from, to) in [
        ("soup_can", "nut"),
        (r#""planes": [{"#, r#""planes": [{"class": "nut", "#),
    ] {
        let request = Request::from_json(&text.replace(from, to)).unwrap();
        let error = request.check(&bundle(), &rig(), false).unwrap_err();
        assert!(error.to_string().contains("no class `nut`"), "{error}");
    }
}

/// An object that looks the same upside down, turned by half a turn about x, and after any turn about z.
fn shaft() -> crate::bundle::Class {
    let half = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let end = |z: f64| crate::bundle::SurfacePoint {
        position: [0.0, 0.0, z],
        color: [0; 3],
    };
    crate::bundle::Class {
        symmetry: Symmetry {
            discrete: vec![Isometry3::from_parts(Translation3::identity(), half)],
            axis: Some(crate::symmetry::Axis {
                direction: Vector3::z_axis(),
                point: nalgebra::Point3::origin(),
            }),
        },
        points: vec![end(-0.05), end(0.05)],
        diameter_m: 0.1,
        ..bundle().classes.remove(0)
    }
}

#[test]
fn deviation_from_a_prior_is_that_of_the_pose_that_looks_alike_nearest_to_it() {
    let prior = Prior::new("shaft", &Isometry3::translation(0.0, 0.0, 1.0), 0.01, 10.0).unwrap();
    let turned = |axis: Vector3<f64>, degrees: f64, x: f64| {
        let turn = UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
        Isometry3::from_parts(Translation3::new(x, 0.0, 1.0), turn)
    };
    for (pose, expected) in [
        (turned(Vector3::x(), 20.0, 0.0), 2.0),
        (turned(Vector3::x(), 20.0, 0.05), 5.0),
        (turned(Vector3::z(), 77.0, 0.015), 1.5),
        (turned(Vector3::x(), 165.0, 0.0), 1.5),
    ] {
        let (alike, deviation) = prior.deviation(&shaft(), &pose);
        assert!(
            (deviation - expected).abs() < 1e-9,
            "{deviation} {expected}"
        );
        // Up, as the prior is.
        assert!((alike.rotation * Vector3::z()).z > 0.9);
    }
}

#[test]
fn of_poses_that_look_alike_the_upright_one_stands() {
    let up = [0.0, 0.0, 1.0];
    let plane = Plane::new(None, [0.0, 0.0, 0.3], up, up, 0.01, 10.0).unwrap();
    // Upside down and tilted by 5 degrees: its lower end is 5 cm below its middle, times the cosine.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * 175.0_f64.to_radians());
    let pose = Isometry3::from_parts(Translation3::new(1.0, 2.0, 0.36), turn);
    let stand = plane.stand(&shaft(), &pose);
    assert!((stand.tilt_deg - 5.0).abs() < 1e-9);
    let height = 0.36 - 0.05 * 5.0_f64.to_radians().cos() - 0.3;
    assert!((stand.height_m - height).abs() < 1e-12);
    assert!((stand.world_from_obj.rotation * Vector3::z()).z > 0.99);
    // Without symmetry it is upside down.
    let mut alone = shaft();
    alone.symmetry = Symmetry::default();
    assert!((plane.stand(&alone, &pose).tilt_deg - 175.0).abs() < 1e-9);
}

#[test]
fn classes_without_an_object_are_told_of_where_that_is_asked() {
    let why = |request: &str| {
        let request = Request::from_json(request).unwrap();
        let mut found = found();
        found.near_misses.push(crate::prediction::NearMiss {
            class: "mustard_bottle".into(),
            reason: MissReason::DetectorScore,
            camera: Some(1),
            bbox: None,
            world_from_obj: None,
            value: Some(0.2),
            threshold: Some(0.3),
            message: "a sentence".into(),
        });
        let answer = request.choose(found, &bundle(), None, &rig()).unwrap();
        let told = answer.report.why?.into_iter();
        let told = told.map(|miss| (miss.class, miss.reason, miss.camera));
        Some(told.collect::<Vec<_>>())
    };
    let bottle = || {
        let camera = Some("right".to_owned());
        (
            "mustard_bottle".to_owned(),
            MissReason::DetectorScore,
            camera,
        )
    };
    assert_eq!(why("{}"), None);
    assert_eq!(why(r#"{"why": true}"#), Some(vec![bottle()]));
    assert_eq!(why(r#"{"classes": ["soup_can"]}"#), None);
    assert_eq!(
        why(r#"{"classes": ["soup_can"], "why": true}"#),
        Some(Vec::new())
    );
    assert_eq!(
        why(r#"{"classes": ["soup_can", "mustard_bottle"]}"#),
        Some(vec![bottle()])
    );
    // The box is found, and less probable than the most that were asked for; the cans are outside.
    let region = r#"{"min_m": [0.2, -1, 0], "max_m": [1, 1, 3]}"#;
    let told = why(&format!(
        r#"{{"classes": ["soup_can"], "region": {region}}}"#
    ));
    assert_eq!(
        told,
        Some(vec![("soup_can".to_owned(), MissReason::Region, None)])
    );
    let told = why(r#"{"classes": ["soup_can", "cracker_box"], "most": 1}"#);
    assert_eq!(
        told,
        Some(vec![("soup_can".to_owned(), MissReason::Most, None)])
    );
}
