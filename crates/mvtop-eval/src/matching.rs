//! Which prediction is of which true object.

use mvtop_core::Prediction;
use mvtop_core::annotations::TruePose;
use mvtop_core::bundle::Class;
use mvtop_core::pose::translation_error;
use mvtop_core::prediction::ObjectPose;

/// By true object, the prediction of its class that is matched with it: one to one, nearest origins
/// first.
///
/// - `reach`: by class, how far their origins may lie apart, metres
pub fn matches<'a>(
    truth: &[TruePose],
    prediction: &'a Prediction,
    reach: impl Fn(&str) -> f64,
) -> Vec<Option<&'a ObjectPose>> {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (t, known) in truth.iter().enumerate() {
        for (p, found) in prediction.objects.iter().enumerate() {
            if found.class == known.seen.class {
                let off = translation_error(&known.world_from_obj, &found.world_from_obj);
                if off <= reach(&found.class) {
                    pairs.push((off, t, p));
                }
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut matched = vec![None; truth.len()];
    let mut taken = vec![false; prediction.objects.len()];
    for (_, t, p) in pairs {
        if matched[t].is_none() && !taken[p] {
            matched[t] = Some(&prediction.objects[p]);
            taken[p] = true;
        }
    }
    matched
}

/// How far a prediction of a known class may lie off to have found an object: the object's diameter.
pub fn diameter(classes: &[Class]) -> impl Fn(&str) -> f64 {
    move |name| {
        let class = classes.iter().find(|class| class.name == name);
        class.map_or(0.0, |class| class.diameter_m)
    }
}

/// The predictions that are matched with no true object.
///
/// - `matched`: of these predictions
pub fn unmatched<'a>(
    matched: &[Option<&ObjectPose>],
    prediction: &'a Prediction,
) -> Vec<&'a ObjectPose> {
    let is_matched = |found: &ObjectPose| matched.iter().flatten().any(|m| std::ptr::eq(*m, found));
    let objects = prediction.objects.iter();
    objects.filter(|found| !is_matched(found)).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use mvtop_core::annotations::GivenBoxes;
    use mvtop_core::prediction::{Sigma, Timings};
    use nalgebra::Isometry3;

    /// An object of that class and its id, at a pose in the world.
    pub fn found(class: &str, class_id: i64, pose: Isometry3<f64>) -> ObjectPose {
        ObjectPose {
            sigma: Sigma {
                rot_deg: 1.0,
                t_m: 0.01,
            },
            ..ObjectPose::new(class, class_id, 1.0, pose, pose)
        }
    }

    fn at(x: f64) -> Isometry3<f64> {
        Isometry3::translation(x, 0.0, 1.0)
    }

    fn known(class: &str, x: f64) -> TruePose {
        TruePose {
            seen: GivenBoxes {
                class: class.into(),
                boxes: Default::default(),
            },
            world_from_obj: at(x),
        }
    }

    /// Nuts at these places.
    fn nuts(places: &[f64]) -> Prediction {
        Prediction {
            reference: 0,
            objects: places.iter().map(|x| found("nut", 1, at(*x))).collect(),
            rig_consistency: None,
            timings: Timings::default(),
            model: String::new(),
            provider: String::new(),
            warnings: Vec::new(),
            near_misses: Vec::new(),
        }
    }

    #[test]
    fn what_is_not_asked_for_is_neither_found_nor_invented() {
        let prediction = nuts(&[0.1, 2.1, 0.3, 5.0]);
        // A bolt at 5 is no nut, and the nut at 2 has been found once.
        let truth = [known("nut", 0.0), known("nut", 2.0), known("bolt", 5.0)];
        let matched = matches(&truth, &prediction, |_| 0.5);
        let asked = matched[0].map(|found| found.world_from_obj.translation.x);
        assert_eq!(asked, Some(0.1));
        // Those at 0.3 and 5.
        assert_eq!(unmatched(&matched, &prediction).len(), 2);
    }

    #[test]
    fn objects_are_matched_one_to_one_nearest_first_within_their_class() {
        let truth = [known("nut", 0.0), known("nut", 1.0), known("bolt", 1.1)];
        let prediction = nuts(&[0.4, 0.1, 9.0]);
        let places = |matched: &[Option<&ObjectPose>]| -> Vec<Option<f64>> {
            let x = |found: &ObjectPose| found.world_from_obj.translation.x;
            matched.iter().map(|found| found.map(x)).collect()
        };
        let matched = matches(&truth, &prediction, |_| f64::INFINITY);
        // The second nut is nearer to 0.4 than 9.0 is to it; there is no bolt.
        assert_eq!(places(&matched), [Some(0.1), Some(0.4), None]);
        assert_eq!(unmatched(&matched, &prediction).len(), 1);
        // What is farther off than the part is large is another thing.
        let matched = matches(&truth, &prediction, |_| 0.5);
        assert_eq!(places(&matched), [Some(0.1), None, None]);
        assert_eq!(unmatched(&matched, &prediction).len(), 2);
    }
}
