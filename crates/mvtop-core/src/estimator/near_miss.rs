//! What came nearest of each class, noted at the stages that leave instances out.

use std::cmp::Ordering;

use ndarray::{Axis, s};

use super::instance::Instance;
use super::pipeline::Pipeline;
use super::view::View;
use super::wanted::Misfit;
use crate::BBox;
use crate::associate::{LineOfSight, Mismatch, mismatch};
use crate::detect::Detection;
use crate::network::DetectorMaps;
use crate::prediction::{MissReason, NearMiss, ObjectPose};

/// Of each class the miss at the latest stage; of two at one stage the first that is noted.
pub struct NearMisses {
    /// By index of the class.
    nearest: Vec<Option<NearMiss>>,
}

impl NearMisses {
    pub fn new(classes: usize) -> Self {
        Self {
            nearest: vec![None; classes],
        }
    }

    fn note(&mut self, class: usize, miss: NearMiss) {
        let known = self.nearest[class].as_ref();
        if known.is_none_or(|known| known.reason < miss.reason) {
            self.nearest[class] = Some(miss);
        }
    }

    /// Those of the classes without an object.
    pub fn of_missing(self, objects: &[ObjectPose]) -> Vec<NearMiss> {
        let all = self.nearest.into_iter().flatten();
        all.filter(|miss| !objects.iter().any(|object| object.class == miss.class))
            .collect()
    }
}

impl Pipeline<'_> {
    /// Notes a miss of a class that is asked for, if misses are.
    pub(super) fn note(
        &self,
        misses: &mut NearMisses,
        class: usize,
        miss: impl FnOnce() -> NearMiss,
    ) {
        if self.options.why && self.wanted.has_class(class) {
            misses.note(class, miss());
        }
    }

    /// What an instance failed at.
    pub(super) fn missed(
        &self,
        one: &Instance,
        reason: MissReason,
        numbers: Option<[f64; 2]>,
        message: String,
    ) -> NearMiss {
        let seen = self.views.iter().zip(&one.detections);
        let seen = seen.filter_map(|(view, seen)| Some((view.index, (*seen)?)));
        let best = seen.max_by(|a, b| a.1.score.total_cmp(&b.1.score));
        NearMiss {
            class: self.name(one.class).to_owned(),
            reason,
            camera: best.map(|(camera, _)| camera),
            bbox: best.map(|(_, seen)| seen.bbox),
            world_from_obj: one.best().map(|best| best.world_from_obj),
            value: numbers.map(|[value, _]| value),
            threshold: numbers.map(|[_, threshold]| threshold),
            message,
        }
    }

    pub(super) fn name(&self, class: usize) -> &str {
        &self.estimator.bundle.classes[class].name
    }

    /// An instance whose pose its priors do not allow.
    pub(super) fn misfitted(&self, one: &Instance, misfit: Misfit) -> NearMiss {
        let name = self.name(one.class);
        let Misfit {
            reason,
            value,
            threshold,
        } = misfit;
        let message = match reason {
            MissReason::Tilt => format!(
                "`{name}` was found, tilted by {value:.1}° on its plane, more than {threshold}°"
            ),
            MissReason::Height => {
                let above = if value > 0.0 { "above" } else { "below" };
                format!(
                    "`{name}` was found, {:.1} mm {above} its plane, more than {:.1} mm",
                    value.abs() * 1e3,
                    threshold * 1e3
                )
            }
            _ => format!(
                "`{name}` was found, {value:.1} standard deviations from its prior, more than {threshold}"
            ),
        };
        self.missed(one, reason, Some([value, threshold]), message)
    }

    /// An instance that too few views detected.
    ///
    /// - `least`: the fewest views
    pub(super) fn in_few_views(&self, one: &Instance, least: usize) -> NearMiss {
        let (name, views) = (self.name(one.class), one.views());
        let numbers = [views as f64, least as f64];
        let message = format!("`{name}` was detected in images: {views}, fewer than {least}");
        self.missed(one, MissReason::MinViews, Some(numbers), message)
    }

    /// An instance without a candidate.
    pub(super) fn without_pose(&self, one: &Instance) -> NearMiss {
        let name = self.name(one.class);
        let message = format!("`{name}` was detected, what its boxes show gives no pose");
        self.missed(one, MissReason::NoPose, None, message)
    }

    /// An instance that a better one suppresses.
    pub(super) fn duplicate(&self, one: &Instance, better: &Instance) -> NearMiss {
        let numbers = [one.confidence(), better.confidence()];
        let message = format!(
            "`{}` was found with a confidence of {:.1} %, where a `{}` of {:.1} % is",
            self.name(one.class),
            100.0 * numbers[0],
            self.name(better.class),
            100.0 * numbers[1]
        );
        self.missed(one, MissReason::Duplicate, Some(numbers), message)
    }

    /// An instance of too low a confidence.
    pub(super) fn improbable(&self, one: &Instance, confidence: f64, least: f64) -> NearMiss {
        let message = format!(
            "`{}` was found with a confidence of {:.2} %, below {:.2} %",
            self.name(one.class),
            100.0 * confidence,
            100.0 * least
        );
        let numbers = Some([confidence, least]);
        self.missed(one, MissReason::Confidence, numbers, message)
    }

    /// Classes without an instance: what the detector and the association made of them.
    ///
    /// - `boxes`: `[V][boxes]` of the detector, px of the images
    pub(super) fn note_undetected(
        &self,
        misses: &mut NearMisses,
        boxes: &[Vec<Detection>],
        found: &[Instance],
    ) {
        if !self.options.why {
            return;
        }
        for class in 0..self.estimator.bundle.classes.len() {
            if !self.wanted.has_class(class) || found.iter().any(|one| one.class == class) {
                continue;
            }
            let miss = self.undetected(class, boxes);
            misses.nearest[class] = miss;
        }
    }

    fn undetected(&self, class: usize, boxes: &[Vec<Detection>]) -> Option<NearMiss> {
        let name = self.name(class);
        let threshold = f64::from(self.estimator.bundle.detector.score_threshold);
        let best = |(v, all): (usize, &Vec<Detection>)| {
            let of_class = all.iter().filter(|one| one.class == class);
            let best = of_class.max_by(|a, b| a.score.total_cmp(&b.score))?;
            Some((v, *best))
        };
        let mut seen: Vec<(usize, Detection)> = boxes.iter().enumerate().filter_map(best).collect();
        seen.sort_by(|a, b| b.1.score.total_cmp(&a.1.score));
        let (view, score, bbox) = match seen.first() {
            Some((view, one)) => (*view, one.score, Some(one.bbox)),
            None => peak(self.maps.as_ref()?, &self.views, class)?,
        };
        let id = |view: usize| self.views[view].camera.id();
        let miss = |reason, numbers: Option<[f64; 2]>, message: String| NearMiss {
            class: name.to_owned(),
            reason,
            camera: Some(self.views[view].index),
            bbox,
            world_from_obj: None,
            value: numbers.map(|[value, _]| value),
            threshold: numbers.map(|[_, threshold]| threshold),
            message,
        };
        if score >= threshold {
            let message = format!(
                "`{name}` was detected in camera `{}`, where its box gives no crop",
                id(view)
            );
            return Some(miss(MissReason::NoPose, None, message));
        }
        if let [(a, first), (b, second), ..] = &seen[..] {
            let line = |view: usize, one: &Detection| {
                LineOfSight::new(class, self.views[view].camera, one.bbox)
            };
            let radii = self.estimator.radii[class];
            let association = &self.config().association;
            let lines = line(*a, first).zip(line(*b, second));
            let apart = lines.and_then(|(a, b)| mismatch(association, &a, &b, radii));
            let of = format!(
                "boxes of `{name}` in cameras `{}` and `{}`, each alone below the score of {threshold:.2},",
                id(*a),
                id(*b)
            );
            match apart {
                Some(Mismatch::Rays { gap_m, limit_m }) => {
                    let numbers = gap_m.is_finite().then_some([gap_m, limit_m]);
                    let how = match numbers {
                        Some(numbers) => {
                            let [gap_mm, limit_mm] = numbers.map(|metres| metres * 1e3);
                            format!("have rays {gap_mm:.1} mm apart, {limit_mm:.1} mm are allowed")
                        }
                        None => "have rays that do not meet in front of both".to_owned(),
                    };
                    let message = format!("{of} {how}");
                    return Some(miss(MissReason::RaysApart, numbers, message));
                }
                Some(Mismatch::Sizes { radius_m, limit_m }) => {
                    let message = format!(
                        "{of} meet where their size gives a radius of {:.1} mm, {:.1} mm would do",
                        radius_m * 1e3,
                        limit_m * 1e3
                    );
                    let numbers = Some([radius_m, limit_m]);
                    return Some(miss(MissReason::SizesDisagree, numbers, message));
                }
                None => {}
            }
        }
        let message = format!(
            "the detector's best score for `{name}` is {score:.2}, in camera `{}`, below {threshold:.2}",
            id(view)
        );
        let numbers = Some([score, threshold]);
        Some(miss(MissReason::DetectorScore, numbers, message))
    }
}

/// View, score and box of the greatest score of a class, px of the view's image.
fn peak(maps: &DetectorMaps, views: &[View], class: usize) -> Option<(usize, f64, Option<BBox>)> {
    let mut best: Option<(usize, (usize, usize), f32)> = None;
    for (view, scores) in maps
        .scores
        .index_axis(Axis(1), class)
        .outer_iter()
        .enumerate()
    {
        for (cell, score) in scores.indexed_iter() {
            let better = |best: &(usize, (usize, usize), f32)| {
                score.partial_cmp(&best.2) == Some(Ordering::Greater)
            };
            if score.is_finite() && best.as_ref().is_none_or(better) {
                best = Some((view, cell, *score));
            }
        }
    }
    let (view, (row, column), score) = best?;
    let sides = maps.boxes.slice(s![view, .., row, column]);
    let side = |side: usize| sides.get(side).map_or(f64::NAN, |x| f64::from(*x));
    let bbox = BBox::from([0, 1, 2, 3].map(side));
    let bbox = bbox
        .is_proper()
        .then(|| views[view].image_box(bbox))
        .flatten();
    Some((view, f64::from(score), bbox))
}
