//! What views show of instances behind each other, and their colors.

use super::coordinates::{brick, brick_pose, cameras, painted_images};
use super::instances::candidate;
use super::*;
use crate::estimator::color_check;
use crate::estimator::instance::Instance;
use crate::estimator::occlusion::seen;
use crate::estimator::pipeline::Pipeline;
use crate::prediction::WarningCode;
use crate::scorer::Scorer;

/// Finds nothing.
struct Blind;

impl Network for Blind {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        Ok(DetectorMaps {
            scores: Array4::zeros((images.dim().0, 1, 2, 2)),
            boxes: Array4::zeros((images.dim().0, 4, 2, 2)),
        })
    }

    fn provider(&self) -> &str {
        "blind"
    }
}

fn bricks_rig() -> Rig {
    Rig::new(cameras(), 0).unwrap()
}

fn estimator() -> Estimator {
    let bundle = Bundle {
        classes: vec![brick()],
        scorer: Some(Scorer::default()),
        ..bundle()
    };
    Estimator::new(bundle, Box::new(Blind))
}

fn instance(world_from_obj: Isometry3<f64>, log_odds: f64) -> Instance {
    Instance {
        class: 0,
        detections: vec![None; 3],
        candidates: vec![candidate(world_from_obj, log_odds)],
        excluded: Vec::new(),
    }
}

/// Shares of two instances that each of three views shows.
fn shares(instances: &[Instance]) -> [[f64; 3]; 2] {
    let (estimator, rig) = (estimator(), bricks_rig());
    let (images, options) = (painted_images(&rig), PredictOptions::default());
    let network = estimator.network.as_ref();
    let pipeline = Pipeline::new(&estimator, network, &rig, &images, &options).unwrap();
    let seen = seen(&pipeline, instances);
    [0, 1].map(|of| [0, 1, 2].map(|view| seen[of][view].share))
}

/// `brick_pose` moved by a share of the way to a camera.
fn towards(camera: usize, share: f64) -> Isometry3<f64> {
    let place = bricks_rig().cameras()[camera]
        .world_from_cam()
        .translation
        .vector;
    let shift = (place - brick_pose().translation.vector) * share;
    Translation3::from(shift) * brick_pose()
}

#[test]
fn what_stands_before_another_hides_it_in_that_view_alone() {
    let behind = instance(brick_pose(), 5.0);
    let hidden = shares(&[behind.clone(), instance(towards(1, 0.4), 5.0)]);
    assert_eq!(hidden, [[1.0, 0.0, 1.0], [1.0; 3]]);
    // What is not sure to be there hides nothing.
    let unsure = shares(&[behind, instance(towards(1, 0.4), 0.0)]);
    assert_eq!(unsure, [[1.0; 3]; 2]);
}

#[test]
fn a_part_that_is_half_hidden_is_half_in_sight() {
    let rig = bricks_rig();
    let camera = &rig.cameras()[1];
    // Before the brick, and half of its height beside it in that view.
    let up = camera.world_from_cam().rotation * Vector3::y() * 0.05;
    let before = Translation3::from(up) * towards(1, 0.15);
    let [[_, share, _], _] = shares(&[instance(brick_pose(), 5.0), instance(before, 5.0)]);
    assert!((0.25..0.75).contains(&share), "{share}");
}

#[test]
fn exchanged_red_and_blue_are_told_by_the_colors_of_probable_poses() {
    let (estimator, rig) = (estimator(), bricks_rig());
    let options = PredictOptions::default();
    let warned = |exchange: bool, log_odds: f64| {
        let mut images = painted_images(&rig);
        for pixel in images.iter_mut().flat_map(|one| one.image.pixels_mut()) {
            if exchange {
                pixel.0.swap(0, 2);
            }
        }
        let network = estimator.network.as_ref();
        let pipeline = Pipeline::new(&estimator, network, &rig, &images, &options).unwrap();
        let instances = [instance(brick_pose(), log_odds)];
        let seen = seen(&pipeline, &instances);
        let warning = color_check::check(&pipeline, &instances, &seen).unwrap();
        warning.map(|one| one.code)
    };
    assert_eq!(warned(false, 5.0), None);
    assert_eq!(warned(true, 5.0), Some(WarningCode::ColorsExchanged));
    // A pose that may be wrong tells nothing.
    assert_eq!(warned(true, -1.0), None);
}
