//! Region- and edge-based refinement of poses on all images at once.
//!
//! Each view is a crop through a virtual pinhole ([`crate::closeup`]). The mesh is rendered into it, and
//! its visible edges are sampled at contour points: the outline, creases, and borders of colors. A
//! correspondence line across each point is searched for the true edge. Color gradients and color
//! histograms of both sides locate it (as SRT3D does). Robust Gauss-Newton steps minimise the
//! displacements of all views, from coarse to fine, with the given pose as a Gaussian prior. The angle
//! of a round part about its axis is then found by its texture.

mod color_histograms;
mod config;
mod contour;
pub(crate) mod correspondence_lines;
mod crop_pixels;
mod depth_map;
mod difference;
mod edge_search;
mod fit_quality;
mod gauss_newton;
mod mesh_model;
mod mutual_information;
mod one_view;
mod raster;
mod revolution_axis;
mod texture;
mod view_quality;
mod view_state;

use nalgebra::{Isometry3, Matrix6, Point3};
use rayon::prelude::*;

pub use self::config::{RefineConfig, Stage, TextureConfig};
use self::contour::EdgePoint;
pub use self::depth_map::DepthMap;
use self::edge_search::{StepFunction, step_function};
use self::gauss_newton::{ANGLE_PER_AXIS, Prior, Residual, Step};
use self::mesh_model::MeshModel;
pub use self::one_view::ByOneView;
use self::texture::Texture;
pub use self::view_quality::{Quality, ViewQuality};
use self::view_state::ViewState;
use crate::Camera;
use crate::bundle::SurfacePoint;
use crate::image::Pyramid;
use crate::mesh::Mesh;
use crate::prediction::Sigma;
use crate::symmetry::Symmetry;

/// An image in which the object may be visible.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// With its true lens.
    pub camera: &'a Camera,
    /// Image of the camera.
    pub image: &'a Pyramid<'a>,
}

/// A contour point of the mesh that a camera should see.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// World frame, metres.
    pub point: Point3<f64>,
    /// Whether the image has an edge there, see [`RefineConfig::inlier_px`].
    pub is_inlier: bool,
}

/// A refined pose.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Object frame to world frame, metres; the start if the refinement was not accepted.
    pub world_from_obj: Isometry3<f64>,
    /// Expected error.
    pub sigma: Sigma,
    /// Share of inliers among the contour points, mean over views.
    pub contour_inliers: f64,
    /// Mean distance of the edges from their projections, px of the crops.
    pub contour_residual_px: f64,
    /// Evidence at this pose.
    pub quality: Quality,
    /// Whether the images fit it better than the start.
    pub accepted: bool,
}

/// Refinement of poses of one object.
pub struct Refiner {
    mesh: MeshModel,
    diameter: f64,
    config: RefineConfig,
    /// By [`RefineConfig::function_amplitude`].
    step_function: StepFunction,
    texture: Option<Texture>,
    symmetry: Symmetry,
}

impl Refiner {
    /// By the default configuration.
    ///
    /// - `diameter_m`: largest distance between two points of the surface
    pub fn new(mesh: &Mesh, diameter_m: f64) -> Self {
        Self::with_config(mesh, diameter_m, RefineConfig::default())
    }

    /// - `diameter_m`: largest distance between two points of the surface
    pub fn with_config(mesh: &Mesh, diameter_m: f64, config: RefineConfig) -> Self {
        Self {
            mesh: MeshModel::new(mesh, &config),
            diameter: diameter_m,
            step_function: step_function(config.function_amplitude),
            config,
            texture: None,
            symmetry: Symmetry::default(),
        }
    }

    /// Adds the symmetries of the object.
    pub fn with_symmetry(self, symmetry: Symmetry) -> Self {
        Self { symmetry, ..self }
    }

    /// Adds the texture of the object, if its colors vary.
    ///
    /// - `points`: colored, of its surface
    pub fn with_texture(self, points: &[SurfacePoint]) -> Self {
        let (center, config) = (self.mesh.center, &self.config.texture);
        Self {
            texture: Texture::new(points, center, self.diameter, config),
            ..self
        }
    }

    /// All numbers that steer the refinement.
    pub fn config(&self) -> &RefineConfig {
        &self.config
    }

    /// Middle of the mesh's box, the center of rotations: object frame, metres.
    pub fn center(&self) -> Point3<f64> {
        self.mesh.center
    }

    /// Largest distance between two points of the surface, metres.
    pub fn diameter_m(&self) -> f64 {
        self.diameter
    }

    /// The pose near `world_from_obj` that fits the images; `None` if no view shows the object.
    ///
    /// - `sigma`: expected error of the given pose
    pub fn refine(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        let RefineConfig { coarse, fine, .. } = &self.config;
        let prior = Prior::new(*world_from_obj, sigma);
        let mut states = self.view_states(views, world_from_obj, coarse);
        let (pose, _) = self.descended(&mut states, &prior, world_from_obj, &coarse.steps_px)?;
        let mut states = self.view_states(views, &pose, fine);
        let initial = self.fit(&mut states, world_from_obj)?;
        let (mut pose, mut information) =
            self.descended(&mut states, &prior, &pose, &fine.steps_px)?;
        if let Some(texture) = &self.texture {
            for view in &mut states {
                view.render(&pose);
            }
            if let Some((aligned, of_angle)) = texture.aligned(&states, &pose) {
                pose = aligned;
                information += of_angle;
            }
        }
        let margin = self.config.accept_margin_bits;
        let better = self.fit(&mut states, &pose);
        let better = better.filter(|fit| fit.is_better(&initial, margin));
        let accepted = better.is_some();
        let (pose, fit) = match better {
            Some(fit) => (pose, fit),
            // Once more, so that the states are those of the start.
            None => (*world_from_obj, self.fit(&mut states, world_from_obj)?),
        };
        Some(Refined {
            world_from_obj: pose,
            sigma: match accepted {
                true => self.expected_error(&pose, &information).unwrap_or(sigma),
                false => sigma,
            },
            contour_inliers: fit.contour_inliers,
            contour_residual_px: fit.contour_residual_px,
            quality: self.quality_of(&states, &fit, &pose),
            accepted,
        })
    }

    /// The pose after Gauss-Newton steps from `start`, and its inverse covariance. Once a step moves the
    /// edges by less than `converged_px`, the last one alone is left.
    fn descended(
        &self,
        states: &mut [ViewState],
        prior: &Prior,
        start: &Isometry3<f64>,
        steps_px: &[f64],
    ) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
        let (mut pose, mut information) = (*start, Matrix6::zeros());
        let last = steps_px.last()?;
        let mut left = steps_px;
        while let Some((step, rest)) = left.split_first() {
            let found = self.iterate(states, prior, &pose, *step)?;
            (pose, information) = (found.world_from_obj, found.information);
            let has_converged = found.moved_px < self.config.converged_px;
            left = match (has_converged, step == last) {
                (false, _) => rest,
                (true, false) => std::slice::from_ref(last),
                (true, true) => &[],
            };
        }
        Some((pose, information))
    }

    /// One Gauss-Newton step on all views.
    fn iterate(
        &self,
        states: &mut [ViewState],
        prior: &Prior,
        pose: &Isometry3<f64>,
        step: f64,
    ) -> Option<Step> {
        if states.is_empty() {
            return None;
        }
        let each = states.par_iter_mut();
        each.for_each(|view| view.update(pose, step));
        let residuals: Vec<&[Residual]> = states.iter().map(|view| &view.residuals[..]).collect();
        self.gauss_newton(&residuals, prior, pose, step)
    }

    /// Evidence for a pose; `None` if no view shows its outline.
    pub fn quality(&self, views: &[View], world_from_obj: &Isometry3<f64>) -> Option<Quality> {
        let mut states = self.view_states(views, world_from_obj, &self.config.fine);
        let fit = self.fit(&mut states, world_from_obj)?;
        Some(self.quality_of(&states, &fit, world_from_obj))
    }

    /// Visible contour points of the mesh at a pose; empty if the object does not lie in the image.
    pub fn edges(&self, view: &View, world_from_obj: &Isometry3<f64>) -> Vec<Edge> {
        let fine = &self.config.fine;
        let Some(mut state) = ViewState::new(self, 0, view, world_from_obj, fine) else {
            return Vec::new();
        };
        let step = self.config.final_step_px();
        state.update(world_from_obj, step);
        let world_from_cam = state.closeup.camera.world_from_cam();
        let edge = |point: &EdgePoint| Edge {
            point: world_from_cam * point.point,
            is_inlier: state
                .match_edge(point, step)
                .is_some_and(|found| found.is_inlier(self.config.inlier_px)),
        };
        state.points.iter().map(edge).collect()
    }

    /// Expected error of a pose by its inverse covariance.
    ///
    /// The network estimates one number for rotations about any axis, although mostly one axis is
    /// ambiguous; so the axis with the largest variance counts for all of them.
    fn expected_error(&self, pose: &Isometry3<f64>, information: &Matrix6<f64>) -> Option<Sigma> {
        let covariance = information.cholesky()?.inverse();
        let obj_from_world = pose.rotation.to_rotation_matrix().inverse();
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

    fn view_states(
        &self,
        views: &[View],
        pose: &Isometry3<f64>,
        stage: &Stage,
    ) -> Vec<ViewState<'_>> {
        let views = views.par_iter().enumerate();
        views
            .filter_map(|(index, view)| ViewState::new(self, index, view, pose, stage))
            .collect()
    }
}

#[cfg(test)]
pub(crate) mod tests;
