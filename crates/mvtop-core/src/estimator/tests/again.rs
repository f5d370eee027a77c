//! Boxes that are told by the poses that came of others.

use super::completed::surface;
use super::*;
use crate::estimator::again::{at_pose, untried};
use crate::estimator::complete::shown;

#[test]
fn half_a_box_is_made_whole_by_the_pose_and_what_fits_stays() {
    let (rig, mut bundle) = (rig(), bundle());
    bundle.classes[0].points = surface();
    let class = &bundle.classes[0];
    let images = images(&rig, &[0, 1, 2]);
    let views = view::gather(&bundle, &rig, &images).unwrap();
    let [ball, _] = BALLS;
    let world_from_obj = Isometry3::translation(ball[0], ball[1], ball[2]);
    let whole: Vec<Option<BBox>> = (views.iter())
        .map(|view| shown(class, view, &world_from_obj))
        .collect();
    assert!(whole.iter().all(Option::is_some));
    let object = |boxes: &[Option<BBox>]| Sighting {
        class: 0,
        score: 0.5,
        boxes: boxes.to_vec(),
    };
    let again = |boxes: &[Option<BBox>]| at_pose(class, &views, &object(boxes), &world_from_obj);
    assert!(again(&whole).is_none());

    let mut half = whole.clone();
    let bbox = half[1].as_mut().unwrap();
    bbox.y1 = (bbox.y0 + bbox.y1) / 2.0;
    assert_eq!(again(&half).unwrap().boxes, whole);

    // A view without a box gets one as well.
    let missed = [whole[0], whole[1], None];
    assert_eq!(again(&missed).unwrap().boxes, whole);

    // Where the pose is out of an image, what was seen there stays.
    let beside = world_from_obj * Isometry3::translation(0.0, 50.0, 0.0);
    assert!(at_pose(class, &views, &object(&half), &beside).is_none());
}

#[test]
fn boxes_that_show_the_same_are_tried_once() {
    let object = |x: f64, other: Option<f64>| Sighting {
        class: 0,
        score: 0.5,
        boxes: [Some(x), other]
            .map(|x| x.map(|x| [x, 0.0, x + 100.0, 100.0].into()))
            .to_vec(),
    };
    let mut tried = vec![object(0.0, None).boxes];
    let told = vec![
        object(2.0, None),       // as that one
        object(20.0, None),      // beside it
        object(22.0, None),      // as the one before
        object(0.0, Some(0.0)),  // another view shows it, too
        object(2.0, Some(40.0)), // elsewhere there
    ];
    let places = |objects: &[Sighting]| -> Vec<Vec<Option<f64>>> {
        let of = |object: &Sighting| object.boxes.iter().map(|b| b.map(|b| b.x0)).collect();
        objects.iter().map(of).collect()
    };
    let new = untried(told.clone(), &mut tried);
    let expected = [
        vec![Some(20.0), None],
        vec![Some(0.0), Some(0.0)],
        vec![Some(2.0), Some(40.0)],
    ];
    assert_eq!(places(&new), expected);
    assert_eq!(tried.len(), 4);
    assert!(untried(told, &mut tried).is_empty());
}
