//! Which camera would tell most of what the views leave open.

use rayon::prelude::*;

use super::view::View;
use crate::Rig;
use crate::bundle::Bundle;
use crate::prediction::ObjectPose;
use crate::refine::Refiner;

/// Names for each object with several hypotheses the camera without an image that would see them
/// differ most: by how probable it is that one of two is right, and the other is taken for it.
///
/// - `refiners`: of each class
/// - `views`: those that gave an image
pub fn name(
    bundle: &Bundle,
    refiners: &[Option<Refiner>],
    rig: &Rig,
    views: &[View],
    objects: &mut [ObjectPose],
) {
    let unused: Vec<usize> = (0..rig.cameras().len())
        .filter(|camera| views.iter().all(|view| view.index != *camera))
        .collect();
    if unused.is_empty() {
        return;
    }
    objects.par_iter_mut().for_each(|object| {
        let class = bundle.class_index(&object.class);
        let Some(refiner) = class.and_then(|class| refiners[class].as_ref()) else {
            return;
        };
        let differ = |camera: usize| {
            let mut sum = 0.0;
            for (i, a) in object.hypotheses.iter().enumerate() {
                for b in &object.hypotheses[i + 1..] {
                    let camera = &rig.cameras()[camera];
                    let apart = refiner.difference(camera, &a.world_from_obj, &b.world_from_obj);
                    sum += a.probability * b.probability * apart;
                }
            }
            sum
        };
        let each = unused.par_iter().map(|&camera| (camera, differ(camera)));
        let best = each.max_by(|a, b| a.1.total_cmp(&b.1));
        object.next_view = best
            .filter(|(_, most)| *most > 0.0)
            .map(|(camera, _)| camera);
    });
}
