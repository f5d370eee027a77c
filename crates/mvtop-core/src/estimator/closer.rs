//! A second look at parts of large images.
//!
//! The detector sees whole images scaled down to its input. Of images much larger than that, objects
//! that are small in them shrink below what it finds (some 35 px of its input). So the parts where an
//! object is to be expected are shown to it larger: where one view has a box and another one has
//! none, the place in the other one that this box tells; and where there is no box at all, all of the
//! images. Nothing of this is done to images that shrink less.

use image::imageops::crop_imm;
use nalgebra::{Point2, Vector2};
use ndarray::{Array4, Axis};

use super::sightings::{self, Sighting};
use super::view::View;
use crate::associate::LineOfSight;
use crate::bundle::Bundle;
use crate::detect::{Detection, merged};
use crate::image::{Letterbox, fill};
use crate::network::Network;
use crate::{BBox, Result};

/// Images that shrink by less are seen well enough.
const LARGE: f64 = 0.5;
/// Where one object is expected, the detector is shown the image this much larger.
const AT_A_PLACE: f64 = 2.0;
/// Everywhere, likewise: four parts of an image, which overlap by a quarter of it.
const EVERYWHERE: f64 = 1.6;
/// Most parts that are looked at for what single views have found; the best boxes come first.
const MOST_PLACES: usize = 8;
/// Boxes that end within so many pixels of the detector's input of where a part is cut off may be
/// halves.
const BORDER: f64 = 2.0;

/// A part of a view's image, px.
struct Part {
    view: usize,
    left: u32,
    top: u32,
    letterbox: Letterbox,
}

/// Adds what a second look at the views finds to their boxes, `[V][boxes]`, in the images.
pub fn look(
    network: &dyn Network,
    bundle: &Bundle,
    radii: &[[f64; 2]],
    views: &[View],
    boxes: &mut [Vec<Detection>],
) -> Result<()> {
    if !views.iter().any(is_large) {
        return Ok(());
    }
    let mut found = sightings::detected(bundle, radii, views, boxes);
    if found.is_empty() {
        let everywhere = views.iter().enumerate().filter(|(_, view)| is_large(view));
        let parts = everywhere.flat_map(|(v, view)| all_of(v, view)).collect();
        add(network, bundle, views, parts, boxes)?;
        found = sightings::detected(bundle, radii, views, boxes);
    }
    let places = found
        .iter()
        .filter(|object| object.views() == 1)
        .flat_map(|object| elsewhere(radii, views, object));
    let parts = places.take(MOST_PLACES).collect();
    add(network, bundle, views, parts, boxes)
}

fn is_large(view: &View) -> bool {
    view.letterbox.su.max(view.letterbox.sv) < LARGE
}

/// Four parts that cover a view's image, fewer where it is much longer than the detector's input.
fn all_of(v: usize, view: &View) -> Vec<Part> {
    let [width, height] = [view.camera.width(), view.camera.height()].map(f64::from);
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    let mut parts: Vec<Part> = Vec::new();
    for (u, v_px) in corners {
        let part = part_at(v, view, Point2::new(u, v_px), EVERYWHERE);
        let known = |known: &Part| (known.left, known.top) == (part.left, part.top);
        if !parts.iter().any(known) {
            parts.push(part);
        }
    }
    parts
}

/// Of an object that one view has found, the parts of the other views that should show it.
fn elsewhere<'a>(
    radii: &'a [[f64; 2]],
    views: &'a [View<'a>],
    object: &'a Sighting,
) -> impl Iterator<Item = Part> + 'a {
    let mut seen = views.iter().zip(&object.boxes);
    let line = seen.find_map(|(view, bbox)| LineOfSight::new(object.class, view.camera, (*bbox)?));
    let others = views.iter().enumerate().zip(&object.boxes);
    others.filter_map(move |((v, view), bbox)| {
        if bbox.is_some() || !is_large(view) {
            return None;
        }
        let line = line?;
        let [least, most] = radii[object.class];
        let distance = (least + most) / 2.0 / line.sin_radius;
        let in_world = line.origin + distance * line.direction;
        let in_cam = view.camera.world_from_cam().inverse() * nalgebra::Point3::from(in_world);
        let place = view.camera.intrinsics().project(&in_cam)?;
        let size = [view.camera.width(), view.camera.height()].map(f64::from);
        let inside = (0.0..size[0]).contains(&place.x) && (0.0..size[1]).contains(&place.y);
        inside.then(|| part_at(v, view, place, AT_A_PLACE))
    })
}

/// The part of a view's image about a place, moved into the image, that the detector is shown larger
/// by a factor.
fn part_at(v: usize, view: &View, place: Point2<f64>, factor: f64) -> Part {
    let whole = &view.letterbox;
    let image = [view.camera.width(), view.camera.height()];
    let scale = factor * whole.su.max(whole.sv);
    let side = |net: u32, image: u32| ((f64::from(net) / scale).floor() as u32).clamp(1, image);
    let size = [
        side(whole.net_width, image[0]),
        side(whole.net_height, image[1]),
    ];
    let half = Vector2::from(size).map(f64::from) / 2.0;
    let corner = place - half;
    let start = |axis: usize| (corner[axis].max(0.0) as u32).min(image[axis] - size[axis]);
    Part {
        view: v,
        left: start(0),
        top: start(1),
        letterbox: Letterbox::new(size[0], size[1], whole.net_width, whole.net_height),
    }
}

/// Shows parts to the detector, and adds what it finds there to the boxes of the views.
fn add(
    network: &dyn Network,
    bundle: &Bundle,
    views: &[View],
    parts: Vec<Part>,
    boxes: &mut [Vec<Detection>],
) -> Result<()> {
    if parts.is_empty() {
        return Ok(());
    }
    let input = &bundle.input;
    let shape = (parts.len(), 3, input.height as usize, input.width as usize);
    let mut tensor = Array4::zeros(shape);
    for (part, shown) in parts.iter().zip(tensor.axis_iter_mut(Axis(0))) {
        let Letterbox { width, height, .. } = part.letterbox;
        let image = crop_imm(views[part.view].image, part.left, part.top, width, height);
        let image = image.to_image();
        fill(shown, &image, &part.letterbox, input.mean, input.std)?;
    }
    let maps = network.detect(tensor.view())?;
    maps.check(
        parts.len(),
        bundle.classes.len(),
        bundle.detector.faintest(),
    )?;
    for (index, part) in parts.iter().enumerate() {
        let view = &views[part.view];
        let found = sightings::boxes(bundle, &maps, index).into_iter();
        let in_image = found.filter_map(|one| {
            let bbox = part.in_image(view, one.bbox)?;
            Some(Detection { bbox, ..one })
        });
        boxes[part.view].extend(in_image);
    }
    let nms_iou = f64::from(bundle.detector.nms_iou);
    for of_view in boxes {
        *of_view = merged(std::mem::take(of_view), nms_iou);
    }
    Ok(())
}

impl Part {
    /// A box of the detector's input in the view's image; `None` of what may be cut off.
    fn in_image(&self, view: &View, bbox: BBox) -> Option<BBox> {
        let Letterbox { width, height, .. } = self.letterbox;
        let (left, top) = (f64::from(self.left), f64::from(self.top));
        let in_part = self.letterbox.image_box(bbox);
        let [right, bottom] = [self.left + width, self.top + height];
        let margin = BORDER / self.letterbox.su.max(self.letterbox.sv);
        let cut = (self.left > 0 && in_part.x0 < margin)
            || (self.top > 0 && in_part.y0 < margin)
            || (right < view.camera.width() && in_part.x1 > f64::from(width) - margin)
            || (bottom < view.camera.height() && in_part.y1 > f64::from(height) - margin);
        let moved = BBox {
            x0: in_part.x0 + left,
            y0: in_part.y0 + top,
            x1: in_part.x1 + left,
            y1: in_part.y1 + top,
        };
        let clipped = moved.clip(view.camera.width(), view.camera.height());
        clipped.filter(|_| !cut)
    }
}
