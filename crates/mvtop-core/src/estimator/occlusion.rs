//! What each view shows of each instance, and what others hide of it.

use nalgebra::Point3;
use rayon::prelude::*;

use super::instance::Instance;
use super::pipeline::Pipeline;
use crate::refine::DepthMap;

/// What a view shows of an instance at its best pose.
pub struct Seen {
    /// Share of what the view would show of it that no settled instance hides; 1 where this is not
    /// known.
    pub share: f64,
    /// Color and place of each point in sight, sRGB and world frame, metres; empty without a mesh.
    pub points: Vec<([u8; 3], Point3<f64>)>,
}

/// By instance, then by view. Meshes are rendered; what is settled hides others.
pub fn seen(pipeline: &Pipeline, instances: &[Instance]) -> Vec<Vec<Seen>> {
    let rendered = |one: &Instance| -> Vec<Option<DepthMap>> {
        let refiner = pipeline.estimator.refiners[one.class].as_ref();
        let known = refiner.zip(one.best());
        let views = pipeline.views.iter();
        let map = |view: &super::view::View| {
            let (refiner, best) = known?;
            refiner.depth_map(view.camera, &best.world_from_obj)
        };
        views.map(map).collect()
    };
    let maps: Vec<_> = instances.par_iter().map(rendered).collect();
    let settled: Vec<usize> = (0..instances.len())
        .filter(|&one| pipeline.is_settled(&instances[one]))
        .collect();
    let is_hidden = |of: usize, view: usize, point: &Point3<f64>| {
        let mut others = settled.iter().filter(|other| **other != of);
        others.any(|&other| {
            let map = maps[other][view].as_ref();
            map.is_some_and(|map| map.behind(point) > 0.0)
        })
    };
    let of_view = |of: usize, view: usize| {
        let class = &pipeline.estimator.bundle.classes[instances[of].class];
        let tolerance = pipeline.config().refine.occlusion_tolerance[0] * class.diameter_m;
        let Some((map, best)) = maps[of][view].as_ref().zip(instances[of].best()) else {
            return Seen {
                share: 1.0,
                points: Vec::new(),
            };
        };
        let placed = class
            .points
            .iter()
            .map(|one| (one.color, best.world_from_obj * Point3::from(one.position)));
        let front: Vec<_> = placed
            .filter(|(_, point)| map.behind(point) < tolerance)
            .collect();
        let count = front.len();
        let points: Vec<_> = front
            .into_iter()
            .filter(|(_, point)| !is_hidden(of, view, point))
            .collect();
        Seen {
            share: match count {
                0 => 1.0,
                count => points.len() as f64 / count as f64,
            },
            points,
        }
    };
    let each = (0..instances.len()).into_par_iter();
    each.map(|of| {
        let views = 0..pipeline.views.len();
        views.map(|view| of_view(of, view)).collect()
    })
    .collect()
}
