//! Which objects there are and where each view sees them: detected, or given by the user.

use nalgebra::Isometry3;
use ndarray::Axis;

use super::view::View;
use crate::associate::{LineOfSight, associate};
use crate::bundle::{Bundle, Detector};
use crate::camera::Camera;
use crate::detect::{Detection, clip, peaks};
use crate::known::KnownBoxes;
use crate::network::Features;
use crate::rays::box_rays;
use crate::{Error, Result, Rig};

/// An object before its pose is known.
pub struct Sighting {
    /// Index into the bundle's classes.
    pub class: usize,
    pub score: f64,
    /// `[V]`, image px; at least one is known.
    pub boxes: Vec<Option<[f64; 4]>>,
}

impl Sighting {
    /// Number of views that see it.
    pub fn views(&self) -> usize {
        self.boxes.iter().flatten().count()
    }

    /// The view in whose frame its pose is decoded: the reference camera's where that sees it, else
    /// the first that does.
    pub fn anchor(&self, views: &[View], reference: usize) -> Option<usize> {
        let sees = |&v: &usize| self.boxes[v].is_some();
        let reference = views.iter().position(|view| view.index == reference);
        reference
            .filter(sees)
            .or_else(|| (0..views.len()).find(sees))
    }
}

/// Objects that the detector sees, best score first.
///
/// The views are taken for independent witnesses: an object's score is the probability that not
/// all of them are wrong. So a box too faint to be an object by itself is one together with its
/// match in another view, and objects that several views agree on come before those in one.
///
/// - `radii`: least and greatest half width of each class, metres
pub fn detected(
    bundle: &Bundle,
    radii: &[[f64; 2]],
    reference: &Camera,
    views: &[View],
    features: &Features,
) -> Vec<Sighting> {
    let Detector {
        score_threshold,
        agree_threshold,
        nms_iou,
    } = bundle.detector;
    let threshold = f64::from(score_threshold);
    let faintest = f64::from(agree_threshold.unwrap_or(score_threshold)).min(threshold);
    let mut detections: Vec<Vec<Detection>> = Vec::new();
    let mut lines_of_sight = Vec::new();
    for (v, view) in views.iter().enumerate() {
        let scores = features.det_scores.index_axis(Axis(0), v);
        let boxes = features.det_boxes.index_axis(Axis(0), v);
        let ref_from_cam = reference
            .world_from_cam()
            .inv_mul(view.camera.world_from_cam());
        // A box that the lens gives no rays for cannot be decoded.
        let (found, lines) = peaks(scores, boxes, faintest, f64::from(nms_iou))
            .into_iter()
            .filter_map(|peak| {
                let bbox = view.image_box(peak.bbox)?;
                let rays = box_rays(view.camera, bbox, &ref_from_cam)?;
                let line = LineOfSight::from_box_rays(peak.class, &rays);
                Some((Detection { bbox, ..peak }, line))
            })
            .unzip();
        detections.push(found);
        lines_of_sight.push(lines);
    }

    let mut objects: Vec<Sighting> = associate(&lines_of_sight, radii)
        .into_iter()
        .filter_map(|members| {
            let boxes: Vec<Option<Detection>> = members
                .iter()
                .zip(&detections)
                .map(|(index, found)| index.map(|index| found[index]))
                .collect();
            let seen: Vec<&Detection> = boxes.iter().flatten().collect();
            let all_wrong: f64 = seen.iter().map(|d| 1.0 - d.score).product();
            let score = 1.0 - all_wrong;
            let sighting = Sighting {
                class: seen.first()?.class,
                score,
                boxes: boxes.iter().map(|d| d.map(|d| d.bbox)).collect(),
            };
            (score >= threshold).then_some(sighting)
        })
        .collect();
    objects.sort_by(|a, b| b.score.total_cmp(&a.score));
    objects
}

/// Objects whose boxes are given, in their order.
pub fn given(
    bundle: &Bundle,
    rig: &Rig,
    views: &[View],
    boxes: &[KnownBoxes],
) -> Result<Vec<Sighting>> {
    let mut objects = Vec::new();
    for (i, given) in boxes.iter().enumerate() {
        let refuse = |problem: String| Err(Error::Input(format!("boxes of object {i}: {problem}")));
        let Some(class) = bundle.classes.iter().position(|c| c.name == given.class) else {
            let known: Vec<&str> = bundle.classes.iter().map(|c| c.name.as_str()).collect();
            let known = known.join(", ");
            return refuse(format!(
                "no class `{}` in the model, expected one of: {known}",
                given.class
            ));
        };
        if let Some(unknown) = given.boxes.keys().find(|id| rig.index_of(id).is_none()) {
            return refuse(format!("no camera `{unknown}` in the rig"));
        }
        let mut in_views = Vec::new();
        for View { camera, .. } in views {
            let bbox = match given.boxes.get(camera.id()) {
                None => None,
                Some(&bbox) => {
                    let usable = clip(bbox, camera.width(), camera.height())
                        .filter(|&b| box_rays(camera, b, &Isometry3::identity()).is_some());
                    if usable.is_none() {
                        return refuse(format!(
                            "expected [x0, y0, x1, y1] with x0 < x1 and y0 < y1 within the \
                             image and field of view of camera `{}`, got {bbox:?}",
                            camera.id()
                        ));
                    }
                    usable
                }
            };
            in_views.push(bbox);
        }
        if in_views.iter().all(Option::is_none) {
            return refuse("expected a box in at least one of the given images, got none".into());
        }
        objects.push(Sighting {
            class,
            score: 1.0,
            boxes: in_views,
        });
    }
    Ok(objects)
}
