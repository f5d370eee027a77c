//! Visible edges of a mesh in a crop, sampled at contour points.

use nalgebra::{Point2, Point3, Vector2};

use super::RefineConfig;
use super::mesh_model::{BACKGROUND, MeshEdge, MeshModel};
use super::raster::{ProjectedVertex, Raster};

/// A point of a visible edge.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Px of the crop.
    pub pixel: Point2<f64>,
    /// Unit vector across the edge, outwards.
    pub normal: Vector2<f64>,
    /// Crop's frame, metres.
    pub point: Point3<f64>,
    /// Segments on the inner and the outer side.
    pub sides: [u8; 2],
}

impl EdgePoint {
    /// Whether its sides are different segments, so that regions locate it.
    pub fn separates_segments(&self) -> bool {
        self.sides[0] != self.sides[1]
    }

    /// Whether it belongs to the object's outline.
    pub fn is_outline(&self) -> bool {
        self.sides[1] == BACKGROUND
    }
}

/// An edge of the mesh in a crop.
struct ProjectedEdge {
    ends: [ProjectedVertex; 2],
    normal: Vector2<f64>,
    length: f64,
    /// Whether both of its triangles lie on one side of it.
    is_fold: bool,
}

/// Writes points spread evenly over the visible edges to `points`, whose memory is reused.
pub fn sample_edges(
    mesh: &MeshModel,
    raster: &Raster,
    diameter: f64,
    config: &RefineConfig,
    points: &mut Vec<EdgePoint>,
) {
    points.clear();
    let edges = mesh.edges.iter().filter_map(|edge| projected(edge, raster));
    let edges: Vec<ProjectedEdge> = edges.collect();
    let at = |edge: &ProjectedEdge, share| edge_point(edge, share, raster, diameter, config);
    // An edge counts towards the visible length if its middle is visible.
    let visible = edges.iter().filter(|edge| at(edge, 0.5).is_some());
    let length: f64 = visible.map(|edge| edge.length).sum();
    let step = (length / config.contour_points).max(config.contour_margin_px);
    let mut next = step / 2.0;
    for edge in &edges {
        while next < edge.length {
            points.extend(at(edge, next / edge.length));
            next += step;
        }
        next -= edge.length;
    }
}

/// An edge that may be visible: a fold of the surface, or a marked edge.
fn projected(edge: &MeshEdge, raster: &Raster) -> Option<ProjectedEdge> {
    let [a, b] = edge.ends.map(|v| raster.vertices[v as usize]);
    let along = b.pixel - a.pixel;
    let length = along.norm();
    if length < 1e-6 {
        return None;
    }
    let normal = Vector2::new(along.y, -along.x) / length;
    let side = |v: u32| (raster.vertices[v as usize].pixel - a.pixel).dot(&normal);
    let [one, other] = edge.across.map(side);
    let is_fold = (one < 0.0) == (other < 0.0);
    (is_fold || edge.marked).then(|| ProjectedEdge {
        ends: [a, b],
        normal: if one < 0.0 { normal } else { -normal },
        length,
        is_fold,
    })
}

/// The point at a share of an edge's length; `None` if it is occluded.
fn edge_point(
    edge: &ProjectedEdge,
    share: f64,
    raster: &Raster,
    diameter: f64,
    config: &RefineConfig,
) -> Option<EdgePoint> {
    let [a, b] = edge.ends;
    let pixel = a.pixel + (b.pixel - a.pixel) * share;
    // Interpolation in the picture is linear in 1/z.
    let (near_a, near_b) = ((1.0 - share) / a.point.z, share / b.point.z);
    let point = (a.point.coords * near_a + b.point.coords * near_b) / (near_a + near_b);
    let margin = config.contour_margin_px;
    let inner = raster.index(pixel + edge.normal * -margin)?;
    let outer = raster.index(pixel + edge.normal * margin)?;
    let sides = [inner, outer].map(|index| raster.label(index));
    let nearest = raster.depth(inner).min(raster.depth(outer));
    // A fold bends towards the camera beside its edge.
    let [at_fold, elsewhere, _] = config.occlusion_tolerance;
    let tolerance = if edge.is_fold { at_fold } else { elsewhere };
    let hidden = point.z > nearest + tolerance * diameter;
    if sides[0] == BACKGROUND || (hidden && sides[1] != BACKGROUND) {
        return None;
    }
    Some(EdgePoint {
        pixel,
        normal: edge.normal,
        point: point.into(),
        sides,
    })
}
