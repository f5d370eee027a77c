//! Which of the objects that were found are given.

use nalgebra::{Isometry3, Point2, Point3};
use serde::{Deserialize, Serialize};

use super::{Request, refuse};
use crate::bundle::Bundle;
use crate::prediction::{MissReason, NearMiss, ObjectPose, Prediction};
use crate::{Result, Rig};

/// A box along the axes of the world frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WorldBox {
    /// Corner of the least coordinates, metres.
    pub min_m: [f64; 3],
    /// Corner of the greatest coordinates, metres.
    pub max_m: [f64; 3],
}

impl WorldBox {
    /// Refuses a box that holds nothing.
    pub(super) fn check(&self) -> Result<()> {
        let mut sides = self.min_m.iter().zip(&self.max_m);
        if sides.all(|(min, max)| min.is_finite() && max.is_finite() && min < max) {
            return Ok(());
        }
        Err(refuse(&format!(
            "region: expected a box in metres whose least corner is below the greatest one along each axis, \
             got {:?} and {:?}",
            self.min_m, self.max_m
        )))
    }

    fn contains(&self, point: &Point3<f64>) -> bool {
        (0..3).all(|axis| (self.min_m[axis]..=self.max_m[axis]).contains(&point[axis]))
    }
}

/// How many objects were found but not asked for, each counted once, by what left it out first.
///
/// Those of other classes are not looked for, but in what was found before it was asked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeftOut {
    /// Of another class.
    pub classes: usize,
    /// Outside the box.
    pub region: usize,
    /// Outside a polygon.
    pub polygons: usize,
    /// Less probable than the most that were asked for.
    pub most: usize,
}

/// The objects that were asked for, and their indices among all that were found.
pub(super) fn choose(
    request: &Request,
    mut found: Prediction,
    bundle: &Bundle,
    rig: &Rig,
) -> (Prediction, Vec<usize>, LeftOut) {
    let mut left_out = LeftOut::default();
    let mut kept: Vec<usize> = Vec::new();
    // Found and wanted, but for this.
    let mut missed: Vec<(usize, MissReason)> = Vec::new();
    for (index, object) in found.objects.iter().enumerate() {
        let listed = |classes: &Vec<String>| classes.contains(&object.class);
        let middle = object.middle(bundle);
        if !request.classes.as_ref().is_none_or(listed) {
            left_out.classes += 1;
        } else if !request.region.is_none_or(|region| region.contains(&middle)) {
            left_out.region += 1;
            missed.push((index, MissReason::Region));
        } else if !is_in_polygons(request, &middle, rig) {
            left_out.polygons += 1;
            missed.push((index, MissReason::Polygons));
        } else {
            kept.push(index);
        }
    }
    let most = request.most.unwrap_or(usize::MAX);
    if kept.len() > most {
        left_out.most = kept.len() - most;
        let probability = |index: &usize| {
            let object = &found.objects[*index];
            (object.confidence.unwrap_or(0.0), object.score)
        };
        // Stable: of two that are as probable the first one stays.
        kept.sort_by(|a, b| {
            let ((a, a_score), (b, b_score)) = (probability(a), probability(b));
            b.total_cmp(&a).then(b_score.total_cmp(&a_score))
        });
        let others = kept.split_off(most);
        missed.extend(others.into_iter().map(|index| (index, MissReason::Most)));
        kept.sort_unstable();
    }
    let given = |class: &str| {
        kept.iter()
            .any(|&index| found.objects[index].class == class)
    };
    let mut near_misses: Vec<NearMiss> = Vec::new();
    // What failed at the last choice came nearest.
    missed.sort_by_key(|missed| std::cmp::Reverse(missed.1));
    for (index, reason) in missed {
        let object = &found.objects[index];
        let told = |miss: &NearMiss| miss.class == object.class;
        if request.says_why() && !given(&object.class) && !near_misses.iter().any(told) {
            near_misses.push(near_miss(object, reason));
        }
    }
    let listed = |class: &String| {
        request
            .classes
            .as_ref()
            .is_none_or(|all| all.contains(class))
    };
    found.near_misses.retain(|miss| listed(&miss.class));
    found.near_misses.extend(near_misses);
    for warning in &mut found.warnings {
        // What was doubtful stays so: a warning of an object that is left out is one of the images.
        let place = |object| kept.iter().position(|index| *index == object);
        warning.object = warning.object.and_then(place);
    }
    let mut index = 0;
    found.objects.retain(|_| {
        let keep = kept.contains(&index);
        index += 1;
        keep
    });
    (found, kept, left_out)
}

/// An object that was found, and is not given.
fn near_miss(object: &ObjectPose, reason: MissReason) -> NearMiss {
    let seen = object.cameras.iter().find(|seen| seen.bbox.is_some());
    let place = match reason {
        MissReason::Region => "outside the region",
        MissReason::Polygons => "outside a polygon",
        _ => "less probable than as many others as were asked for",
    };
    NearMiss {
        class: object.class.clone(),
        reason,
        camera: seen.map(|seen| seen.camera),
        bbox: seen.and_then(|seen| seen.bbox),
        world_from_obj: Some(object.world_from_obj),
        value: None,
        threshold: None,
        message: format!("`{}` was found, {place}", object.class),
    }
}

fn is_in_polygons(request: &Request, middle: &Point3<f64>, rig: &Rig) -> bool {
    request.polygons.iter().all(|(id, polygon)| {
        let camera = rig.index_of(id).map(|index| &rig.cameras()[index]);
        let pixel = camera.and_then(|camera| {
            let world_from_cam: &Isometry3<f64> = camera.world_from_cam();
            let in_camera = world_from_cam.inverse_transform_point(middle);
            camera.intrinsics().project(&in_camera)
        });
        pixel.is_some_and(|pixel| is_inside(polygon, &pixel))
    })
}

/// Whether a ray from the point crosses the polygon's sides an odd number of times.
pub(super) fn is_inside(polygon: &[[f64; 2]], point: &Point2<f64>) -> bool {
    let ends = polygon.iter().cycle().skip(1);
    let crossed = polygon.iter().zip(ends).filter(|([u0, v0], [u1, v1])| {
        let spans = (*v0 > point.y) != (*v1 > point.y);
        spans && point.x < (u1 - u0) * (point.y - v0) / (v1 - v0) + u0
    });
    crossed.count() % 2 == 1
}
