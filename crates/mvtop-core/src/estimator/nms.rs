//! Suppression of duplicates in space: one thing is one object.

use super::instance::Instance;
use super::reprojection;
use super::view::View;
use crate::bundle::Class;
use crate::config::SearchConfig;
use crate::detect::Detection;

/// What is left of instances, and what was suppressed.
pub struct Suppressed {
    /// The best one first.
    pub kept: Vec<Instance>,
    /// Likewise, each with the index of the better one among those that are kept.
    pub duplicates: Vec<(Instance, usize)>,
}

/// Suppresses each instance that stands where a better one does.
///
/// Two instances are duplicates if their positions are near, or if the better one projects onto all
/// boxes of the other. The better one takes over the boxes of the other in views without one.
///
/// - `radii`: least and greatest half width of each class, metres
pub fn suppress(
    config: &SearchConfig,
    classes: &[Class],
    views: &[View],
    radii: &[[f64; 2]],
    mut instances: Vec<Instance>,
) -> Suppressed {
    instances.sort_by(|a, b| {
        let odds = |one: &Instance| one.best().map_or(f64::NEG_INFINITY, |c| c.scored.log_odds);
        odds(b).total_cmp(&odds(a))
    });
    let mut kept: Vec<Instance> = Vec::new();
    let mut duplicates = Vec::new();
    for one in instances {
        let better = kept.iter().position(|better| {
            near(config, radii, better, &one) || explains(config, classes, views, better, &one)
        });
        let Some(better) = better else {
            kept.push(one);
            continue;
        };
        if kept[better].class == one.class {
            adopt(&mut kept[better], &one);
        }
        duplicates.push((one, better));
    }
    Suppressed { kept, duplicates }
}

fn near(config: &SearchConfig, radii: &[[f64; 2]], a: &Instance, b: &Instance) -> bool {
    let (Some(best), Some(other)) = (a.best(), b.best()) else {
        return false;
    };
    let [p, q] = [best, other].map(|one| one.world_from_obj.translation.vector);
    let reach = radii[a.class][0] + radii[b.class][0];
    (p - q).norm() < config.duplicate_distance * reach
}

/// Whether a better instance of the same class projects onto all boxes of another.
fn explains(
    config: &SearchConfig,
    classes: &[Class],
    views: &[View],
    better: &Instance,
    one: &Instance,
) -> bool {
    // What no view detected, a prior proposed: there is nothing to explain.
    let comparable = better.class == one.class && one.views() > 0;
    let Some(best) = better.best().filter(|_| comparable) else {
        return false;
    };
    let covers = |(view, seen): (&View, &Option<Detection>)| {
        let Some(seen) = seen else { return true };
        let projection = reprojection::project(&classes[better.class], view, &best.world_from_obj);
        projection.is_some_and(|shown| shown.bbox.iou(&seen.bbox) >= config.same_box_iou)
    };
    // A view that has a box of both shows two things.
    let mut both = better.detections.iter().zip(&one.detections);
    !both.any(|(a, b)| a.is_some() && b.is_some()) && views.iter().zip(&one.detections).all(covers)
}

/// Takes over the boxes of a duplicate in views without one.
fn adopt(better: &mut Instance, duplicate: &Instance) {
    let boxes = better.detections.iter_mut().zip(&duplicate.detections);
    for (own, other) in boxes {
        *own = own.or(*other);
    }
}
