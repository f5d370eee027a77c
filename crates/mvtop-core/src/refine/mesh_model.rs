//! A mesh, prepared for refinement: its edges, and its segments of one color.

use std::collections::{HashMap, HashSet};

use nalgebra::{Point3, Vector3};

use super::RefineConfig;
use crate::mesh::Mesh;

/// Label of the background.
pub const BACKGROUND: u8 = 0;

/// An edge between two triangles, or at the border of the surface.
pub struct MeshEdge {
    /// Indices of vertices.
    pub ends: [u32; 2],
    /// The third vertex of the triangle on either side; the same one twice at a border.
    pub across: [u32; 2],
    /// Whether it is visible between two visible triangles: a border, a crease or a change of color.
    pub marked: bool,
}

/// A mesh with its edges and segments.
pub struct MeshModel {
    /// Object frame, metres; without duplicates.
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
    /// Whether they enclose a volume, with corners counterclockwise as seen from outside.
    pub closed: bool,
    /// Segment of each triangle, from 1 on.
    pub labels: Vec<u8>,
    /// Chromaticity of each segment, the background included: shares of R, G and B.
    pub chromaticities: Vec<Vector3<f32>>,
    pub edges: Vec<MeshEdge>,
    /// Middle of the bounding box.
    pub center: Point3<f64>,
}

impl MeshModel {
    pub fn new(mesh: &Mesh, config: &RefineConfig) -> Self {
        let (vertices, kept) = deduplicated(mesh.vertices());
        let index = |triangle: &[u32; 3]| triangle.map(|v| kept[v as usize]);
        let (labels, chromaticities) = segments(mesh, config.max_segments);
        let triangles: Vec<[u32; 3]> = mesh.triangles().iter().map(index).collect();
        let closed = is_closed(&vertices, &triangles);
        let crease = config.crease_deg.to_radians().cos();
        let edges = edges(&vertices, &triangles, &labels, crease);
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
            chromaticities,
            edges,
            center,
        }
    }
}

/// Vertices without duplicates, and the new index of each old one.
fn deduplicated(vertices: &[Point3<f64>]) -> (Vec<Point3<f64>>, Vec<u32>) {
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

/// Whether triangles pass each edge once in each direction, and enclose a positive volume.
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

/// Segment of each triangle, one for each color, and chromaticity of each segment. A mesh of more than
/// `most` colors is textured: it has one segment, as one without colors.
fn segments(mesh: &Mesh, most: usize) -> (Vec<u8>, Vec<Vector3<f32>>) {
    let one = || (vec![1; mesh.triangles().len()], vec![Vector3::zeros(); 2]);
    if mesh.colors().is_empty() {
        return one();
    }
    let mut known = vec![Vector3::repeat(f64::INFINITY)]; // the background, unlike any color
    let mut labels = Vec::new();
    for triangle in mesh.triangles() {
        let corners = triangle.map(|v| Vector3::from(mesh.colors()[v as usize]).map(f64::from));
        let color = (corners[0] + corners[1] + corners[2]) / 3.0;
        let same = known.iter().position(|c| *c == color);
        let label = same.unwrap_or_else(|| {
            known.push(color);
            known.len() - 1
        });
        if label > most {
            return one();
        }
        labels.push(label as u8);
    }
    known[0] = Vector3::zeros();
    let chromaticity = |color: &Vector3<f64>| (color / color.sum().max(1.0)).cast();
    (labels, known.iter().map(chromaticity).collect())
}

/// - `crease`: cosine of the least angle between the normals of two triangles at a crease
fn edges(
    vertices: &[Point3<f64>],
    triangles: &[[u32; 3]],
    labels: &[u8],
    crease: f64,
) -> Vec<MeshEdge> {
    let normal = |triangle: usize| {
        let [a, b, c] = triangles[triangle].map(|v| vertices[v as usize]);
        (b - a).cross(&(c - a)).normalize()
    };
    // First triangle and index of each edge that has one triangle so far.
    let mut open: HashMap<[u32; 2], (usize, usize)> = HashMap::new();
    let mut edges: Vec<MeshEdge> = Vec::new();
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
                    edges.push(MeshEdge {
                        ends,
                        across: [across; 2],
                        marked: true,
                    });
                }
                Some((other, edge)) => {
                    // Absolute, as triangles may be wound either way.
                    let bent = normal(index).dot(&normal(other)).abs() < crease;
                    edges[edge].across[1] = across;
                    edges[edge].marked = bent || labels[index] != labels[other];
                }
            }
        }
    }
    edges
}
