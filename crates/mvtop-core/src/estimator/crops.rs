//! What poses are found in: crops of objects, encoded by the network.

use std::ops::Range;

use ndarray::{Array, Array2, Array3, Array4, ArrayView, Axis, RemoveAxis, concatenate};

use super::view::View;
use crate::bundle::Bundle;
use crate::camera::Camera;
use crate::closeup::CloseUp;
use crate::network::Network;
use crate::parallel;
use crate::{BBox, Error, Result};

/// Crops that go through the network at once: bounds the memory.
const BATCH: usize = 32;
/// Index of the trust among a cell's object coordinates.
pub const TRUST: usize = 3;

/// A crop of an image, as the network is shown it.
pub struct Crop {
    /// Index of the view that it is of.
    pub view: usize,
    /// The virtual camera that takes it.
    pub camera: Camera,
    /// Where its feature cells look, in the camera's frame, `[N, 3]`.
    pub camera_rays: Array2<f32>,
}

/// Crops, and the network's features of them.
pub struct Crops {
    pub list: Vec<Crop>,
    pub features: Features,
}

/// What the network makes of crops, in their order.
pub enum Features {
    /// `[P, N, C]`, for the decoder.
    Memory(Array3<f32>),
    /// `[P, 4, h, w]`, see [`Network::coordinates`]; not to be trusted off the image.
    Coordinates(Array4<f32>),
}

/// The crops of one object.
pub struct Group {
    /// Of the list, in the rig's order.
    pub crops: Range<usize>,
    /// The object's index among all objects.
    pub object: usize,
    /// Index into the bundle's classes.
    pub class: usize,
    /// In each of the crops, px of these.
    pub boxes: Vec<BBox>,
}

impl Crop {
    /// Center and half size of a box, as shares of the crop.
    pub fn relative(&self, bbox: BBox) -> ([f64; 2], [f64; 2]) {
        let size = [self.camera.width(), self.camera.height()].map(f64::from);
        let center = bbox.center();
        (
            [(center.x + 0.5) / size[0], (center.y + 0.5) / size[1]],
            [bbox.width() / 2.0 / size[0], bbox.height() / 2.0 / size[1]],
        )
    }
}

/// Crops that are to be taken of an object; at least one.
pub struct CropRequest<'a> {
    /// Its index among all objects.
    pub object: usize,
    /// Index into the bundle's classes.
    pub class: usize,
    /// By index of the view.
    pub taken: Vec<(usize, &'a View<'a>, CloseUp)>,
}

impl<'a> CropRequest<'a> {
    /// Crops of boxes, px of each image.
    pub fn boxes(
        bundle: &Bundle,
        views: &'a [View],
        object: usize,
        class: usize,
        boxes: &[Option<BBox>],
    ) -> Result<Self> {
        let size = bundle.closeups.size;
        let each = views.iter().enumerate().zip(boxes);
        let crop = |((index, view), bbox): ((usize, &'a View<'a>), &Option<BBox>)| {
            Some((index, view, CloseUp::new(view.camera, (*bbox)?, size)?))
        };
        let taken: Vec<_> = each.filter_map(crop).collect();
        if taken.is_empty() {
            let name = &bundle.classes[class].name;
            return Err(Error::Input(format!(
                "box of `{name}`: expected one that spans less than half the view around, give a \
                 smaller one"
            )));
        }
        Ok(Self {
            object,
            class,
            taken,
        })
    }
}

/// Takes crops and encodes them; the crops of each request are a group.
pub fn encoded(
    network: &dyn Network,
    bundle: &Bundle,
    requests: Vec<CropRequest>,
) -> Result<(Crops, Vec<Group>)> {
    let mut taken: Vec<(usize, &View, CloseUp)> = Vec::new();
    let mut groups = Vec::new();
    for request in requests {
        let start = taken.len();
        taken.extend(request.taken);
        let boxes = taken[start..].iter().map(|(.., closeup)| closeup.bbox);
        groups.push(Group {
            crops: start..taken.len(),
            object: request.object,
            class: request.class,
            boxes: boxes.collect(),
        });
    }

    let (closeups, has_coordinates) = (&bundle.closeups, bundle.has_coordinates());
    let crop = |(index, view, closeup): &(usize, &View, CloseUp)| Crop {
        view: *index,
        camera: closeup.camera.clone(),
        camera_rays: match has_coordinates {
            true => Array2::zeros((0, 3)),
            false => closeup.camera_rays(view.camera, &closeups.strides),
        },
    };
    let list: Vec<Crop> = taken.iter().map(crop).collect();
    let batches = || taken.chunks(BATCH).zip(list.chunks(BATCH));
    let tensor = |taken: &[(usize, &View, CloseUp)]| {
        let (side, mean, std) = (closeups.size as usize, bundle.input.mean, bundle.input.std);
        let mut tensor = Array4::zeros((taken.len(), 3, side, side));
        let pictures = taken.iter().zip(tensor.outer_iter_mut()).collect();
        parallel::each(pictures, |((_, view, closeup), pixels)| {
            closeup.fill(pixels, view.camera, &view.image, mean, std);
        });
        tensor
    };
    let features = if has_coordinates {
        let of_batch = |(taken, _)| on_images(network.coordinates(tensor(taken).view())?, taken);
        Features::Coordinates(joined("coordinates", batches().map(of_batch))?)
    } else {
        let of_batch = |(taken, list): (_, &[Crop])| {
            let encoded = network.encode(tensor(taken).view(), rays(list).view())?;
            checked(encoded, list.len())
        };
        Features::Memory(joined("memory", batches().map(of_batch))?)
    };
    Ok((Crops { list, features }, groups))
}

/// Batches one after the other; empty without batches.
fn joined<D: RemoveAxis>(
    name: &'static str,
    batches: impl Iterator<Item = Result<Array<f32, D>>>,
) -> Result<Array<f32, D>> {
    let batches = batches.collect::<Result<Vec<_>>>()?;
    let Some(first) = batches.first() else {
        return Ok(Array::default(D::default()));
    };
    let views: Vec<ArrayView<f32, D>> = batches.iter().map(|batch| batch.view()).collect();
    concatenate(Axis(0), &views).map_err(|cause| Error::Shape {
        name,
        expected: format!("the same for all crops ({cause})"),
        got: first.shape().to_vec(),
    })
}

/// Center of a row's cell `n` of `cells`, px of a picture of `side` px.
pub fn cell_center(n: usize, cells: usize, side: u32) -> f64 {
    (n as f64 + 0.5) * f64::from(side) / cells as f64 - 0.5
}

/// The cell in whose column (or row) a pixel lies, of so many; `None` off the image.
pub fn cell_at(pixel: f64, cells: usize, side: u32) -> Option<usize> {
    let cell = ((pixel + 0.5) * cells as f64 / f64::from(side)).floor();
    (0.0..cells as f64).contains(&cell).then_some(cell as usize)
}

/// The coordinates, without trust where a cell's center is off the real image.
fn on_images(mut codes: Array4<f32>, taken: &[(usize, &View, CloseUp)]) -> Result<Array4<f32>> {
    let (crops, axes, rows, columns) = codes.dim();
    if crops != taken.len() || axes != 4 || rows == 0 || rows != columns {
        return Err(Error::Shape {
            name: "coordinates",
            expected: format!("[{}, 4, h, h]", taken.len()),
            got: codes.shape().to_vec(),
        });
    }
    for ((_, view, closeup), mut codes) in taken.iter().zip(codes.outer_iter_mut()) {
        let center = |cell| cell_center(cell, columns, closeup.camera.width());
        for row in 0..rows {
            for column in 0..columns {
                if !closeup.shows(view.camera, center(column), center(row)) {
                    codes[(TRUST, row, column)] = 0.0;
                }
            }
        }
    }
    Ok(codes)
}

/// Rays of some crops, `[P, N, 3]`.
fn rays(crops: &[Crop]) -> Array3<f32> {
    let cells = crops.first().map_or(0, |p| p.camera_rays.nrows());
    let mut rays = Array3::zeros((crops.len(), cells, 3));
    for (crop, mut row) in crops.iter().zip(rays.outer_iter_mut()) {
        row.assign(&crop.camera_rays);
    }
    rays
}

/// Refuses a memory of another number of crops.
fn checked(memory: Array3<f32>, crops: usize) -> Result<Array3<f32>> {
    if memory.dim().0 == crops {
        return Ok(memory);
    }
    Err(Error::Shape {
        name: "memory",
        expected: format!("{crops} crops"),
        got: memory.shape().to_vec(),
    })
}
