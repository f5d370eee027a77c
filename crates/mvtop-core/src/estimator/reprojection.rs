//! Objects projected into views: where each should show them, and boxes for their crops.

use nalgebra::Isometry3;

use super::view::View;
use crate::BBox;
use crate::bundle::Class;
use crate::closeup::CloseUp;
use crate::consistency::extent;

/// An object's projection in a view.
#[derive(Debug, Clone, Copy)]
pub struct Projection {
    /// The part inside the image, px.
    pub bbox: BBox,
    /// Its share of the whole projection's box.
    pub share: f64,
}

/// The projection of an object at a pose; `None` where the view cannot show it.
pub fn project(class: &Class, view: &View, world_from_obj: &Isometry3<f64>) -> Option<Projection> {
    let whole = extent(&class.points, view.camera, world_from_obj)?;
    let bbox = whole.clip(view.camera.width(), view.camera.height())?;
    let share = bbox.width() * bbox.height() / (whole.width() * whole.height());
    CloseUp::is_of(view.camera, bbox).then_some(Projection { bbox, share })
}

/// `[V]`: projections of which at least `min_in_image` is inside the image.
pub fn expected(
    class: &Class,
    views: &[View],
    world_from_obj: &Isometry3<f64>,
    min_in_image: f64,
) -> Vec<Option<Projection>> {
    let of_view = |view| project(class, view, world_from_obj);
    let projections = views.iter().map(of_view);
    projections
        .map(|one| one.filter(|one| one.share >= min_in_image))
        .collect()
}

/// Whether boxes in all views overlap by more than `iou`.
pub fn same_rois(a: &[Option<BBox>], b: &[Option<BBox>], iou: f64) -> bool {
    a.iter().zip(b).all(|pair| match pair {
        (Some(a), Some(b)) => a.iou(b) > iou,
        (a, b) => a.is_none() && b.is_none(),
    })
}
