//! Surfaces of objects as triangles.

mod ply;

use nalgebra::Point3;

pub use ply::load_ply;
pub(crate) use ply::load_ply_within;

use crate::{Error, Result};

/// A surface made of triangles, in the object's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    vertices: Vec<Point3<f64>>,
    colors: Vec<[u8; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// - `vertices`: metres
    /// - `colors`: R, G, B of each vertex, or none
    /// - `triangles`: indices of vertices; both sides are seen
    ///
    /// # Errors
    /// [`Error::Input`] where a vertex is not finite, a triangle names one that is not there, or the
    /// colors are not as many as the vertices.
    pub fn new(
        vertices: Vec<Point3<f64>>,
        colors: Vec<[u8; 3]>,
        triangles: Vec<[u32; 3]>,
    ) -> Result<Self> {
        let not_finite = |p: &Point3<f64>| p.iter().any(|x| !x.is_finite());
        if let Some(i) = vertices.iter().position(not_finite) {
            return Err(Error::Input(format!(
                "mesh: expected finite vertices, got {} for vertex {i}",
                vertices[i]
            )));
        }
        let count = vertices.len();
        let missing = |triangle: &[u32; 3]| triangle.iter().any(|&v| v as usize >= count);
        if let Some(i) = triangles.iter().position(missing) {
            return Err(Error::Input(format!(
                "mesh: expected triangles of the {count} vertices, counted from 0, got {:?} for \
                 triangle {i}",
                triangles[i]
            )));
        }
        if !colors.is_empty() && colors.len() != count {
            return Err(Error::Input(format!(
                "mesh: expected the color of each of the {count} vertices, or none, got {}",
                colors.len()
            )));
        }
        Ok(Self {
            vertices,
            colors,
            triangles,
        })
    }

    /// Object frame, metres.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// R, G, B of each vertex; empty where they are not known.
    pub fn colors(&self) -> &[[u8; 3]] {
        &self.colors
    }

    /// Indices of vertices.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }
}
