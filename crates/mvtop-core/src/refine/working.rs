//! A view at work: what it shows of the object, and what the mesh at a pose says it should.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3};

use super::contour::{self, EdgePoint};
use super::picture::Picture;
use super::raster::Raster;
use super::region::{self, Colors, Found};
use super::solve::{self, Row};
use super::{Refiner, View};
use crate::closeup::{CloseUp, FILL};
use crate::{BBox, Camera};

/// Close-ups as sharp as the images, to come near.
pub const COARSE: Detail = Detail {
    enlarged: 1.0,
    largest: 224.0,
    filled: FILL,
};
/// Twice as sharp, as regions are told by whole pixels: half of one, next to a knob, is a degree.
pub const FINE: Detail = Detail {
    enlarged: 2.0,
    largest: 320.0,
    filled: 0.8,
};
/// Least side of a close-up, px.
const SMALLEST: f64 = 96.0;

/// How large the close-ups are.
#[derive(Debug, Clone, Copy)]
pub struct Detail {
    /// Px of the close-up in one of the image, if there is room for them.
    enlarged: f64,
    /// Largest side, px.
    largest: f64,
    /// What the object takes of it.
    filled: f64,
}

/// A view at work; its memory is used again from step to step.
#[derive(Clone)]
pub struct Working {
    /// Index of the view, as given.
    pub index: usize,
    /// Px of the close-up in one of the image.
    pub scale: f64,
    pub closeup: CloseUp,
    pub picture: Arc<Picture>,
    pub raster: Raster,
    pub points: Vec<EdgePoint>,
    pub colors: Colors,
    pub rows: Vec<Row>,
}

impl Working {
    /// `None` where the object does not lie in the image.
    pub fn new(
        refiner: &Refiner,
        index: usize,
        view: &View,
        pose: &Isometry3<f64>,
        detail: Detail,
    ) -> Option<Self> {
        let camera = view.camera;
        let bbox = around(&refiner.part.vertices, camera, pose)?;
        bbox.clip(camera.width(), camera.height())?;
        let size = bbox.width().max(bbox.height());
        let side = detail.enlarged * size / detail.filled;
        let side = side.clamp(SMALLEST, detail.largest) as u32;
        let closeup = CloseUp::new(camera, bbox.scaled(FILL / detail.filled), side)?;
        let pixels = closeup.pixels(camera, view.image);
        Some(Self {
            index,
            scale: f64::from(side) * detail.filled / size,
            picture: Arc::new(Picture::new(side as usize, pixels)),
            closeup,
            raster: Raster::default(),
            points: Vec::new(),
            colors: Colors::default(),
            rows: Vec::new(),
        })
    }

    /// Draws the mesh at this pose; `false` where a part of it is not before the camera.
    pub fn draw(&mut self, refiner: &Refiner, pose: &Isometry3<f64>) -> bool {
        let camera = &self.closeup.camera;
        let cam_from_obj = camera.world_from_cam().inv_mul(pose);
        let (pinhole, size) = (camera.intrinsics(), camera.width() as usize);
        self.raster
            .draw(&refiner.part, &cam_from_obj, pinhole, size)
    }

    /// Finds the edges of the object, as it lies at this pose.
    pub fn look(&mut self, refiner: &Refiner, pose: &Isometry3<f64>, step: f64) {
        self.rows.clear();
        self.points.clear();
        if !self.draw(refiner, pose) {
            return;
        }
        let (part, camera) = (&refiner.part, &self.closeup.camera);
        let (world_from_cam, pinhole) = (camera.world_from_cam(), camera.intrinsics());
        contour::points(part, &self.raster, refiner.diameter, &mut self.points);
        self.colors
            .count(&self.picture, &self.raster, &self.points, part.tints.len());
        let center = pose * part.center;
        for at in 0..self.points.len() {
            let Some(found) = self.found(refiner, &self.points[at], step) else {
                continue;
            };
            let EdgePoint { point, normal, .. } = &self.points[at];
            self.rows.push(Row {
                by_pose: solve::by_pose(world_from_cam, pinhole.fx(), point, normal, &center),
                offset: found.offset,
                variance: found.variance,
            });
        }
    }

    /// Where the image shows the edge of a point.
    pub fn found(&self, refiner: &Refiner, point: &EdgePoint, step: f64) -> Option<Found> {
        let tints = &refiner.part.tints;
        region::find(
            &self.picture,
            &self.colors,
            &self.raster,
            point,
            step,
            tints,
        )
    }
}

/// The box around all vertices in a camera's image; `None` where one cannot be imaged, or there is none.
pub fn around(vertices: &[Point3<f64>], camera: &Camera, pose: &Isometry3<f64>) -> Option<BBox> {
    let cam_from_obj = camera.world_from_cam().inv_mul(pose);
    let pixel = |vertex: &Point3<f64>| camera.intrinsics().project(&(cam_from_obj * vertex));
    BBox::around(vertices.iter().map(pixel))
}
