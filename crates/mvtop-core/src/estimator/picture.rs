//! What poses are decoded from: pictures of the objects, and the network's memory of them.

use std::ops::Range;

use ndarray::{Array, Array2, Array3, Array4, ArrayView, Axis, RemoveAxis, concatenate};

use super::sightings::Sighting;
use super::view::View;
use crate::bundle::{Bundle, CloseUps};
use crate::camera::Camera;
use crate::closeup::CloseUp;
use crate::image::Letterbox;
use crate::network::Network;
use crate::rays::camera_rays;
use crate::{BBox, Error, Result};

/// Close-ups that go through the network at once: bounds the memory.
const AT_ONCE: usize = 32;
/// Of a cell's coordinates, how far they can be trusted.
pub const TRUST: usize = 3;

/// What the network is shown: a whole image, or a close-up of it.
pub struct Picture {
    /// The camera that takes it: the real one, or the close-up's.
    pub camera: Camera,
    /// How it lies in the network's input.
    pub letterbox: Letterbox,
    /// Where its feature cells look, in the camera's frame, `[N, 3]`.
    pub camera_rays: Array2<f32>,
}

/// Pictures, and the network's memory of them.
pub struct Pictures {
    pub list: Vec<Picture>,
    /// `[P, N, C]`, in the order of the list.
    pub memory: Array3<f32>,
    /// `[P, 4, h, w]`, where the network gives them, see [`Encoded`]; not to be trusted off the image.
    pub coordinates: Option<Array4<f32>>,
}

impl Pictures {
    /// - `memory`: `[P, N, C]`, refused where it is of another number of pictures
    pub fn new(list: Vec<Picture>, memory: Array3<f32>) -> Result<Self> {
        let memory = checked(memory, list.len())?;
        Ok(Self {
            list,
            memory,
            coordinates: None,
        })
    }
}

/// Objects that the same pictures show. They are decoded together, for the decoder lets them attend
/// to each other.
pub struct Group {
    /// Of the list, in the rig's order.
    pub pictures: Range<usize>,
    pub objects: Vec<Query>,
}

/// An object to decode.
pub struct Query {
    /// Its index among all objects.
    pub object: usize,
    /// Index into the bundle's classes.
    pub class: usize,
    /// In each of the group's pictures; at least one is known.
    pub boxes: Vec<Option<BBox>>,
}

impl Picture {
    /// Center and half size of a box, as shares of the network's input.
    pub fn relative(&self, bbox: BBox) -> ([f64; 2], [f64; 2]) {
        let bbox = self.letterbox.net_box(bbox);
        let size = [self.letterbox.net_width, self.letterbox.net_height].map(f64::from);
        let center = bbox.center();
        (
            [(center.x + 0.5) / size[0], (center.y + 0.5) / size[1]],
            [bbox.width() / 2.0 / size[0], bbox.height() / 2.0 / size[1]],
        )
    }
}

/// The whole images.
///
/// - `strides`: of the feature levels
pub fn whole_images(views: &[View], strides: &[usize]) -> Vec<Picture> {
    let picture = |view: &View| Picture {
        camera: view.camera.clone(),
        letterbox: view.letterbox.clone(),
        camera_rays: camera_rays(view.camera, &view.letterbox, strides),
    };
    views.iter().map(picture).collect()
}

/// All objects as one group, which all views show.
pub fn in_whole_images(views: &[View], objects: &[Sighting]) -> Vec<Group> {
    let query = |(object, seen): (usize, &Sighting)| Query {
        object,
        class: seen.class,
        boxes: seen.boxes.clone(),
    };
    vec![Group {
        pictures: 0..views.len(),
        objects: objects.iter().enumerate().map(query).collect(),
    }]
}

/// Close-ups of an object, at least one, and the views that they are taken of.
pub struct CloseUpsOf<'a> {
    /// Index into the bundle's classes.
    pub class: usize,
    pub taken: Vec<(&'a View<'a>, CloseUp)>,
}

impl<'a> CloseUpsOf<'a> {
    /// Those of its boxes.
    ///
    /// - `size`: of the pictures, px
    pub fn boxes(bundle: &Bundle, views: &'a [View], seen: &Sighting, size: u32) -> Result<Self> {
        let each = views.iter().zip(&seen.boxes);
        let taken: Vec<_> = each
            .filter_map(|(view, bbox)| Some((view, CloseUp::new(view.camera, (*bbox)?, size)?)))
            .collect();
        if taken.is_empty() {
            let name = &bundle.classes[seen.class].name;
            return Err(Error::Input(format!(
                "box of `{name}`: expected one that spans less than half the view around, give a \
                 smaller one"
            )));
        }
        let class = seen.class;
        Ok(Self { class, taken })
    }
}

/// The close-ups of some objects, and the network's memory of them: each object is a group of its own.
pub fn in_closeups(
    network: &dyn Network,
    bundle: &Bundle,
    closeups: &CloseUps,
    objects: Vec<CloseUpsOf>,
) -> Result<(Pictures, Vec<Group>)> {
    let mut taken: Vec<(&View, CloseUp)> = Vec::new();
    let mut groups = Vec::new();
    for (object, seen) in objects.into_iter().enumerate() {
        let start = taken.len();
        taken.extend(seen.taken);
        let boxes = taken[start..].iter().map(|(_, closeup)| Some(closeup.bbox));
        groups.push(Group {
            pictures: start..taken.len(),
            objects: vec![Query {
                object,
                class: seen.class,
                boxes: boxes.collect(),
            }],
        });
    }

    let picture = |(view, closeup): &(&View, CloseUp)| Picture {
        camera: closeup.camera.clone(),
        letterbox: closeup.letterbox(),
        camera_rays: closeup.camera_rays(view.camera, &closeups.strides),
    };
    let list: Vec<Picture> = taken.iter().map(picture).collect();
    let (side, mean, std) = (closeups.size as usize, bundle.input.mean, bundle.input.std);
    let (mut memory, mut coordinates) = (Vec::new(), Vec::new());
    for (taken, list) in taken.chunks(AT_ONCE).zip(list.chunks(AT_ONCE)) {
        let mut tensor = Array4::zeros((taken.len(), 3, side, side));
        for ((view, closeup), picture) in taken.iter().zip(tensor.outer_iter_mut()) {
            closeup.fill(picture, view.camera, view.image, mean, std);
        }
        let encoded = network.encode(tensor.view(), rays(list).view())?;
        memory.push(checked(encoded.memory, list.len())?);
        if let Some(codes) = encoded.coordinates {
            coordinates.push(on_images(codes, taken)?);
        }
    }
    let coordinates = joined("coordinates", &coordinates)?;
    let memory = joined("memory", &memory)?.unwrap_or_default();
    let pictures = Pictures {
        list,
        memory,
        coordinates,
    };
    Ok((pictures, groups))
}

/// Parts one after the other; `None` without parts.
fn joined<D: RemoveAxis>(
    name: &'static str,
    parts: &[Array<f32, D>],
) -> Result<Option<Array<f32, D>>> {
    let views: Vec<ArrayView<f32, D>> = parts.iter().map(|part| part.view()).collect();
    let unlike = |cause| Error::Shape {
        name,
        expected: format!("alike for all close-ups ({cause})"),
        got: parts[0].shape().to_vec(),
    };
    let joined = (!views.is_empty()).then(|| concatenate(Axis(0), &views).map_err(unlike));
    joined.transpose()
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
fn on_images(mut codes: Array4<f32>, taken: &[(&View, CloseUp)]) -> Result<Array4<f32>> {
    let (pictures, axes, rows, columns) = codes.dim();
    if pictures != taken.len() || axes != 4 || rows == 0 || rows != columns {
        return Err(Error::Shape {
            name: "coordinates",
            expected: format!("[{}, 4, h, h]", taken.len()),
            got: codes.shape().to_vec(),
        });
    }
    for ((view, closeup), mut codes) in taken.iter().zip(codes.outer_iter_mut()) {
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

/// Rays of some pictures, `[P, N, 3]`.
pub fn rays(pictures: &[Picture]) -> Array3<f32> {
    let cells = pictures.first().map_or(0, |p| p.camera_rays.nrows());
    let mut rays = Array3::zeros((pictures.len(), cells, 3));
    for (picture, mut row) in pictures.iter().zip(rays.outer_iter_mut()) {
        row.assign(&picture.camera_rays);
    }
    rays
}

/// Refuses a memory of other pictures.
fn checked(memory: Array3<f32>, pictures: usize) -> Result<Array3<f32>> {
    if memory.dim().0 == pictures {
        return Ok(memory);
    }
    Err(Error::Shape {
        name: "memory",
        expected: format!("{pictures} pictures"),
        got: memory.shape().to_vec(),
    })
}
