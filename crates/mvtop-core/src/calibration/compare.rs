//! What is wrong with a rig, by where its cameras stand as their images show it.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use super::{Found, Observed};
use crate::bundle::Class;
use crate::consistency::{Sight, agreement};
use crate::pose::rotation_error_deg;
use crate::{Camera, Rig};

/// A camera is off where it shows the objects this far from where the others expect them, px in images
/// of a thousand pixels' width: more than contours are off with a rig that is right.
const MOST_PX: f64 = 4.0;
/// Another reading explains a rig where it brings its cameras to within this of the images' rig, as a
/// share of the distance to the objects.
const EXPLAINED: f64 = 0.1;
/// Scales nearer to 1 than this are no other unit.
const SCALED: f64 = 0.02;

/// How two cameras' boxes of the same objects agree, by the rig as it is.
#[derive(Debug, Clone, PartialEq)]
pub struct PairResidual {
    /// Indices of the cameras.
    pub cameras: [usize; 2],
    /// Objects that both show.
    pub objects: usize,
    /// By how much their lines of sight miss each other: root mean square over objects and both
    /// images, px; infinite where the lines of sight of an object meet nowhere before both.
    pub px: f64,
    /// Median of sizes by the distance at which lines of sight meet, over those in the images: 1 where
    /// the unit is right; `None` where they meet nowhere.
    pub size: Option<f64>,
}

/// A camera that does not stand where the images show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Off {
    /// Its index.
    pub camera: usize,
    /// How far from where the other cameras expect them it shows the objects: root mean square, px.
    pub px: f64,
    /// From where it stands to where the images show it, in its own axes, metres.
    pub cam_from_shown: Isometry3<f64>,
}

/// Another meaning of all poses, by which they would fit the images.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Reading {
    /// They map the world to the camera.
    Inverse,
    /// They are in OpenGL's axes, y up and z backward.
    OpenGl,
    /// Both.
    InverseOpenGl,
    /// Translations are this many times too long.
    Scaled(f64),
}

/// What is wrong with a rig, if anything.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Every two cameras that show an object.
    pub pairs: Vec<PairResidual>,
    /// Cameras that are off, against the greatest number that agree with each other.
    pub off: Vec<Off>,
    /// Whether more cameras agree with each other than in any other way: of two cameras, either may be
    /// the wrong one.
    pub is_told: bool,
    /// What would explain most of it.
    pub reading: Option<Reading>,
}

impl Observed {
    /// Compares a rig of the same cameras with what the images show.
    ///
    /// - `classes`: of the bundle by which it was observed
    pub fn compare(&self, classes: &[Class], rig: &Rig) -> Comparison {
        let told: Vec<usize> = (0..rig.cameras().len())
            .filter(|&i| i == self.rig.reference() || self.sigmas[i].is_some())
            .collect();
        let poses: Vec<Isometry3<f64>> =
            rig.cameras().iter().map(|c| *c.world_from_cam()).collect();
        let (off, is_told) = self.off(classes, &told, &poses);
        Comparison {
            pairs: self.pairs(classes, rig),
            reading: (!off.is_empty())
                .then(|| self.reading(&told, &poses))
                .flatten(),
            is_told,
            off,
        }
    }

    /// How boxes of every two cameras agree by a rig.
    pub fn pairs(&self, classes: &[Class], rig: &Rig) -> Vec<PairResidual> {
        let count = rig.cameras().len();
        let mut pairs = Vec::new();
        for (a, b) in (1..count).flat_map(|b| (0..b).map(move |a| (a, b))) {
            let both = |found: &&Found| {
                let has = |camera| found.boxes.iter().any(|(index, _)| *index == camera);
                has(a) && has(b)
            };
            let residuals: Vec<Option<[f64; 2]>> = self
                .objects
                .iter()
                .filter(both)
                .map(|found| self.residual(classes, rig, found, [a, b]))
                .collect();
            if residuals.is_empty() {
                continue;
            }
            let objects = residuals.len();
            let squares = residuals
                .iter()
                .map(|r| r.map_or(f64::INFINITY, |[px, _]| px * px));
            let px = (squares.sum::<f64>() / objects as f64).sqrt();
            let mut sizes: Vec<f64> = residuals.iter().flatten().map(|[_, size]| *size).collect();
            sizes.sort_by(f64::total_cmp);
            pairs.push(PairResidual {
                cameras: [a, b],
                objects,
                px,
                size: sizes.get(sizes.len() / 2).copied(),
            });
        }
        pairs
    }

    /// Root mean square miss in two images, px, and size over that in the images.
    fn residual(
        &self,
        classes: &[Class],
        rig: &Rig,
        found: &Found,
        pair: [usize; 2],
    ) -> Option<[f64; 2]> {
        let points = &classes[found.class].points;
        let sights: Vec<Sight> = pair
            .iter()
            .filter_map(|camera| {
                let (_, bbox) = found.boxes.iter().find(|(index, _)| index == camera)?;
                let camera = &rig.cameras()[*camera];
                Some(Sight {
                    camera,
                    bbox: *bbox,
                })
            })
            .collect();
        // As seen from the first of the two.
        let [shown, given] = [&self.rig, rig].map(|rig| rig.cameras()[pair[0]].world_from_cam());
        let pose = given * shown.inv_mul(&found.world_from_obj);
        let nearest = agreement(points, &sights, &pose)?.nearest;
        let squares: f64 = nearest.iter().map(|r| r.offset.norm_squared()).sum();
        let size: f64 = nearest.iter().map(|r| r.log_size).sum();
        let count = nearest.len() as f64;
        Some([(squares / count).sqrt(), (size / count).exp()])
    }

    /// Cameras that do not agree with the greatest number that do, and whether there is one such number.
    fn off(&self, classes: &[Class], told: &[usize], poses: &[Isometry3<f64>]) -> (Vec<Off>, bool) {
        let shown: Vec<Isometry3<f64>> = self
            .rig
            .cameras()
            .iter()
            .map(|c| *c.world_from_cam())
            .collect();
        // By each camera, as if it stood right: what the others are off.
        let by_each = told.iter().map(|&anchor| {
            let given_from_shown = poses[anchor] * shown[anchor].inverse();
            let off: Vec<Off> = told
                .iter()
                .filter(|&&camera| camera != anchor)
                .filter_map(|&camera| {
                    let should = given_from_shown * shown[camera];
                    let cam_from_shown = poses[camera].inv_mul(&should);
                    let shown_camera = &self.rig.cameras()[camera];
                    let px = self.moved_px(classes, shown_camera, camera, &cam_from_shown)?;
                    let most = MOST_PX * f64::from(shown_camera.width()) / 1000.0;
                    (!(px <= most)).then_some(Off {
                        camera,
                        px,
                        cam_from_shown,
                    })
                })
                .collect();
            off
        });
        let all: Vec<Vec<Off>> = by_each.collect();
        let fewest = all.iter().map(Vec::len).min().unwrap_or(0);
        let total = |off: &[Off]| off.iter().map(|one| one.px).sum::<f64>();
        let best = all.iter().filter(|off| off.len() == fewest);
        let best = best.min_by(|a, b| total(a).total_cmp(&total(b)));
        let best = best.cloned().unwrap_or_default();
        let cameras = |off: &[Off]| off.iter().map(|one| one.camera).collect::<Vec<_>>();
        // Those that agree with each other all say the same.
        let mut others = all.iter().filter(|off| off.len() == fewest);
        let same = others.all(|off| cameras(off) == cameras(&best));
        (best, same)
    }

    /// How far a camera shows the objects from where they are by another place of it, px.
    fn moved_px(
        &self,
        classes: &[Class],
        camera: &Camera,
        index: usize,
        cam_from_shown: &Isometry3<f64>,
    ) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0.0);
        for found in &self.objects {
            if !found.boxes.iter().any(|(camera, _)| *camera == index) {
                continue;
            }
            let shown_from_obj = camera.world_from_cam().inv_mul(&found.world_from_obj);
            for point in classes[found.class].points.iter().step_by(16) {
                let in_shown = shown_from_obj * Point3::from(point.position);
                let pixel = camera.intrinsics().project(&in_shown)?;
                let moved = camera.intrinsics().project(&(cam_from_shown * in_shown));
                sum += moved.map_or(f64::INFINITY, |moved| (moved - pixel).norm_squared());
                count += 1.0;
            }
        }
        (count > 0.0).then(|| f64::sqrt(sum / count))
    }

    /// The reading of the given poses that fits the images' rig, if one does.
    fn reading(&self, told: &[usize], poses: &[Isometry3<f64>]) -> Option<Reading> {
        let shown: Vec<Isometry3<f64>> = told
            .iter()
            .map(|&i| *self.rig.cameras()[i].world_from_cam())
            .collect();
        let given: Vec<Isometry3<f64>> = told.iter().map(|&i| poses[i]).collect();
        // How far they are to the objects.
        let places = self
            .objects
            .iter()
            .map(|found| found.world_from_obj.translation.vector);
        let middle = places.sum::<Vector3<f64>>() / self.objects.len().max(1) as f64;
        let away = shown
            .iter()
            .map(|pose| (pose.translation.vector - middle).norm());
        let away = away.sum::<f64>() / shown.len().max(1) as f64;
        let flip = Isometry3::rotation(Vector3::x() * PI);
        let read = |reading: &Reading| -> Vec<Isometry3<f64>> {
            let one = |pose: &Isometry3<f64>| match reading {
                Reading::Inverse => pose.inverse(),
                Reading::OpenGl => pose * flip,
                Reading::InverseOpenGl => pose.inverse() * flip,
                Reading::Scaled(scale) => {
                    let place = pose.translation.vector / *scale;
                    Isometry3::from_parts(Translation3::from(place), pose.rotation)
                }
            };
            given.iter().map(one).collect()
        };
        let mut readings = vec![Reading::Inverse, Reading::OpenGl, Reading::InverseOpenGl];
        readings.extend(scale(&given, &shown).map(Reading::Scaled));
        let now = apart(&given, &shown, away);
        let judged = readings
            .into_iter()
            .map(|reading| (apart(&read(&reading), &shown, away), reading));
        let best = judged.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 < EXPLAINED && best.0 < now / 3.0).then_some(best.1)
    }
}

/// By how many times baselines are too long.
fn scale(given: &[Isometry3<f64>], shown: &[Isometry3<f64>]) -> Option<f64> {
    let [given, shown] = [given, shown].map(|poses| {
        let place = |pose: &Isometry3<f64>| pose.translation.vector;
        let first = place(poses.first()?);
        Some(
            poses
                .iter()
                .map(|pose| (place(pose) - first).norm())
                .sum::<f64>(),
        )
    });
    let scale = given? / shown?;
    (scale.is_finite() && scale > 0.0 && (scale - 1.0).abs() > SCALED).then_some(scale)
}

/// How differently cameras stand to each other: greatest turn, radians, or move as a share of the
/// distance.
fn apart(a: &[Isometry3<f64>], b: &[Isometry3<f64>], distance: f64) -> f64 {
    let mut most: f64 = 0.0;
    for i in 0..a.len() {
        for j in 0..i {
            let [a, b] = [a, b].map(|poses| poses[i].inv_mul(&poses[j]));
            let turned = rotation_error_deg(&a.rotation, &b.rotation).to_radians();
            let moved = (a.translation.vector - b.translation.vector).norm() / distance;
            most = most.max(turned).max(moved);
        }
    }
    most
}
