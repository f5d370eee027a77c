//! Objects before their poses are known: detected and matched across views, or given by the user.

use ndarray::Axis;

use super::instance::Instance;
use super::view::View;
use crate::annotations::GivenBoxes;
use crate::associate::{LineOfSight, associate, matches};
use crate::bundle::Bundle;
use crate::closeup::CloseUp;
use crate::config::AssociationConfig;
use crate::detect::{Detection, peaks};
use crate::network::DetectorMaps;
use crate::rays::BoxRays;
use crate::{BBox, Error, Result, Rig};

/// Boxes of each view that the detector has found in the whole images, in pixels of these.
pub fn in_whole_images(
    bundle: &Bundle,
    views: &[View],
    maps: &DetectorMaps,
) -> Vec<Vec<Detection>> {
    let seen = |(v, view): (usize, &View)| {
        let found = boxes(bundle, maps, v).into_iter();
        let in_image = |peak: Detection| {
            let bbox = view.image_box(peak.bbox)?;
            Some(Detection { bbox, ..peak })
        };
        found.filter_map(in_image).collect()
    };
    views.iter().enumerate().map(seen).collect()
}

/// Boxes that the detector has found in one picture, in pixels of its input.
pub fn boxes(bundle: &Bundle, maps: &DetectorMaps, picture: usize) -> Vec<Detection> {
    let faintest = f64::from(bundle.detector.faintest());
    let scores = maps.scores.index_axis(Axis(0), picture);
    let boxes = maps.boxes.index_axis(Axis(0), picture);
    peaks(scores, boxes, faintest, f64::from(bundle.detector.nms_iou))
}

/// Instances that the boxes of all views show, best score first.
///
/// The views count as independent: an instance's score is the probability that not all of them are
/// wrong. So a box below the threshold becomes an instance together with its match in another view.
///
/// - `radii`: least and greatest half width of each class, metres
/// - `boxes`: `[V][boxes]`, in the images; one that the lens gives no rays for, or of which there is no
///   close-up where the network needs one, cannot be decoded
pub fn detected(
    bundle: &Bundle,
    config: &AssociationConfig,
    radii: &[[f64; 2]],
    views: &[View],
    boxes: &[Vec<Detection>],
) -> Vec<Instance> {
    let seen = Seen::new(views, boxes);
    let members = associate(config, &seen.lines, radii);
    let mut instances = seen.instances(bundle, members);
    instances.sort_by(|a, b| b.score().total_cmp(&a.score()));
    instances
}

/// Instances that other matches of the boxes of some instances make, the best match first.
///
/// - `instances`: whose boxes are matched; the other arguments are those of [`detected`]
pub fn rematched(
    bundle: &Bundle,
    config: &AssociationConfig,
    radii: &[[f64; 2]],
    views: &[View],
    instances: &[Instance],
) -> Vec<Instance> {
    let of_view = |v: usize| instances.iter().filter_map(move |one| one.detections[v]);
    let boxes: Vec<Vec<Detection>> = (0..views.len()).map(|v| of_view(v).collect()).collect();
    let seen = Seen::new(views, &boxes);
    let mut others = seen.instances(bundle, matches(config, &seen.lines, radii));
    let known = |other: &Instance| {
        instances
            .iter()
            .any(|one| one.detections == other.detections)
    };
    others.retain(|other| !known(other));
    others
}

/// Boxes of each view that can be decoded, with their lines of sight.
struct Seen {
    boxes: Vec<Vec<Detection>>,
    lines: Vec<Vec<LineOfSight>>,
}

impl Seen {
    fn new(views: &[View], boxes: &[Vec<Detection>]) -> Self {
        let of_view = |(view, boxes): (&View, &Vec<Detection>)| {
            let boxes = boxes.iter();
            boxes
                .filter(|seen| CloseUp::is_of(view.camera, seen.bbox))
                .filter_map(|seen| {
                    Some((*seen, LineOfSight::new(seen.class, view.camera, seen.bbox)?))
                })
                .unzip()
        };
        let (boxes, lines) = views.iter().zip(boxes).map(of_view).unzip();
        Self { boxes, lines }
    }

    /// Instances of boxes by their indices, those whose score reaches the threshold.
    ///
    /// - `members`: `[objects][V]`
    fn instances(&self, bundle: &Bundle, members: Vec<Vec<Option<usize>>>) -> Vec<Instance> {
        let threshold = f64::from(bundle.detector.score_threshold);
        let instance = |members: Vec<Option<usize>>| {
            let seen = members.iter().zip(&self.boxes);
            let seen: Vec<Option<Detection>> = seen
                .map(|(index, boxes)| index.map(|index| boxes[index]))
                .collect();
            let instance = Instance::new(seen.iter().flatten().next()?.class, seen);
            (instance.score() >= threshold).then_some(instance)
        };
        members.into_iter().filter_map(instance).collect()
    }
}

/// Most objects whose boxes may be given: each takes its own time, half a second on two cores.
pub const MOST_GIVEN: usize = 100;

/// Objects whose boxes are given, in their order.
pub fn given(
    bundle: &Bundle,
    rig: &Rig,
    views: &[View],
    boxes: &[GivenBoxes],
) -> Result<Vec<Instance>> {
    if boxes.len() > MOST_GIVEN {
        return Err(Error::Input(format!(
            "boxes: expected those of {MOST_GIVEN} objects at most, got {}; give them in several \
             predictions",
            boxes.len()
        )));
    }
    let mut objects = Vec::new();
    for (i, given) in boxes.iter().enumerate() {
        let role = format!("boxes of object {i}");
        let Some(class) = bundle.class_index(&given.class) else {
            return Err(Error::UnknownClass {
                role,
                class: given.class.clone(),
                known: bundle.classes.iter().map(|c| c.name.clone()).collect(),
            });
        };
        for id in given.boxes.keys() {
            rig.find(&role, id)?;
        }
        let mut in_views = Vec::new();
        for View { camera, .. } in views {
            let bbox = given.boxes.get(camera.id());
            let usable = bbox
                .and_then(|bbox| bbox.clip(camera.width(), camera.height()))
                .filter(|&bbox| BoxRays::new(camera, bbox).is_some());
            if let (Some(&bbox), None) = (bbox, usable) {
                return Err(Error::Input(format!(
                    "{role}: expected [x0, y0, x1, y1] with x0 < x1 and y0 < y1, a pixel or more of \
                     each within the image and field of view of camera `{}`, got {:?}",
                    camera.id(),
                    <[f64; 4]>::from(bbox)
                )));
            }
            in_views.push(usable);
        }
        if in_views.iter().all(Option::is_none) {
            return Err(Error::Input(format!(
                "{role}: expected a box in at least one of the given images, got none"
            )));
        }
        let detection = |bbox: Option<BBox>| {
            let score = 1.0;
            bbox.map(|bbox| Detection { class, score, bbox })
        };
        let detections = in_views.into_iter().map(detection).collect();
        objects.push(Instance::new(class, detections));
    }
    Ok(objects)
}
