//! A mesh, prepared for refinement: its edges, and the parts of it that have one color.

use std::collections::{HashMap, HashSet};

use nalgebra::{Point3, Vector3};

use crate::mesh::Mesh;

/// Angle between the normals of two triangles from which their edge is a crease, as a cosine: 30
/// degrees.
const CREASE: f64 = 0.866;
/// Colors that differ by less, of 255 in each channel, are one; shading is none in a mesh's colors.
const ONE_COLOR: f64 = 70.0;
/// Most colors of a mesh that is not textured.
const MOST_COLORS: usize = 4;

/// What a pixel shows that does not show the object.
pub const BACKGROUND: u8 = 0;

/// An edge between two triangles, or at the border of the surface.
pub struct Edge {
    /// Indices of vertices.
    pub ends: [u32; 2],
    /// The third vertex of the triangle on either side; the same one twice at a border.
    pub across: [u32; 2],
    /// Whether it may be seen though both of its triangles are: by its angle or its colors.
    pub marked: bool,
}

/// A mesh with its edges.
pub struct Part {
    /// Object frame, metres; no two in one place.
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
    /// Whether they close around something, their corners counterclockwise as seen from outside.
    pub closed: bool,
    /// Of each triangle: the part of one color that it belongs to, from 1 on.
    pub labels: Vec<u8>,
    /// Of each label, the background's included: shares of R, G and B in its brightness.
    pub tints: Vec<Vector3<f32>>,
    pub edges: Vec<Edge>,
    /// Middle of its box.
    pub center: Point3<f64>,
}

impl Part {
    pub fn new(mesh: &Mesh) -> Self {
        let (vertices, kept) = merged(mesh.vertices());
        let index = |triangle: &[u32; 3]| triangle.map(|v| kept[v as usize]);
        let (labels, tints) = labels(mesh);
        let triangles: Vec<[u32; 3]> = mesh.triangles().iter().map(index).collect();
        let closed = is_closed(&vertices, &triangles);
        let edges = edges(&vertices, &triangles, &labels);
        let extreme = |pick: fn(f64, f64) -> f64| {
            let all = vertices.iter().map(|v| v.coords);
            all.reduce(|a, b| a.zip_map(&b, pick)).unwrap_or_default()
        };
        let center = Point3::from((extreme(f64::min) + extreme(f64::max)) / 2.0);
        Self {
            vertices,
            triangles,
            closed,
            labels,
            tints,
            edges,
            center,
        }
    }
}

/// Vertices without those in the same place as another, and which of them each is now.
fn merged(vertices: &[Point3<f64>]) -> (Vec<Point3<f64>>, Vec<u32>) {
    let (mut all, mut known) = (Vec::new(), HashMap::new());
    let kept = vertices.iter().map(|vertex| {
        // Minus zero is zero.
        let place = vertex.coords.map(|x| (x + 0.0).to_bits());
        *known.entry(<[u64; 3]>::from(place)).or_insert_with(|| {
            all.push(*vertex);
            all.len() as u32 - 1
        })
    });
    let kept = kept.collect();
    (all, kept)
}

/// Whether each edge is passed through once in each direction, and what is within is to the left.
fn is_closed(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> bool {
    let mut passed = HashSet::new();
    let mut volume = 0.0;
    for &[a, b, c] in triangles {
        if ![[a, b], [b, c], [c, a]]
            .into_iter()
            .all(|edge| passed.insert(edge))
        {
            return false;
        }
        let [a, b, c] = [a, b, c].map(|v| vertices[v as usize].coords);
        volume += a.dot(&b.cross(&c));
    }
    volume > 0.0 && passed.iter().all(|&[a, b]| passed.contains(&[b, a]))
}

/// The label of each triangle, and the tint of each label: of a textured mesh or one without colors
/// all are one.
fn labels(mesh: &Mesh) -> (Vec<u8>, Vec<Vector3<f32>>) {
    let one = || (vec![1; mesh.triangles().len()], vec![Vector3::zeros(); 2]);
    if mesh.colors().is_empty() {
        return one();
    }
    let mut known = vec![Vector3::repeat(f64::INFINITY)]; // no color is like the background's
    let mut labels = Vec::new();
    for triangle in mesh.triangles() {
        let corners = triangle.map(|v| Vector3::from(mesh.colors()[v as usize]).map(f64::from));
        let color = (corners[0] + corners[1] + corners[2]) / 3.0;
        let like = known.iter().position(|c| (c - color).amax() < ONE_COLOR);
        let label = like.unwrap_or_else(|| {
            known.push(color);
            known.len() - 1
        });
        if label > MOST_COLORS {
            return one();
        }
        labels.push(label as u8);
    }
    known[0] = Vector3::zeros();
    let tint = |color: &Vector3<f64>| (color / color.sum().max(1.0)).cast();
    (labels, known.iter().map(tint).collect())
}

fn edges(vertices: &[Point3<f64>], triangles: &[[u32; 3]], labels: &[u8]) -> Vec<Edge> {
    let normal = |triangle: usize| {
        let [a, b, c] = triangles[triangle].map(|v| vertices[v as usize]);
        (b - a).cross(&(c - a)).normalize()
    };
    // The triangle that came first of each edge that has one so far, and its edge's place.
    let mut open: HashMap<[u32; 2], (usize, usize)> = HashMap::new();
    let mut edges: Vec<Edge> = Vec::new();
    for (index, triangle) in triangles.iter().enumerate() {
        for corner in 0..3 {
            let [a, b, across] = [0, 1, 2].map(|i| triangle[(corner + i) % 3]);
            if a == b || b == across || a == across {
                continue;
            }
            let ends = [a.min(b), a.max(b)];
            match open.remove(&ends) {
                None => {
                    open.insert(ends, (index, edges.len()));
                    edges.push(Edge {
                        ends,
                        across: [across; 2],
                        marked: true,
                    });
                }
                Some((other, edge)) => {
                    // Triangles may be wound either way: a sharp edge is one by its shape, too.
                    let bent = normal(index).dot(&normal(other)).abs() < CREASE;
                    edges[edge].across[1] = across;
                    edges[edge].marked = bent || labels[index] != labels[other];
                }
            }
        }
    }
    edges
}
