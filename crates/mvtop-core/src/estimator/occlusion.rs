//! What each view shows of each instance, and what others hide of it.

use nalgebra::Point3;
use rayon::prelude::*;

use super::instance::Instance;
use super::pipeline::Pipeline;
use crate::bundle::SurfacePoint;
use crate::refine::DepthMap;

/// The surfaces of all instances at their best poses, in all views.
pub struct Surfaces {
    /// By instance, then by view; `None` where a class has no mesh, or a view does not show it.
    maps: Vec<Vec<Option<DepthMap>>>,
    /// By instance: whether it is sure enough to hide others.
    settled: Vec<bool>,
}

impl Surfaces {
    pub fn new(pipeline: &Pipeline, instances: &[Instance]) -> Self {
        let of_instance = |one: &Instance| {
            let refiner = pipeline.estimator.refiners[one.class].as_ref();
            let seen = refiner.zip(one.best());
            let views = pipeline.views.iter();
            views
                .map(|view| {
                    let (refiner, best) = seen?;
                    refiner.depth_map(view.camera, &best.world_from_obj)
                })
                .collect()
        };
        Self {
            maps: instances.par_iter().map(of_instance).collect(),
            settled: instances
                .iter()
                .map(|one| pipeline.is_settled(one))
                .collect(),
        }
    }

    /// Share of what a view would show of an instance that no settled one hides; 1 where this is not
    /// known.
    pub fn share(
        &self,
        pipeline: &Pipeline,
        instances: &[Instance],
        of: usize,
        view: usize,
    ) -> f64 {
        let mut all = 0;
        let mut seen = 0;
        for (_, point) in self.front(pipeline, instances, of, view) {
            all += 1;
            seen += usize::from(!self.is_hidden(of, view, &point));
        }
        match all {
            0 => 1.0,
            all => f64::from(seen as u32) / f64::from(all),
        }
    }

    /// The points of an instance that a view shows, with their places in the world frame, metres.
    pub fn seen<'a>(
        &'a self,
        pipeline: &'a Pipeline,
        instances: &'a [Instance],
        of: usize,
        view: usize,
    ) -> impl Iterator<Item = (&'a SurfacePoint, Point3<f64>)> {
        let front = self.front(pipeline, instances, of, view);
        front.filter(move |(_, point)| !self.is_hidden(of, view, point))
    }

    /// The points that the instance itself does not hide.
    fn front<'a>(
        &'a self,
        pipeline: &'a Pipeline,
        instances: &'a [Instance],
        of: usize,
        view: usize,
    ) -> impl Iterator<Item = (&'a SurfacePoint, Point3<f64>)> {
        let class = &pipeline.estimator.bundle.classes[instances[of].class];
        let tolerance = pipeline.config().refine.occlusion_tolerance[0] * class.diameter_m;
        let seen = self.maps[of][view].as_ref().zip(instances[of].best());
        seen.into_iter().flat_map(move |(map, best)| {
            let points = class.points.iter();
            let placed = points.map(|one| (one, best.world_from_obj * Point3::from(one.position)));
            placed.filter(move |(_, point)| map.behind(point) < tolerance)
        })
    }

    fn is_hidden(&self, of: usize, view: usize, point: &Point3<f64>) -> bool {
        let others = self.maps.iter().zip(&self.settled).enumerate();
        let mut others = others.filter(|(other, (_, settled))| *other != of && **settled);
        others.any(|(_, (maps, _))| {
            let map = maps[view].as_ref();
            map.is_some_and(|map| map.behind(point) > 0.0)
        })
    }
}
