//! Which images of a scene go together, by its frames or by a list of targets.

use std::collections::BTreeMap;

use mvtop_eval::bop::{FrameId, Group, Grouping, Scene, Target, groups, load_targets};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::bop::{id, write, write_sensor};

fn shown(groups: &[Group]) -> Vec<String> {
    groups
        .iter()
        .map(|group| {
            let views: Vec<String> = group.views.iter().map(FrameId::to_string).collect();
            views.join(" ")
        })
        .collect()
}

#[test]
fn frames_of_a_scene_are_spread_from_the_reference_on() {
    let dir = TempDir::new().unwrap();
    write_sensor(&dir.path().join("000001"), "", "rgb", 6);
    let scene = Scene::load(dir.path(), 1).unwrap();
    let of = |views| shown(&groups(&scene, Grouping::Scene, views, None, None).unwrap());
    assert_eq!(of(Some(1))[4], "000004");
    assert_eq!(of(Some(2))[0], "000000 000003");
    assert_eq!(of(Some(3))[4], "000004 000000 000002");
    assert_eq!(of(None)[5], "000005 000000 000001 000002 000003 000004");
    assert_eq!(of(Some(6)), of(None));
    // There are no more.
    assert_eq!(of(Some(7)), of(None));
}

#[test]
fn cameras_of_a_frame_have_the_same_number() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("000003");
    for (sensor, kind) in [("cam1", "rgb"), ("cam2", "gray"), ("photoneo", "depth")] {
        write_sensor(&folder, sensor, kind, 2);
    }
    // The second sensor has one image more.
    write_sensor(&folder, "cam3", "rgb", 3);
    let scene = Scene::load(dir.path(), 3).unwrap();
    let of = |views, sensor| groups(&scene, Grouping::Frame, views, sensor, None);
    assert_eq!(
        shown(&of(None, None).unwrap()),
        [
            "cam1/000000 cam2/000000 cam3/000000",
            "cam1/000001 cam2/000001 cam3/000001"
        ]
    );
    assert_eq!(
        shown(&of(Some(2), Some("cam2")).unwrap()),
        ["cam2/000000 cam1/000000", "cam2/000001 cam1/000001"]
    );
    let of_third = shown(&of(Some(2), Some("cam3")).unwrap());
    assert_eq!(of_third[1..], ["cam3/000001 cam1/000001", "cam3/000002"]);
    let error = of(None, Some("left")).unwrap_err().to_string();
    assert!(error.contains("sensor `left`"), "{error}");
    // Frames of one of several sensors.
    let frames = groups(&scene, Grouping::Scene, Some(2), Some("cam3"), None).unwrap();
    assert_eq!(shown(&frames)[2], "cam3/000002 cam3/000000");
}

#[test]
fn listed_views_have_the_sensor_asked_for_as_reference() {
    let dir = TempDir::new().unwrap();
    for sensor in ["cam1", "photoneo"] {
        write_sensor(&dir.path().join("000048"), sensor, "rgb", 2);
    }
    let scene = Scene::load(dir.path(), 48).unwrap();
    assert_eq!(Grouping::of(&scene), Grouping::Frame);
    let target = Target {
        scene: 48,
        views: vec![id("cam1", 0), id("photoneo", 0)],
        listed: true,
        objects: None,
    };
    let of = |views, sensor| {
        let targets = Some(vec![target.clone()]);
        shown(&groups(&scene, Grouping::Frame, views, sensor, targets).unwrap())
    };
    assert_eq!(of(None, None), ["cam1/000000 photoneo/000000"]);
    let turned = of(None, Some("photoneo"));
    assert_eq!(turned, ["photoneo/000000 cam1/000000"]);
    assert_eq!(of(Some(1), Some("photoneo")), ["photoneo/000000"]);
    assert_eq!(of(Some(1), Some("cam2")), ["cam1/000000"]);
}

#[test]
fn every_kind_of_targets_is_read() {
    let dir = TempDir::new().unwrap();
    let load = |content: Value| {
        let path = dir.path().join("targets.json");
        write(&path, &content);
        load_targets(&path)
    };
    let target = |views: &[FrameId], objects: Option<&[(u32, Option<usize>)]>| Target {
        scene: 48,
        views: views.to_vec(),
        listed: objects.is_none(),
        objects: objects.map(|ids| ids.iter().copied().collect()),
    };
    let bop19 = json!([
        {"scene_id": 48, "im_id": 1, "obj_id": 5, "inst_count": 1},
        {"scene_id": 48, "im_id": 36, "obj_id": 5, "inst_count": 1},
        {"scene_id": 48, "im_id": 1, "obj_id": 7, "inst_count": 2},
    ]);
    assert_eq!(
        load(bop19).unwrap(),
        [
            target(&[id("", 1)], Some(&[(5, Some(1)), (7, Some(2))])),
            target(&[id("", 36)], Some(&[(5, Some(1))]))
        ]
    );
    let bop24 = json!([{"scene_id": 48, "im_id": 1}]);
    let open = Target {
        listed: false,
        ..target(&[id("", 1)], None)
    };
    assert_eq!(load(bop24).unwrap(), [open]);
    let several = json!([
        {"scene_id": 48, "im_id": [["default", 1626], ["cam1", 3]]},
        // A view that is named twice, as in XYZ-IBD, is one.
        {"scene_id": 48, "im_id": [4, 2, ["default", 4]]},
        {"scene_id": 48, "im_id": [4, 2]},
        {"scene_id": 48, "im_id": [7]},
    ]);
    assert_eq!(
        load(several).unwrap(),
        [
            target(&[id("", 1626), id("cam1", 3)], None),
            target(&[id("", 4), id("", 2)], None),
            target(&[id("", 7)], None)
        ]
    );
    let pairs = json!({"pairs": [[48, 0, 2]]});
    assert_eq!(
        load(pairs).unwrap(),
        [target(&[id("", 0), id("", 2)], None)]
    );
    for wrong in [
        json!([]),
        json!({}),
        json!([{"scene_id": 48}]),
        json!([{"scene_id": 48, "im_id": []}]),
    ] {
        let error = load(wrong).unwrap_err().to_string();
        assert!(
            error.contains("targets.json: ") && !error.contains('\n'),
            "{error}"
        );
    }
}

#[test]
fn targets_name_views_or_leave_them_to_the_grouping() {
    let dir = TempDir::new().unwrap();
    write_sensor(&dir.path().join("000048"), "cam1", "rgb", 4);
    let scene = Scene::load(dir.path(), 48).unwrap();
    let target = |views: Vec<FrameId>, listed| Target {
        scene: 48,
        views,
        listed,
        objects: Some(BTreeMap::from([(7, Some(1))])),
    };
    let (one, two) = (
        target(vec![id("", 1)], false),
        target(vec![id("cam1", 3), id("cam1", 0)], true),
    );
    let of = |views, target: &Target| {
        groups(
            &scene,
            Grouping::Scene,
            views,
            None,
            Some(vec![target.clone()]),
        )
    };
    let grouped = of(Some(2), &one).unwrap();
    assert_eq!(shown(&grouped), ["cam1/000001 cam1/000003"]);
    assert_eq!(grouped[0].objects, one.objects);
    assert_eq!(shown(&of(None, &two).unwrap()), ["cam1/000003 cam1/000000"]);
    assert_eq!(shown(&of(Some(1), &two).unwrap()), ["cam1/000003"]);
    // Lists end in groups that are smaller than the others, down to one view.
    assert_eq!(
        shown(&of(Some(3), &two).unwrap()),
        ["cam1/000003 cam1/000000"]
    );
    let alone = target(vec![id("", 2)], true);
    assert_eq!(shown(&of(Some(3), &alone).unwrap()), ["cam1/000002"]);
    // There are no more than four.
    assert_eq!(of(Some(5), &one).unwrap()[0].views.len(), 4);
    let error = of(None, &target(vec![id("cam1", 9)], false))
        .unwrap_err()
        .to_string();
    assert!(error.contains("image cam1/000009"), "{error}");
}
