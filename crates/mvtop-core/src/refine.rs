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

mod contour;
mod difference;
mod explained;
pub(crate) mod lines;
mod part;
mod print;
mod quality;
mod raster;
mod region;
pub(crate) mod solve;

use image::RgbImage;
use nalgebra::{Isometry3, Matrix6, Point3};
use rayon::prelude::*;

use self::contour::EdgePoint;
use self::part::Part;
use self::print::Print;
pub use self::quality::{Quality, ViewQuality};
use self::raster::Raster;
use self::region::{Colors, Found, Picture};
use self::solve::{ANGLE_PER_AXIS, Prior, Row};
use crate::bundle::SurfacePoint;
use crate::closeup::{CloseUp, FILL};
use crate::mesh::Mesh;
use crate::prediction::Sigma;
use crate::{BBox, Camera};

/// Close-ups as sharp as the images, to come near.
const COARSE: Detail = Detail {
    enlarged: 1.0,
    largest: 224.0,
    filled: FILL,
};
/// Twice as sharp, as regions are told by whole pixels: half of one, next to a knob, is a degree.
const FINE: Detail = Detail {
    enlarged: 2.0,
    largest: 320.0,
    filled: 0.8,
};
/// Steps of the lines, px of the close-up, one after the other.
const STEPS: [Steps; 2] = [
    (COARSE, &[4.0, 3.0, 2.0]),
    (FINE, &[2.0, 1.5, 1.0, 1.0, 1.0]),
];
/// Steps that end on the coarse close-ups.
const COARSE_STEPS: [Steps; 1] = [(COARSE, &[4.0, 4.0, 3.0, 2.0, 1.0, 1.0, 1.0])];
/// Least side of a close-up, px.
const SMALLEST: f64 = 96.0;
/// An edge that is found within this of where it is expected is supported, px.
const SUPPORTED: f64 = 1.5;
/// An edge is not supported where its place is less certain than this, px².
const UNSURE: f64 = 4.0;
/// Step at which poses are compared, px.
const COMPARED: f64 = 1.5;

/// How much worse one kind of edges may fit where another fits better, bits.
const WORSE: f64 = 0.05;

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

/// What refines poses of one object.
pub struct Refiner {
    part: Part,
    diameter: f64,
    print: Option<Print>,
}

/// How large the close-ups are.
#[derive(Debug, Clone, Copy)]
struct Detail {
    /// Px of the close-up in one of the image, if there is room for them.
    enlarged: f64,
    /// Largest side, px.
    largest: f64,
    /// What the object takes of it.
    filled: f64,
}

/// Close-ups, and the steps of the lines on them, px.
type Steps = (Detail, &'static [f64]);

/// A view at work; its memory is used again from step to step.
struct Working {
    /// Index of the view, as given.
    index: usize,
    /// Px of the close-up in one of the image.
    scale: f64,
    closeup: CloseUp,
    picture: Picture,
    raster: Raster,
    points: Vec<EdgePoint>,
    colors: Colors,
    rows: Vec<Row>,
}

/// How well the images fit a pose.
#[derive(Debug, Clone, Default)]
struct Fit {
    /// Of all views, bits: by the outline, and by what lies within it.
    separation: [f64; 2],
    supported: f64,
    residual_px: f64,
    quality: Quality,
}

/// Of a view: its quality, and the mean distance of its edges, px of the close-up.
type ViewFit = (ViewQuality, f64);

impl Refiner {
    /// - `diameter_m`: largest distance between two points of the surface
    pub fn new(mesh: &Mesh, diameter_m: f64) -> Self {
        Self {
            part: Part::new(mesh),
            diameter: diameter_m,
            print: None,
        }
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
        let print = self.print.as_ref();
        self.refine_by(&STEPS, print, views, world_from_obj, sigma)
    }

    /// Like [`Self::refine`], on close-ups no sharper than the images: quicker, and exact enough to
    /// compare what views tell.
    pub fn refine_coarsely(
        &self,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        self.refine_by(&COARSE_STEPS, None, views, world_from_obj, sigma)
    }

    fn refine_by(
        &self,
        steps: &[Steps],
        print: Option<&Print>,
        views: &[View],
        world_from_obj: &Isometry3<f64>,
        sigma: Sigma,
    ) -> Option<Refined> {
        let prior = Prior::new(*world_from_obj, sigma);
        let (mut pose, mut information) = (*world_from_obj, Matrix6::zeros());
        let mut working = Vec::new();
        for &(detail, steps) in steps {
            working = self.working(views, &pose, detail);
            if working.is_empty() {
                return None;
            }
            for &step in steps {
                working
                    .par_iter_mut()
                    .for_each(|view| view.look(self, &pose, step));
                let rows: Vec<&[Row]> = working.iter().map(|view| &view.rows[..]).collect();
                let center = &self.part.center;
                let (radius, scale) = (self.diameter / 4.0, 1.0 + 1.5 * step);
                let found = solve::step(&rows, &prior, &pose, center, radius, scale)?;
                pose = solve::moved(&pose, center, &found.motion);
                information = found.information;
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
        let after = self.fit(&mut working, &pose).unwrap_or_default();
        // What lies within may not be given up for the outline, nor the other way round.
        let better = |i: usize| after.separation[i] - before.separation[i];
        let accepted = better(0) + better(1) > 0.0 && better(0).min(better(1)) > -WORSE;
        let (pose, fit) = if accepted {
            (pose, after)
        } else {
            (*world_from_obj, before)
        };
        Some(Refined {
            world_from_obj: pose,
            sigma: if accepted {
                expected(&information).unwrap_or(sigma)
            } else {
                sigma
            },
            information,
            supported: fit.supported,
            residual_px: fit.residual_px,
            quality: fit.quality,
            accepted,
        })
    }

    /// How well the images show the object at a pose; `None` where no view shows its edges.
    pub fn quality(&self, views: &[View], world_from_obj: &Isometry3<f64>) -> Option<Quality> {
        let mut working = self.working(views, world_from_obj, FINE);
        Some(self.fit(&mut working, world_from_obj)?.quality)
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
                .is_some_and(|found| is_supported(found.offset, found.variance)),
        };
        working.points.iter().map(edge).collect()
    }

    fn working(&self, views: &[View], pose: &Isometry3<f64>, detail: Detail) -> Vec<Working> {
        let views = views.par_iter().enumerate();
        views
            .filter_map(|(index, view)| Working::new(self, index, view, pose, detail))
            .collect()
    }

    /// How well the images fit a pose; `None` where no edge can be seen.
    fn fit(&self, working: &mut [Working], pose: &Isometry3<f64>) -> Option<Fit> {
        let tints = &self.part.tints;
        let fits: Vec<(ViewFit, [Option<f64>; 2])> = working
            .par_iter_mut()
            .map(|view| {
                view.look(self, pose, 1.0);
                let Working {
                    picture,
                    colors,
                    raster,
                    points,
                    rows,
                    ..
                } = &*view;
                let count = rows.len().max(1) as f64;
                let near = |row: &&Row| is_supported(row.offset, row.variance);
                let supported = rows.iter().filter(near).count() as f64 / count;
                let residual = rows.iter().map(|row| row.offset.abs()).sum::<f64>() / count;
                let bits = region::separation(picture, colors, raster, points, COMPARED, tints);
                let overlap = region::overlap(picture, colors, raster, points).unwrap_or(0.0);
                let of_view = ViewQuality {
                    view: view.index,
                    supported,
                    residual_px: residual / view.scale,
                    overlap,
                    explained: explained::explained(picture, colors, raster, points, tints),
                };
                ((of_view, residual), bits)
            })
            .collect();
        let shown: Vec<ViewFit> = fits
            .iter()
            .filter(|(_, bits)| bits[0].is_some())
            .map(|(fit, _)| *fit)
            .collect();
        let count = shown.len() as f64;
        (count > 0.0).then(|| Fit {
            separation: [0, 1].map(|i| {
                let known = || fits.iter().filter_map(|(_, bits)| bits[i]);
                known().sum::<f64>() / known().count().max(1) as f64
            }),
            supported: shown.iter().map(|(view, _)| view.supported).sum::<f64>() / count,
            residual_px: shown.iter().map(|(_, residual)| residual).sum::<f64>() / count,
            quality: Quality {
                views: shown.iter().map(|(view, _)| *view).collect(),
            },
        })
    }
}

impl Working {
    /// `None` where the object does not lie in the image.
    fn new(
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
            picture: Picture::new(side as usize, pixels),
            closeup,
            raster: Raster::default(),
            points: Vec::new(),
            colors: Colors::default(),
            rows: Vec::new(),
        })
    }

    /// Draws the mesh at this pose; `false` where a part of it is not before the camera.
    fn draw(&mut self, refiner: &Refiner, pose: &Isometry3<f64>) -> bool {
        let camera = &self.closeup.camera;
        let cam_from_obj = camera.world_from_cam().inv_mul(pose);
        let (pinhole, size) = (camera.intrinsics(), camera.width() as usize);
        self.raster
            .draw(&refiner.part, &cam_from_obj, pinhole, size)
    }

    /// Finds the edges of the object, as it lies at this pose.
    fn look(&mut self, refiner: &Refiner, pose: &Isometry3<f64>, step: f64) {
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
    fn found(&self, refiner: &Refiner, point: &EdgePoint, step: f64) -> Option<Found> {
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

/// Whether an edge that was found so far off and so exactly, px and px², is where it should be.
fn is_supported(offset: f64, variance: f64) -> bool {
    offset.abs() < SUPPORTED && variance < UNSURE
}

/// The box around all vertices in a camera's image; `None` where one cannot be imaged.
fn around(vertices: &[Point3<f64>], camera: &Camera, pose: &Isometry3<f64>) -> Option<BBox> {
    let cam_from_obj = camera.world_from_cam().inv_mul(pose);
    let mut around = [
        f64::INFINITY,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NEG_INFINITY,
    ];
    for vertex in vertices {
        let at = camera.intrinsics().project(&(cam_from_obj * vertex))?;
        around = [
            around[0].min(at.x),
            around[1].min(at.y),
            around[2].max(at.x),
            around[3].max(at.y),
        ];
    }
    Some(around.into())
}

/// The expected errors of a pose, by its inverse covariance.
///
/// The network says one number for turns about any axis, though mostly one axis is what it does not
/// know; so the least known axis counts for all of them.
fn expected(information: &Matrix6<f64>) -> Option<Sigma> {
    let covariance = information.cholesky()?.inverse();
    let turns = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let shifts = covariance.fixed_view::<3, 3>(3, 3).trace();
    let widest = turns.symmetric_eigenvalues().max();
    Some(Sigma {
        rot_deg: (widest.sqrt() * ANGLE_PER_AXIS).to_degrees(),
        t_m: (shifts / 3.0).sqrt(),
    })
}

#[cfg(test)]
pub(crate) mod tests;
