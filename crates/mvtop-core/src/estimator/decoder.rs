//! The decoder's poses of objects.

use std::iter;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use ndarray::{Array1, Array2, Array3, ArrayView1, Axis, s};

use super::crops::{Crop, Group};
use super::grouping::{groups, means};
use crate::bundle::Bundle;
use crate::config::SearchConfig;
use crate::network::{Decoded, Network, Queries};
use crate::pose::rotation_from_6d;
use crate::prediction::{Hypothesis, Sigma};
use crate::rays::{BoxRays, LosEncoding, encode};
use crate::{BBox, Error, Result};

/// The hypotheses of every object, by its index, the most probable first, with probabilities up to a
/// factor.
///
/// An object is decoded anchored in one crop after the other, in the order of its detections: so the
/// poses depend neither on which camera is the reference nor on the rig's order. Hypotheses near each
/// other are averaged.
///
/// - `crops`, `memory`: what the network was shown, and what it made of it
/// - `classes`: of the objects
pub fn hypotheses(
    network: &dyn Network,
    bundle: &Bundle,
    config: &SearchConfig,
    crops: &[Crop],
    memory: &Array3<f32>,
    grouped: &[Group],
    classes: &[usize],
) -> Result<Vec<Vec<Hypothesis>>> {
    let mut anchored: Vec<Vec<Hypothesis>> = vec![Vec::new(); classes.len()];
    for group in grouped {
        let crops = &crops[group.crops.clone()];
        for anchor in group.anchors(config.max_anchors, crops) {
            let others = (0..crops.len()).filter(|&crop| crop != anchor);
            let order: Vec<usize> = iter::once(anchor).chain(others).collect();
            let rows: Vec<usize> = order.iter().map(|at| group.crops.start + at).collect();
            let memory = memory.select(Axis(0), &rows);
            let queries = inputs(crops, group, &order, bundle.los_encoding);
            let decoded = network.decode(memory.view(), &queries)?;
            decoded.check(1)?;
            let world_from_anchor = crops[anchor].camera.world_from_cam();
            let found = Hypothesis::of_query(world_from_anchor, &decoded, 0)?;
            anchored[group.object].extend(found);
        }
    }
    let of_class = |(all, class): (_, &usize)| {
        let class = &bundle.classes[*class];
        let groups = groups(all, &class.symmetry, class.diameter_m, config.merge_deg);
        means(&groups, &class.symmetry, class.diameter_m)
    };
    Ok(anchored.into_iter().zip(classes).map(of_class).collect())
}

impl Group {
    /// Which of its crops are anchors, in their order: those with the largest boxes, which show most.
    fn anchors(&self, most: usize, crops: &[Crop]) -> Vec<usize> {
        let size = |(bbox, crop): (&BBox, &Crop)| {
            bbox.width().max(bbox.height()) / crop.camera.intrinsics().fx()
        };
        let sizes = self.boxes.iter().zip(crops).map(size).enumerate();
        let mut sizes: Vec<(usize, f64)> = sizes.collect();
        sizes.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut anchors: Vec<usize> = sizes.into_iter().map(|(at, _)| at).take(most).collect();
        anchors.sort_unstable();
        anchors
    }
}

/// The decoder's input for an object anchored in the first of its crops in this order.
fn inputs(crops: &[Crop], group: &Group, order: &[usize], encoding: LosEncoding) -> Queries {
    let views = order.len();
    let anchor = &crops[order[0]];
    let cells = anchor.camera_rays.nrows();
    let mut queries = Queries {
        rays: Array3::zeros((views, cells, encoding.width())),
        centers: Array3::from_elem((views, 1, 2), 0.5),
        half_sizes: Array3::zeros((views, 1, 2)),
        box_rays: Array3::zeros((views, 1, 12)),
        valid: Array2::zeros((views, 1)),
        class_index: Array1::from_elem(1, group.class as i64),
    };
    for (row, &at) in order.iter().enumerate() {
        let (crop, bbox) = (&crops[at], group.boxes[at]);
        let world_from_cam = &crop.camera.world_from_cam();
        let anchor_from_cam = anchor.camera.world_from_cam().inv_mul(world_from_cam);
        let rays = encode(crop.camera_rays.view(), &anchor_from_cam, encoding);
        queries.rays.index_axis_mut(Axis(0), row).assign(&rays);
        // Boxes without rays are no detections, and are refused where they are given.
        let Some(rays) = BoxRays::new(&crop.camera, bbox) else {
            continue;
        };
        let (center, half_size) = crop.relative(bbox);
        for axis in 0..2 {
            queries.centers[(row, 0, axis)] = center[axis] as f32;
            queries.half_sizes[(row, 0, axis)] = half_size[axis] as f32;
        }
        for (i, number) in rays.encode(&anchor_from_cam).into_iter().enumerate() {
            queries.box_rays[(row, 0, i)] = number;
        }
        queries.valid[(row, 0)] = 1.0;
    }
    queries
}

impl Hypothesis {
    /// Those of query `q`, from the anchor's frame into the world.
    pub fn of_query(
        world_from_anchor: &Isometry3<f64>,
        decoded: &Decoded,
        q: usize,
    ) -> Result<Vec<Self>> {
        let Some(several) = &decoded.hypotheses else {
            let [rotation, t, sigma] = [&decoded.rotation_6d, &decoded.translation, &decoded.sigma]
                .map(|array| array.row(q));
            return Ok(vec![Self::new(
                world_from_anchor,
                [rotation, t, sigma],
                1.0,
            )?]);
        };
        let scores = several.score.row(q).mapv(f64::from);
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let odds = scores.mapv(|score| (score - most).exp());
        let one = |(k, odd): (usize, &f64)| {
            let numbers = [&several.rotation_6d, &several.translation, &several.sigma]
                .map(|array| array.slice(s![q, k, ..]));
            Self::new(world_from_anchor, numbers, odd / odds.sum())
        };
        odds.iter().enumerate().map(one).collect()
    }

    /// - `numbers`: rotation, translation and sigma, in the anchor's frame
    fn new(
        world_from_anchor: &Isometry3<f64>,
        [rotation, t, sigma]: [ArrayView1<f32>; 3],
        probability: f64,
    ) -> Result<Self> {
        let number = |array: ArrayView1<f32>, i: usize| f64::from(array[i]);
        let t = [0, 1, 2].map(|i| number(t, i));
        let sigma = Sigma {
            rot_deg: number(sigma, 0),
            t_m: number(sigma, 1),
        };
        let all = t.iter().chain([&sigma.rot_deg, &sigma.t_m, &probability]);
        if !all.copied().all(f64::is_finite) {
            return Err(Error::Pose(format!(
                "decoder: expected a finite pose, got translation {t:?} and {sigma:?}"
            )));
        }
        if sigma.rot_deg < 0.0 || sigma.t_m < 0.0 {
            return Err(Error::Pose(format!(
                "decoder: expected errors of 0 or more, got {sigma:?}"
            )));
        }
        let rotation = rotation_from_6d([0, 1, 2, 3, 4, 5].map(|i| number(rotation, i)))?;
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        let anchor_from_obj = Isometry3::from_parts(Translation3::from(t), rotation);
        Ok(Self {
            world_from_obj: world_from_anchor * anchor_from_obj,
            sigma,
            probability,
        })
    }
}
