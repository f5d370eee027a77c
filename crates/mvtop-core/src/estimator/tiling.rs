//! Tiled detection in large images.
//!
//! The detector sees whole images scaled down to its input. In large images, small objects shrink below
//! what it finds (some 35 px of its input). So it is shown magnified tiles: where one view has a box and
//! another one has none, the place where the other should show it; and all of the images where no view
//! has a box.

use image::imageops::crop_imm;
use nalgebra::{Point2, Vector2};
use ndarray::{Array4, Axis};

use super::instance::Instance;
use super::pipeline::Pipeline;
use super::view::View;
use super::{Estimator, detections};
use crate::associate::LineOfSight;
use crate::bundle::{Bundle, Input};
use crate::detect::{Detection, merged};
use crate::image::{Letterbox, Pyramid, fill};
use crate::network::Network;
use crate::{BBox, Result};

/// A tile of a view's image, px.
struct Tile {
    view: usize,
    left: u32,
    top: u32,
    letterbox: Letterbox,
}

/// Adds the boxes found in tiles to those of the views, `[V][boxes]`, px of the images.
///
/// Where another view expects an object, only those of the classes that are asked for are looked for.
pub fn detect(pipeline: &Pipeline, boxes: &mut [Vec<Detection>]) -> Result<()> {
    let Pipeline { network, views, .. } = pipeline;
    let Estimator { bundle, radii, .. } = pipeline.estimator;
    let config = pipeline.config();
    let tiling = &config.tiling;
    let is_large = |view: &View| scale(view) < tiling.min_scale;
    if !views.iter().any(is_large) {
        return Ok(());
    }
    let mut found = detections::detected(bundle, &config.association, radii, views, boxes);
    if found.is_empty() {
        let everywhere = views.iter().enumerate().filter(|(_, view)| is_large(view));
        let tiles = everywhere
            .flat_map(|(v, view)| all_of(v, view, &bundle.input, tiling.full_zoom))
            .collect();
        add(*network, bundle, views, tiles, boxes)?;
        found = detections::detected(bundle, &config.association, radii, views, boxes);
    }
    let places = found
        .iter()
        .filter(|object| object.views() == 1 && pipeline.wanted.has_class(object.class))
        .take(config.search.max_instances)
        .flat_map(|object| guided(radii, views, object, &bundle.input, tiling.guided_zoom))
        .filter(|tile| is_large(&views[tile.view]));
    add(*network, bundle, views, places.collect(), boxes)
}

/// Pixels of the detector's input for each pixel of a view's image.
fn scale(view: &View) -> f64 {
    view.letterbox.su.max(view.letterbox.sv)
}

/// Four tiles that cover a view's image, fewer where it is much longer than the detector's input.
fn all_of(v: usize, view: &View, input: &Input, zoom: f64) -> Vec<Tile> {
    let [width, height] = [view.camera.width(), view.camera.height()].map(f64::from);
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    let mut tiles: Vec<Tile> = Vec::new();
    for (u, v_px) in corners {
        let tile = tile_at(v, view, Point2::new(u, v_px), input, zoom);
        let known = |known: &Tile| (known.left, known.top) == (tile.left, tile.top);
        if !tiles.iter().any(known) {
            tiles.push(tile);
        }
    }
    tiles
}

/// Of an object that one view has found, the tiles of the other views that should show it.
fn guided<'a>(
    radii: &'a [[f64; 2]],
    views: &'a [View<'a>],
    object: &'a Instance,
    input: &'a Input,
    zoom: f64,
) -> impl Iterator<Item = Tile> + 'a {
    let mut seen = views.iter().zip(&object.detections);
    let line =
        seen.find_map(|(view, bbox)| LineOfSight::new(object.class, view.camera, (*bbox)?.bbox));
    let others = views.iter().enumerate().zip(&object.detections);
    others.filter_map(move |((v, view), bbox)| {
        if bbox.is_some() {
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
        inside.then(|| tile_at(v, view, place, input, zoom))
    })
}

/// The tile of a view's image about a place, moved into the image, that the detector is shown larger
/// by a factor.
fn tile_at(v: usize, view: &View, place: Point2<f64>, input: &Input, factor: f64) -> Tile {
    let image = [view.camera.width(), view.camera.height()];
    let scale = factor * scale(view);
    let side = |net: u32, image: u32| ((f64::from(net) / scale).floor() as u32).clamp(1, image);
    let size = [side(input.width, image[0]), side(input.height, image[1])];
    let half = Vector2::from(size).map(f64::from) / 2.0;
    let corner = place - half;
    let start = |axis: usize| (corner[axis].max(0.0) as u32).min(image[axis] - size[axis]);
    Tile {
        view: v,
        left: start(0),
        top: start(1),
        letterbox: Letterbox::new(size[0], size[1], input.width, input.height),
    }
}

/// Shows tiles to the detector, and adds what it finds there to the boxes of the views.
fn add(
    network: &dyn Network,
    bundle: &Bundle,
    views: &[View],
    tiles: Vec<Tile>,
    boxes: &mut [Vec<Detection>],
) -> Result<()> {
    if tiles.is_empty() {
        return Ok(());
    }
    let input = &bundle.input;
    let shape = (tiles.len(), 3, input.height as usize, input.width as usize);
    let mut tensor = Array4::zeros(shape);
    for (tile, shown) in tiles.iter().zip(tensor.axis_iter_mut(Axis(0))) {
        let Letterbox { width, height, .. } = tile.letterbox;
        let image = crop_imm(
            views[tile.view].image.image(),
            tile.left,
            tile.top,
            width,
            height,
        );
        let image = image.to_image();
        fill(
            shown,
            &Pyramid::new(&image),
            &tile.letterbox,
            input.mean,
            input.std,
        )?;
    }
    let maps = network.detect(tensor.view())?;
    maps.check(
        tiles.len(),
        bundle.classes.len(),
        bundle.detector.faintest(),
    )?;
    for (index, tile) in tiles.iter().enumerate() {
        let view = &views[tile.view];
        let found = detections::boxes(bundle, &maps, index).into_iter();
        let in_image = found.filter_map(|one| {
            let bbox = tile.in_image(view, one.bbox)?;
            Some(Detection { bbox, ..one })
        });
        boxes[tile.view].extend(in_image);
    }
    let nms_iou = f64::from(bundle.detector.nms_iou);
    for of_view in boxes {
        *of_view = merged(std::mem::take(of_view), nms_iou);
    }
    Ok(())
}

impl Tile {
    /// A box of the detector's input in the view's image; `None` of what may be cut off.
    fn in_image(&self, view: &View, bbox: BBox) -> Option<BBox> {
        let Letterbox { width, height, .. } = self.letterbox;
        let (left, top) = (f64::from(self.left), f64::from(self.top));
        let in_tile = self.letterbox.image_box(bbox);
        let [right, bottom] = [self.left + width, self.top + height];
        // One pixel of the detector's input: boxes that end in its outermost ones may be cut off.
        let margin = 1.0 / self.letterbox.su.max(self.letterbox.sv);
        let cut = (self.left > 0 && in_tile.x0 < margin)
            || (self.top > 0 && in_tile.y0 < margin)
            || (right < view.camera.width() && in_tile.x1 > f64::from(width) - margin)
            || (bottom < view.camera.height() && in_tile.y1 > f64::from(height) - margin);
        let moved = BBox {
            x0: in_tile.x0 + left,
            y0: in_tile.y0 + top,
            x1: in_tile.x1 + left,
            y1: in_tile.y1 + top,
        };
        let clipped = moved.clip(view.camera.width(), view.camera.height());
        clipped.filter(|_| !cut)
    }
}
