//! A second look at objects that their close-ups hardly show.
//!
//! The box of what is half hidden often ends where that is hidden, and the close-up of such a box
//! shows the object where it is not. The pose that comes of it, refined on the images, tells a better
//! box, that a better pose.

use nalgebra::Isometry3;

use super::complete::shown;
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use super::{Estimator, refined};
use crate::bundle::{Class, CloseUps};
use crate::network::Network;
use crate::{BBox, Result};

/// Looks at an object, at most.
const LOOKS: usize = 5;
/// Times the least support of an object: what is supported more is seen well enough.
const WELL: f64 = 2.5;
/// A box that overlaps with that of the pose by this (intersection over union) shows the same.
const SAME: f64 = 0.9;

impl Estimator {
    /// The objects, those that are hardly supported with the boxes and poses that support them most.
    pub(super) fn looked_at_again(
        &self,
        network: &dyn Network,
        closeups: &CloseUps,
        views: &[View],
        mut found: Vec<(Sighting, DecodedPose)>,
    ) -> Result<Vec<(Sighting, DecodedPose)>> {
        let enough = WELL * self.bundle.detector.support_threshold;
        let support = |pose: &DecodedPose| pose.support.unwrap_or(f64::INFINITY);
        let doubtful = |(object, pose): &(Sighting, DecodedPose)| {
            self.refiners[object.class].is_some() && object.views() > 1 && support(pose) < enough
        };
        let all = 0..found.len();
        let mut open: Vec<usize> = all.filter(|&index| doubtful(&found[index])).collect();
        for _ in 0..LOOKS {
            let mut seen: Vec<_> = open.iter().map(|&index| found[index].clone()).collect();
            refined::on_images(&self.refiners, views, &self.bundle, &mut seen);
            let moved = open
                .iter()
                .zip(&seen)
                .filter_map(|(&index, (object, pose))| {
                    let class = &self.bundle.classes[object.class];
                    let moved = at_pose(class, views, object, &pose.world_from_obj)?;
                    Some((index, moved))
                });
            let (indices, objects): (Vec<usize>, Vec<Sighting>) = moved.unzip();
            if objects.is_empty() {
                break;
            }
            let poses = self.decoded(network, closeups, views, &objects)?;
            open.clear();
            for ((index, object), pose) in indices.into_iter().zip(objects).zip(poses) {
                if support(&pose) > support(&found[index].1) {
                    if support(&pose) < enough {
                        open.push(index);
                    }
                    found[index] = (object, pose);
                }
            }
        }
        Ok(found)
    }
}

/// The object with the boxes of a pose of it; `None` where it has them.
pub(super) fn at_pose(
    class: &Class,
    views: &[View],
    object: &Sighting,
    world_from_obj: &Isometry3<f64>,
) -> Option<Sighting> {
    let each = views.iter().zip(&object.boxes);
    let boxes: Vec<Option<BBox>> = each
        .map(|(view, bbox)| shown(class, view, world_from_obj).or(*bbox))
        .collect();
    let same = |(a, b): (&Option<BBox>, &Option<BBox>)| match (a, b) {
        (Some(a), Some(b)) => a.iou(b) > SAME,
        (a, b) => a.is_none() && b.is_none(),
    };
    let moved = !boxes.iter().zip(&object.boxes).all(same);
    moved.then(|| Sighting {
        boxes,
        ..object.clone()
    })
}
