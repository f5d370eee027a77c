//! State of one view during refinement: its crop, the rendered mesh and the correspondence lines.

use nalgebra::{Isometry3, Point3};

use super::color_histograms::{ColorHistograms, background_bins};
use super::config::Stage;
use super::contour::{EdgePoint, sample_edges};
use super::crop_pixels::{CropPixels, UNKNOWN};
use super::gauss_newton::{self, Residual};
use super::mesh_model::BACKGROUND;
use super::raster::Raster;
use super::{Refiner, View};
use crate::closeup::{CloseUp, FILL};
use crate::{BBox, Camera};

/// State of one view. Its memory is reused from iteration to iteration.
pub struct ViewState<'a> {
    pub refiner: &'a Refiner,
    /// Index of the view, as given.
    pub index: usize,
    /// Px of the crop per px of the image.
    pub scale: f64,
    /// The box of the mesh for which the crop was made, px of the image.
    bbox: BBox,
    pub closeup: CloseUp,
    pub pixels: CropPixels,
    pub raster: Raster,
    pub points: Vec<EdgePoint>,
    pub histograms: ColorHistograms,
    pub residuals: Vec<Residual>,
    /// The pose that `raster` shows, and whether all of the mesh is in front of the camera.
    rendered: Option<(Isometry3<f64>, bool)>,
    /// The pose whose edges `points` are, and to which `histograms` belong.
    sampled: Option<Isometry3<f64>>,
}

impl<'a> ViewState<'a> {
    /// `None` if the object does not lie in the image.
    pub fn new(
        refiner: &'a Refiner,
        index: usize,
        view: &View,
        pose: &Isometry3<f64>,
        stage: &Stage,
    ) -> Option<Self> {
        let camera = view.camera;
        let bbox = projected_box(&refiner.mesh.vertices, camera, pose)?;
        bbox.clip(camera.width(), camera.height())?;
        let size = bbox.width().max(bbox.height());
        let [least, most] = stage.side_px;
        let side = (stage.scale * size / stage.fill).clamp(least, most) as u32;
        let closeup = CloseUp::new(camera, bbox.scaled(FILL / stage.fill), side)?;
        let pixels = closeup.pixels(camera, view.image);
        Some(Self {
            refiner,
            index,
            scale: f64::from(side) * stage.fill / size,
            bbox,
            pixels: CropPixels::new(side as usize, pixels),
            closeup,
            raster: Raster::default(),
            points: Vec::new(),
            histograms: ColorHistograms::default(),
            residuals: Vec::new(),
            rendered: None,
            sampled: None,
        })
    }

    /// Whether the crop would be nearly the same for another pose.
    pub fn holds(&self, camera: &Camera, pose: &Isometry3<f64>) -> bool {
        const SAME: f64 = 0.7;
        let bbox = projected_box(&self.refiner.mesh.vertices, camera, pose);
        bbox.is_some_and(|bbox| bbox.iou(&self.bbox) > SAME)
    }

    /// Renders the mesh at a pose; `false` if a part of it is not in front of the camera.
    pub fn render(&mut self, pose: &Isometry3<f64>) -> bool {
        if let Some((known, complete)) = &self.rendered
            && known == pose
        {
            return *complete;
        }
        let (mesh, camera) = (&self.refiner.mesh, &self.closeup.camera);
        let complete = self.raster.render(mesh, camera, pose);
        self.rendered = Some((*pose, complete));
        complete
    }

    /// Renders the mesh at a pose and searches for its edges.
    ///
    /// - `step`: px between the samples of a correspondence line
    pub fn update(&mut self, pose: &Isometry3<f64>, step: f64) {
        self.residuals.clear();
        if self.sampled != Some(*pose) && !self.sample(pose) {
            return;
        }
        let (camera, center) = (&self.closeup.camera, pose * self.refiner.mesh.center);
        let (world_from_cam, focal) = (camera.world_from_cam(), camera.intrinsics().fx());
        let residual = |edge: &EdgePoint| {
            let EdgePoint { point, normal, .. } = edge;
            Some(Residual {
                edge: self.match_edge(edge, step)?,
                jacobian: gauss_newton::jacobian(world_from_cam, focal, point, normal, &center),
            })
        };
        self.residuals = self.points.iter().filter_map(residual).collect();
    }

    /// Renders the mesh at a pose, samples its edges and counts the colors beside them; `false` if a part
    /// of it is not in front of the camera.
    fn sample(&mut self, pose: &Isometry3<f64>) -> bool {
        self.points.clear();
        self.sampled = None;
        if !self.render(pose) {
            return false;
        }
        let Refiner {
            mesh,
            config,
            diameter,
            ..
        } = self.refiner;
        sample_edges(mesh, &self.raster, *diameter, config, &mut self.points);
        let (pixels, raster) = (&self.pixels, &self.raster);
        let background = background_bins(pixels, raster, &self.points, config.background_band_px);
        self.histograms
            .count(pixels, raster, mesh.chromaticities.len(), background);
        self.sampled = Some(*pose);
        true
    }

    /// Share of inliers among the contour points.
    pub fn contour_inliers(&self) -> f64 {
        let limits = self.refiner.config.inlier_px;
        let inliers = self.residuals.iter();
        let inliers = inliers.filter(|one| one.edge.is_inlier(limits));
        inliers.count() as f64 / self.residuals.len().max(1) as f64
    }

    /// Mean distance of the edges from their projections, px of the crop.
    pub fn contour_residual_px(&self) -> f64 {
        let distances = self.residuals.iter().map(|one| one.edge.displacement.abs());
        distances.sum::<f64>() / self.residuals.len().max(1) as f64
    }

    /// Share of the silhouette's area in the crop that lies inside the image; 0 without any.
    pub fn visible_share(&self) -> f64 {
        let silhouette = self.raster.labels().iter().zip(&self.pixels.bins);
        let silhouette = silhouette.filter(|(label, _)| **label != BACKGROUND);
        let (known, all) = silhouette.fold((0.0, 0.0), |(known, all), (_, bin)| {
            (known + if *bin == UNKNOWN { 0.0 } else { 1.0 }, all + 1.0)
        });
        known / f64::max(all, 1.0)
    }
}

/// The box around all vertices in a camera's image; `None` if one cannot be projected, or without any.
pub fn projected_box(
    vertices: &[Point3<f64>],
    camera: &Camera,
    pose: &Isometry3<f64>,
) -> Option<BBox> {
    let cam_from_obj = camera.world_from_cam().inv_mul(pose);
    let pixel = |vertex: &Point3<f64>| camera.intrinsics().project(&(cam_from_obj * vertex));
    BBox::around(vertices.iter().map(pixel))
}
