//! Close-ups of the objects, and what the network makes of them.

use std::cmp::Reverse;

use ndarray::{Array3, Axis, concatenate};

use super::sightings::Sighting;
use super::view::{self, Picture, View};
use crate::bundle::{Bundle, CloseUps};
use crate::network::Network;
use crate::{Error, Result};

/// Close-ups that go through the network at once: bounds the memory.
const AT_ONCE: usize = 32;

/// One object in close-up: by every view that sees it, its anchor first.
pub struct Seen {
    /// Index into the bundle's classes.
    pub class: usize,
    /// At least one.
    pub pictures: Vec<Picture>,
    /// Of each picture, px.
    pub boxes: Vec<[f64; 4]>,
}

/// The close-ups of all objects.
pub fn take(
    bundle: &Bundle,
    views: &[View],
    reference: usize,
    objects: &[Sighting],
    closeups: &CloseUps,
) -> Result<Vec<Seen>> {
    objects
        .iter()
        .map(|object| {
            let anchor = object.anchor(views, reference);
            let mut order: Vec<usize> = (0..views.len()).collect();
            order.sort_by_key(|&v| Reverse(Some(v) == anchor)); // stable: the others keep their order
            let (pictures, boxes): (Vec<_>, Vec<_>) = order
                .into_iter()
                .filter_map(|v| views[v].closeup(&bundle.input, closeups, object.boxes[v]?))
                .unzip();
            if pictures.is_empty() {
                let name = &bundle.classes[object.class].name;
                return Err(Error::Input(format!(
                    "box of `{name}`: expected one that spans less than half the view around, give \
                     a smaller one"
                )));
            }
            Ok(Seen {
                class: object.class,
                pictures,
                boxes,
            })
        })
        .collect()
}

/// Memory of the pictures of all objects, one after the other.
///
/// - returns: `[P, N, C]`
pub fn memory(network: &dyn Network, objects: &[Seen]) -> Result<Array3<f32>> {
    let pictures: Vec<&Picture> = objects.iter().flat_map(|object| &object.pictures).collect();
    let mut parts = Vec::new();
    for part in pictures.chunks(AT_ONCE) {
        let (tensor, rays) = view::stack(part);
        let memory = network.closeups(tensor, rays)?;
        if memory.dim().0 != part.len() {
            return Err(Error::Shape {
                name: "memory",
                expected: format!("{} close-ups", part.len()),
                got: memory.shape().to_vec(),
            });
        }
        parts.push(memory);
    }
    let parts: Vec<_> = parts.iter().map(|part| part.view()).collect();
    if parts.is_empty() {
        return Ok(Array3::zeros((0, 0, 0)));
    }
    concatenate(Axis(0), &parts).map_err(|cause| Error::Shape {
        name: "memory",
        expected: format!("alike for all close-ups ({cause})"),
        got: vec![],
    })
}
