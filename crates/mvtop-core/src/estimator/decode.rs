//! From pictures to poses.

use std::iter;

use ndarray::{Array2, Array3, Axis};

use super::hypotheses;
use super::picture::{Group, Picture, Pictures, Query};
use super::pose::DecodedPose;
use crate::Result;
use crate::bundle::Bundle;
use crate::network::{Network, Queries};
use crate::prediction::Hypothesis;
use crate::rays::{BoxRays, LosEncoding, encode};

/// Pictures of an object that are anchors in turn, at most: more cost time and gain little.
pub const MAX_ANCHORS: usize = 4;

/// The pose of every object, by its index.
///
/// An object is decoded anchored in one after the other of the first pictures that show it, in the
/// rig's order. The mean of poses near each other errs less than each, and as no picture is chosen
/// for being the reference camera's, the poses in the world do not depend on which camera that is.
pub fn poses(
    network: &dyn Network,
    bundle: &Bundle,
    pictures: &Pictures,
    groups: &[Group],
) -> Result<Vec<DecodedPose>> {
    let encoding = bundle.los_encoding;
    let objects = groups.iter().map(|group| group.objects.len()).sum();
    let mut classes = vec![0; objects];
    for query in groups.iter().flat_map(|group| &group.objects) {
        classes[query.object] = query.class;
    }
    let mut anchored: Vec<Vec<Hypothesis>> = iter::repeat_with(Vec::new).take(objects).collect();
    for Group {
        pictures: range,
        objects,
    } in groups
    {
        for anchor in range.clone() {
            let queries: Vec<&Query> = objects
                .iter()
                .filter(|query| query.is_anchored_in(anchor - range.start))
                .collect();
            if queries.is_empty() {
                continue;
            }
            let others = range.clone().filter(|&picture| picture != anchor);
            let order: Vec<usize> = iter::once(anchor).chain(others).collect();
            let memory = pictures.memory.select(Axis(0), &order);
            let shown: Vec<(&Picture, usize)> = order
                .iter()
                .map(|&picture| (&pictures.list[picture], picture - range.start))
                .collect();
            let decoded = network.decode(memory.view(), &inputs(&shown, &queries, encoding))?;
            decoded.check(queries.len())?;
            let world_from_anchor = &pictures.list[anchor].camera.world_from_cam();
            for (q, query) in queries.iter().enumerate() {
                let found = Hypothesis::of_query(world_from_anchor, &decoded, q)?;
                anchored[query.object].extend(found);
            }
        }
    }
    let of_class = |(poses, class): (_, usize)| {
        let class = &bundle.classes[class];
        hypotheses::combined(poses, &class.symmetry, class.diameter_m)
    };
    Ok(anchored.into_iter().zip(classes).map(of_class).collect())
}

impl Query {
    /// Whether the picture is among the first that show it.
    fn is_anchored_in(&self, picture: usize) -> bool {
        let before = self.boxes[..picture].iter().flatten().count();
        self.boxes[picture].is_some() && before < MAX_ANCHORS
    }
}

/// The decoder's input for objects anchored in the first of `pictures`.
///
/// - `pictures`: each with its place in the objects' boxes
fn inputs(pictures: &[(&Picture, usize)], objects: &[&Query], encoding: LosEncoding) -> Queries {
    let (v_len, q_len) = (pictures.len(), objects.len());
    let (anchor, _) = pictures[0];
    let cells = anchor.camera_rays.nrows();
    let mut queries = Queries {
        rays: Array3::zeros((v_len, cells, encoding.width())),
        centers: Array3::from_elem((v_len, q_len, 2), 0.5),
        half_sizes: Array3::zeros((v_len, q_len, 2)),
        box_rays: Array3::zeros((v_len, q_len, 12)),
        valid: Array2::zeros((v_len, q_len)),
        class_index: objects.iter().map(|query| query.class as i64).collect(),
    };
    for (row, (picture, place)) in pictures.iter().enumerate() {
        let world_from_cam = &picture.camera.world_from_cam();
        let anchor_from_cam = anchor.camera.world_from_cam().inv_mul(world_from_cam);
        let rays = encode(picture.camera_rays.view(), &anchor_from_cam, encoding);
        queries.rays.index_axis_mut(Axis(0), row).assign(&rays);
        for (q, query) in objects.iter().enumerate() {
            let Some(bbox) = query.boxes[*place] else {
                continue;
            };
            // Boxes without rays are no detections, and are refused where they are given.
            let Some(rays) = BoxRays::new(&picture.camera, bbox) else {
                continue;
            };
            let (center, half_size) = picture.relative(bbox);
            for axis in 0..2 {
                queries.centers[(row, q, axis)] = center[axis] as f32;
                queries.half_sizes[(row, q, axis)] = half_size[axis] as f32;
            }
            for (i, number) in rays.encode(&anchor_from_cam).into_iter().enumerate() {
                queries.box_rays[(row, q, i)] = number;
            }
            queries.valid[(row, q)] = 1.0;
        }
    }
    queries
}
