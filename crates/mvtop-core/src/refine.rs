//! Poses made exact on the images: the edges of the object's mesh are brought to where the images
//! show them, in all views at once.
//!
//! Each view is a close-up ([`crate::closeup`]) of the pose as it is, so that every lens is a pinhole
//! here. The mesh is drawn into it; along lines across its outline, its sharp edges and the borders
//! of its colors the true edge is searched for, by where colors change and how they differ to both
//! sides; six numbers, a turn and a shift, bring all of them there (Gauss-Newton, lines and views
//! losing weight as they disagree). From coarse to fine, the mesh being drawn anew each time. What
//! the network expected counts as a measurement, too: what the images do not tell stays as it was.
//! The turn of a round part, which no edge tells, is then found by its print.

mod around;
mod contour;
mod difference;
mod explained;
mod fit;
pub(crate) mod lines;
mod part;
mod picture;
mod print;
mod quality;
mod raster;
mod region;
pub(crate) mod solve;
mod working;

use image::RgbImage;
use nalgebra::{Isometry3, Matrix6, Point3};
use rayon::prelude::*;

use self::contour::EdgePoint;
use self::fit::Fit;
use self::part::Part;
use self::print::Print;
pub(crate) use self::quality::score;
pub use self::quality::{Quality, ViewQuality};
use self::solve::{ANGLE_PER_AXIS, Prior, Row};
use self::working::{COARSE, Detail, FINE, Working};
use crate::Camera;
use crate::bundle::SurfacePoint;
use crate::mesh::Mesh;
use crate::prediction::Sigma;
use crate::symmetry::Symmetry;

/// Steps of the lines, px of the close-up, one after the other.
const STEPS: [Steps; 2] = [
    (COARSE, &[4.0, 3.0, 2.0]),
    (FINE, &[2.0, 1.5, 1.0, 1.0, 1.0]),
];
/// Steps that end on the coarse close-ups.
const COARSE_STEPS: [Steps; 1] = [(COARSE, &[4.0, 4.0, 3.0, 2.0, 1.0, 1.0, 1.0])];
/// A camera's image in which the object may be seen.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// With its true lens.
    pub camera: &'a Camera,
    /// What it saw.
    pub image: &'a RgbImage,
}

/// A point on an edge of the mesh that a camera should see.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// World frame, metres.
    pub point: Point3<f64>,
    /// Whether the image has an edge within 1.5 px of a close-up (the finest of the refinement).
    pub supported: bool,
}

/// A refined pose.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Object frame to world frame, metres; the start where the refinement was not accepted.
    pub world_from_obj: Isometry3<f64>,
    /// How far it is expected to be off.
    pub sigma: Sigma,
    /// Inverse covariance of a turn about the object's center (radians) and a shift (metres), world
    /// frame: what the images tell and what was known.
    pub information: Matrix6<f64>,
    /// Share of the edge points that the images show within 1.5 px.
    pub supported: f64,
    /// Mean distance of the edges from where the images show them, px of the close-ups.
    pub residual_px: f64,
    /// How well the images show the object at this pose.
    pub quality: Quality,
    /// Whether the images fit it better than the start.
    pub accepted: bool,
}

/// A pose that was refined on coarse close-ups.
#[derive(Debug, Clone)]
pub struct Coarse {
    /// Object frame to world frame, metres; the start where the refinement was not accepted.
    pub world_from_obj: Isometry3<f64>,
    /// As [`Refined::information`].
    pub information: Matrix6<f64>,
    /// As [`Refined::supported`].
    pub supported: f64,
}

/// What refines poses of one object.
pub struct Refiner {
    part: Part,
    diameter: f64,
    print: Option<Print>,
    symmetry: Symmetry,
}

/// Close-ups, and the steps of the lines on them, px.
type Steps = (Detail, &'static [f64]);

/// What comes of a search.
struct Search {
    world_from_obj: Isometry3<f64>,
    information: Matrix6<f64>,
    fit: Fit,
    /// Else `world_from_obj` is the start.
    accepted: bool,
    /// As they looked at what was found, accepted or not.
    working: Vec<Working>,
}

impl Refiner {
    /// - `diameter_m`: largest distance between two points of the surface
    pub fn new(mesh: &Mesh, diameter_m: f64) -> Self {
        Self {
            part: Part::new(mesh),
            diameter: diameter_m,
            print: None,
            symmetry: Symmetry::default(),
        }
    }

    /// The same for a part that looks alike from several sides.
    pub fn with_symmetry(self, symmetry: Symmetry) -> Self {
        Self { symmetry, ..self }
    }

    /// The same for a part that may be round and printed on.
    ///
    /// - `points`: colored, of its surface
    pub fn with_print(self, points: &[SurfacePoint]) -> Self {
        Self {
            print: Print::new(points, self.part.center, self.diameter),
            ..self
        }
    }

    /// Middle of the mesh's box, about which turns are told: object frame, metres.
    pub fn center(&self) -> Point3<f64> {
        self.part.center
    }

    /// Largest distance between two points of the surface, metres.
    pub fn diameter_m(&self) -> f64 {
        self.diameter
    }

    /// The pose near `world_from_obj` at which the images show the mesh's edges; `None` where no view
    /// shows the object.
    ///
    /// - `sigma`: how far the pose is expected to be off
    pub fn refine(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        self.refined(&STEPS, views, world_from_obj, sigma)
    }

    /// Like [`Self::refine`], of a pose that coarse close-ups have told: no more than sharp ones add.
    pub fn refine_finely(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        self.refined(&STEPS[1..], views, world_from_obj, sigma)
    }

    fn refined(
        &self,
        steps: &[Steps],
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        let print = self.print.as_ref();
        let mut found = self.search(steps, print, views, world_from_obj, sigma)?;
        if !found.accepted {
            found.fit = self.fit(&mut found.working, world_from_obj)?;
        }
        Some(Refined {
            world_from_obj: found.world_from_obj,
            sigma: match found.accepted {
                true => self.expected(&found).unwrap_or(sigma),
                false => sigma,
            },
            information: found.information,
            supported: found.fit.supported(),
            residual_px: found.fit.residual_px(),
            quality: self.quality_of(&found.working, &found.fit, &found.world_from_obj),
            accepted: found.accepted,
        })
    }

    /// Like [`Self::refine`], on close-ups no sharper than the images: quicker, and exact enough to
    /// compare what views tell.
    pub fn refine_coarsely(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Coarse> {
        let found = self.search(&COARSE_STEPS, None, views, world_from_obj, sigma)?;
        Some(Coarse {
            world_from_obj: found.world_from_obj,
            information: found.information,
            supported: found.fit.supported(),
        })
    }

    fn search(
        &self,
        steps: &[Steps],
        print: Option<&Print>,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Search> {
        let prior = Prior::new(*world_from_obj, sigma);
        let (mut pose, mut information) = (*world_from_obj, Matrix6::zeros());
        let mut working = Vec::new();
        for &(detail, steps) in steps {
            working = self.working(views, &pose, detail);
            if working.is_empty() {
                return None;
            }
            for &step in steps {
                (pose, information) = self.stepped(&mut working, &prior, &pose, step)?;
            }
        }
        if let Some(print) = print {
            for view in &mut working {
                view.draw(self, &pose);
            }
            if let Some(turned) = print.turned(&working, &pose) {
                pose = turned;
                information += print.information(&pose);
            }
        }
        let before = self.fit(&mut working, world_from_obj)?;
        let after = self.fit(&mut working, &pose);
        let after = after.filter(|after| after.is_better(&before));
        let accepted = after.is_some();
        let (world_from_obj, fit) = match after {
            Some(after) => (pose, after),
            None => (*world_from_obj, before),
        };
        Some(Search {
            world_from_obj,
            information,
            fit,
            accepted,
            working,
        })
    }

    /// The pose after one step, and what the images and the prior tell of it.
    fn stepped(
        &self,
        working: &mut [Working],
        prior: &Prior,
        pose: &Isometry3<f64>,
        step: f64,
    ) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
        working
            .par_iter_mut()
            .for_each(|view| view.look(self, pose, step));
        let rows: Vec<&[Row]> = working.iter().map(|view| &view.rows[..]).collect();
        let center = &self.part.center;
        let (radius, scale) = (self.diameter / 4.0, 1.0 + 1.5 * step);
        let found = solve::step(&rows, prior, pose, center, radius, scale)?;
        let pose = solve::moved(pose, center, &found.motion);
        Some((pose, found.information))
    }

    /// How well the images show the object at a pose; `None` where no view shows its edges.
    pub fn quality(&self, views: &[View], world_from_obj: &Isometry3<f64>) -> Option<Quality> {
        let mut working = self.working(views, world_from_obj, FINE);
        let fit = self.fit(&mut working, world_from_obj)?;
        Some(self.quality_of(&working, &fit, world_from_obj))
    }

    /// Where a view should show edges of the mesh at a pose, and whether it does; empty where the
    /// object does not lie in its image.
    pub fn edges(&self, view: &View, world_from_obj: &Isometry3<f64>) -> Vec<Edge> {
        let Some(mut working) = Working::new(self, 0, view, world_from_obj, FINE) else {
            return Vec::new();
        };
        working.look(self, world_from_obj, 1.0);
        let world_from_cam = working.closeup.camera.world_from_cam();
        let edge = |point: &EdgePoint| Edge {
            point: world_from_cam * point.point,
            supported: working
                .found(self, point, 1.0)
                .is_some_and(|found| fit::is_supported(found.offset, found.variance)),
        };
        working.points.iter().map(edge).collect()
    }

    /// The expected errors of a pose, by its inverse covariance.
    ///
    /// The network says one number for turns about any axis, though mostly one axis is what it does
    /// not know; so the least known axis counts for all of them.
    fn expected(&self, found: &Search) -> Option<Sigma> {
        let covariance = found.information.cholesky()?.inverse();
        let obj_from_world = found.world_from_obj.rotation.to_rotation_matrix().inverse();
        let turns = covariance.fixed_view::<3, 3>(0, 0);
        let turns = obj_from_world.matrix() * turns * obj_from_world.matrix().transpose();
        let turns = self.symmetry.covariance_of_errors(&turns);
        let shifts = covariance.fixed_view::<3, 3>(3, 3).trace();
        let widest = turns.symmetric_eigenvalues().max();
        Some(Sigma {
            rot_deg: (widest.sqrt() * ANGLE_PER_AXIS).to_degrees().min(180.0),
            t_m: (shifts / 3.0).sqrt(),
        })
    }

    fn working(&self, views: &[View], pose: &Isometry3<f64>, detail: Detail) -> Vec<Working> {
        let views = views.par_iter().enumerate();
        views
            .filter_map(|(index, view)| Working::new(self, index, view, pose, detail))
            .collect()
    }
}

#[cfg(test)]
pub(crate) mod tests;
