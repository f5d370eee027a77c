use std::io;

use mvtop_geometry::{Error, Projection, Rig};
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::bad_rigs::{BAD, GOOD};

#[test]
fn a_good_rig_is_read_as_written() {
    let rig = Rig::from_json(GOOD).unwrap();
    assert_eq!((rig.reference(), rig.cameras().len()), (1, 2));
    assert_eq!(
        (rig.index_of("left"), rig.index_of("right")),
        (Some(0), None)
    );

    let [left, wide] = rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!(
        (left.id(), left.width(), left.height()),
        ("left", 1280, 720)
    );
    let lens = left.intrinsics();
    assert_eq!(
        [lens.fx(), lens.fy(), lens.cx(), lens.cy()],
        [863.73, 863.22, 637.52, 385.53]
    );
    let bent = lens.projection();
    assert_eq!(
        (bent.family(), bent.distortion()),
        ("pinhole", Some("brown_conrady"))
    );
    assert_eq!(bent.params()[3], 0.00057);
    let fisheye = wide.intrinsics().projection();
    assert_eq!(
        (fisheye.family(), fisheye.distortion()),
        ("fisheye", Some("kannala_brandt"))
    );
    assert_eq!(fisheye.params()[3], 0.0155);

    // cos² - sin² of the half turn's angle: 0.6² - 0.8² = -0.28, 2 · 0.6 · 0.8 = 0.96.
    let expected = Point3::new(0.1 + 0.96, 0.0, 0.8 - 0.28);
    assert!((left.world_from_cam() * Point3::new(0.0, 0.0, 1.0) - expected).norm() < 1e-12);
    // The camera sees the world's (1, 2, 3) at (-2 + 0.25, 1, 3.5).
    let seen = Point3::new(-1.75, 1.0, 3.5);
    assert!((wide.world_from_cam() * seen - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
}

#[test]
fn largest_angle_is_read_and_written() {
    let limited = GOOD.replace("\"fx\": 278", "\"max_angle_deg\": 80.3, \"fx\": 278");
    let rig = Rig::from_json(&limited).unwrap();
    let angles = |rig: &Rig| [0, 1].map(|i| rig.cameras()[i].intrinsics().max_angle_deg());
    assert_eq!(angles(&rig), [None, Some(80.3)]);
    let again = Rig::from_json(&rig.to_json()).unwrap();
    assert_eq!(angles(&again), [None, Some(80.3)]);
    assert_ne!(rig, Rig::from_json(GOOD).unwrap());
}

#[test]
fn skew_is_read_and_written() {
    let skewed = GOOD.replace("\"fx\": 278", "\"skew\": -1.5, \"fx\": 278");
    let rig = Rig::from_json(&skewed).unwrap();
    let skews = |rig: &Rig| [0, 1].map(|i| rig.cameras()[i].intrinsics().skew());
    assert_eq!(skews(&rig), [0.0, -1.5]);
    assert_eq!(skews(&Rig::from_json(&rig.to_json()).unwrap()), [0.0, -1.5]);
    assert_ne!(rig, Rig::from_json(GOOD).unwrap());
}

#[test]
fn optional_keys_have_defaults() {
    let mut value: Value = serde_json::from_str(GOOD).unwrap();
    value.as_object_mut().unwrap().remove("reference");
    for camera in value["cameras"].as_array_mut().unwrap() {
        camera.as_object_mut().unwrap().remove("distortion");
    }
    value["cameras"][0].as_object_mut().unwrap().remove("model");
    let rig = Rig::from_json(&value.to_string()).unwrap();
    assert_eq!(rig.reference(), 0);
    let projection = |camera: usize| rig.cameras()[camera].intrinsics().projection();
    assert_eq!(*projection(0), Projection::Pinhole);
    assert_eq!(
        *projection(1),
        Projection::from_params("fisheye", None, &[]).unwrap()
    );
    assert_eq!(projection(1).params(), [0.0; 4]);
}

#[test]
fn one_pose_may_be_written_in_six_ways() {
    let pose = Isometry3::new(Vector3::new(0.5, -0.25, 2.0), Vector3::new(0.3, 1.2, -0.4));
    let forms = |pose: Isometry3<f64>| {
        let (t, q) = (
            pose.translation.vector.as_slice().to_vec(),
            pose.rotation.coords,
        );
        let matrix = pose.to_homogeneous();
        let rows: Vec<Vec<f64>> = matrix
            .row_iter()
            .map(|row| row.iter().copied().collect())
            .collect();
        [
            json!(rows),
            json!({"t": t, "q_wxyz": [q.w, q.x, q.y, q.z]}),
            json!({"t": t, "q_xyzw": [-q.x, -q.y, -q.z, -q.w]}),
        ]
    };
    for (key, forms) in [
        ("T_world_cam", forms(pose)),
        ("T_cam_world", forms(pose.inverse())),
    ] {
        for form in forms {
            let mut value: Value = serde_json::from_str(GOOD).unwrap();
            let camera = value["cameras"][1].as_object_mut().unwrap();
            camera.remove("T_cam_world");
            camera.insert(key.into(), form.clone());
            let rig = Rig::from_json(&value.to_string()).unwrap();
            let read = rig.cameras()[1].world_from_cam();
            let off = (read.to_homogeneous() - pose.to_homogeneous()).norm();
            assert!(off < 1e-12, "{key}: {form} is off by {off}");
        }
    }
}

#[test]
fn every_unit_is_converted_to_metres() {
    for (unit, written) in [("m", "0.5"), ("cm", "50"), ("mm", "500")] {
        let text = GOOD
            .replace("\"unit\": \"m\"", &format!("\"unit\": \"{unit}\""))
            .replace("[0.1, 0, 0.8]", &format!("[0, 0, {written}]"));
        let rig = Rig::from_json(&text).unwrap();
        let depth = rig.cameras()[0].world_from_cam().translation.z;
        assert!((depth - 0.5).abs() < 1e-12, "{unit}: {depth}");
    }
}

#[test]
fn a_rounded_rotation_is_made_exact() {
    let text = GOOD.replace(
        "[0, -1, 0, 0.25], [1, 0, 0, 0]",
        "[0, -1, 0, 0.25], [1.0004, 0, 0, 0]",
    );
    let rig = Rig::from_json(&text).unwrap();
    let rotation = rig.cameras()[1].world_from_cam().rotation;
    let matrix = rotation.to_rotation_matrix().into_inner();
    assert!((matrix.transpose() * matrix - nalgebra::Matrix3::identity()).norm() < 1e-12);
}

#[test]
fn every_bad_rig_is_refused_in_one_clear_sentence() {
    let mut failures = Vec::new();
    for (from, to, facts) in BAD {
        assert!(GOOD.contains(from), "`{from}` is not in the good rig");
        match Rig::from_json(&GOOD.replacen(from, to, 1)).map_err(|error| error.to_string()) {
            Ok(_) => failures.push(format!("`{from}` -> `{to}` was accepted")),
            Err(error) => {
                assert_one_sentence(&error);
                let lacking = facts.iter().filter(|fact| !error.contains(**fact));
                failures.extend(lacking.map(|fact| format!("`{error}` lacks `{fact}`")));
            }
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn loading_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.json");
    let error = Rig::load(&path).unwrap_err().to_string();
    assert!(
        error.starts_with("cannot read") && error.contains("broken.json"),
        "{error}"
    );
    std::fs::write(&path, "{\n  \"format\":").unwrap();
    let error = Rig::load(&path).unwrap_err().to_string();
    assert!(
        error.contains("broken.json: not valid JSON") && error.contains("line 2"),
        "{error}"
    );
    std::fs::write(&path, b"\xff\xfe").unwrap();
    let error = Rig::load(&path).unwrap_err().to_string();
    assert!(
        error.starts_with("cannot read") && error.contains("UTF-8"),
        "{error}"
    );
    std::fs::write(&path, GOOD).unwrap();
    assert_eq!(Rig::load(&path).unwrap(), Rig::from_json(GOOD).unwrap());
}

#[test]
fn causes_can_be_matched_on() {
    use std::error::Error as _;
    let folder = tempfile::tempdir().unwrap();
    let error = Rig::load(&folder.path().join("none.json")).unwrap_err();
    assert!(matches!(error, Error::Read { .. }), "{error:?}");
    let cause = error
        .source()
        .and_then(|cause| cause.downcast_ref::<io::Error>());
    assert_eq!(cause.unwrap().kind(), io::ErrorKind::NotFound);
    let error = Rig::from_json("{\n\"format\"").unwrap_err();
    assert!(matches!(error, Error::Rig { .. }), "{error:?}");
    let cause = error
        .source()
        .and_then(|cause| cause.downcast_ref::<serde_json::Error>());
    assert_eq!(cause.unwrap().line(), 2);
    // A rig that is JSON has no other cause than itself.
    let error = Rig::from_json("{}").unwrap_err();
    assert!(matches!(error, Error::Rig { .. }) && error.source().is_none());
}

#[test]
fn the_documented_example_is_a_rig() {
    let docs = include_str!("../../../../docs/reference/rig-file.md");
    let example = docs
        .split("```json")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .unwrap();
    assert_eq!(Rig::from_json(example).unwrap().cameras().len(), 2);
}

fn assert_one_sentence(error: &str) {
    assert!(
        !error.contains('\n') && !error.ends_with('.') && error.len() < 400,
        "{error}"
    );
}

pub fn assert_survives_writing(rig: &Rig) {
    let again = Rig::from_json(&rig.to_json()).unwrap();
    assert_eq!(again.reference(), rig.reference());
    assert_eq!(again.cameras().len(), rig.cameras().len());
    for (a, b) in rig.cameras().iter().zip(again.cameras()) {
        assert_eq!(
            (a.id(), a.width(), a.height()),
            (b.id(), b.width(), b.height())
        );
        assert_eq!(a.intrinsics(), b.intrinsics());
        let (a, b) = (a.world_from_cam(), b.world_from_cam());
        let off = a.to_homogeneous() - b.to_homogeneous();
        assert!(off.norm() < 1e-9 * (1.0 + a.translation.vector.norm()));
    }
}

#[test]
fn a_rig_survives_writing() {
    assert_survives_writing(&Rig::from_json(GOOD).unwrap());
}

fn any_json() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        (-2.0..2.0f64).prop_map(Value::from),
        "\\PC{0,8}".prop_map(Value::from),
        Just(json!("left")),
        Just(json!([
            [1, 0, 0, 0],
            [0, 1, 0, 0],
            [0, 0, 1, 0],
            [0, 0, 0, 1]
        ])),
    ];
    leaf.prop_recursive(3, 24, 5, |inner| {
        let key = "t|q_wxyz|model|params|\\PC{0,4}";
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..5).prop_map(Value::from),
            prop::collection::btree_map(key, inner, 0..4)
                .prop_map(|map| Value::Object(map.into_iter().collect())),
        ]
    })
}

/// Where, how many characters, and what comes in their place.
fn any_edit() -> impl Strategy<Value = (prop::sample::Index, usize, String)> {
    let text = "\\PC{0,3}|[0-9]{1,3}|[\\[\\]{},:\"]";
    (any::<prop::sample::Index>(), 0..6usize, text)
}

/// Every place in a JSON value, as a JSON pointer.
fn places(value: &Value, at: String, out: &mut Vec<String>) {
    match value {
        Value::Object(map) => {
            map.iter()
                .for_each(|(key, value)| places(value, format!("{at}/{key}"), out));
        }
        Value::Array(list) => {
            let items = list.iter().enumerate();
            items.for_each(|(i, value)| places(value, format!("{at}/{i}"), out));
        }
        _ => {}
    }
    out.push(at);
}

/// Read or refused in one sentence; never a panic, never a rig that cannot be written and read.
fn check(text: &str) {
    match Rig::from_json(text) {
        Ok(rig) => assert_survives_writing(&rig),
        Err(error) => assert_one_sentence(&error.to_string()),
    }
}

proptest! {
    #[test]
    fn no_value_in_any_place_makes_reading_panic(
        value in any_json(),
        place in any::<prop::sample::Index>(),
    ) {
        let mut rig: Value = serde_json::from_str(GOOD).unwrap();
        let mut all = Vec::new();
        places(&rig, String::new(), &mut all);
        *rig.pointer_mut(&all[place.index(all.len())]).unwrap() = value;
        check(&rig.to_string());
    }

    #[test]
    fn no_edit_of_the_text_makes_reading_panic(
        edits in prop::collection::vec(any_edit(), 1..4),
    ) {
        let mut text: Vec<char> = GOOD.chars().collect();
        for (at, length, new) in edits {
            let start = at.index(text.len());
            let end = (start + length).min(text.len());
            text.splice(start..end, new.chars());
        }
        check(&text.into_iter().collect::<String>());
    }
}
