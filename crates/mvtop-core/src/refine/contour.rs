//! Where the edges of a part lie in a close-up, and which of them can be found again in the image.

use nalgebra::{Point2, Point3, Vector2};

use super::part::{BACKGROUND, Part};
use super::raster::{Raster, Seen};

/// Points on the edges of one view, about.
const POINTS: f64 = 220.0;
/// Least distance of two points, px.
const CLOSEST: f64 = 1.5;
/// How far beside an edge is looked which sides it has, px.
const BESIDE: f64 = 1.5;
/// How far behind what is seen beside it a point may lie and still count as seen, as a share of the
/// diameter: further where the surface folds over, as it bends towards the camera there.
const BEHIND: f64 = 0.03;
const BEHIND_FOLD: f64 = 0.1;

/// A point of an edge, and what lies to both sides of it.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Px.
    pub pixel: Point2<f64>,
    /// Unit vector across the edge, outwards.
    pub normal: Vector2<f64>,
    /// Close-up's frame, metres.
    pub point: Point3<f64>,
    /// Label of the side within and of the one outside; the same one twice where only a
    /// change of color can tell them apart.
    pub sides: [u8; 2],
}

impl EdgePoint {
    /// Whether regions tell its sides apart.
    pub fn parts_regions(&self) -> bool {
        self.sides[0] != self.sides[1]
    }

    /// Whether it is of the object's outline.
    pub fn is_outline(&self) -> bool {
        self.sides[1] == BACKGROUND
    }
}

/// An edge as it lies in the picture.
struct Segment {
    ends: [Seen; 2],
    normal: Vector2<f64>,
    length: f64,
    folds: bool,
}

/// Points spread evenly over the edges that can be seen, written to `points`.
///
/// - `segments`: memory that is used again
pub fn points(part: &Part, raster: &Raster, diameter: f64, points: &mut Vec<EdgePoint>) {
    points.clear();
    let segments: Vec<Segment> = part
        .edges
        .iter()
        .filter_map(|edge| segment(edge.ends, edge.across, edge.marked, raster))
        .collect();
    // First with every pixel, to know how many are seen.
    let seen: f64 = segments
        .iter()
        .filter_map(|segment| at(segment, 0.5, raster, diameter).map(|_| segment.length))
        .sum();
    let step = (seen / POINTS).max(CLOSEST);
    let mut next = step / 2.0;
    for segment in &segments {
        while next < segment.length {
            points.extend(at(segment, next / segment.length, raster, diameter));
            next += step;
        }
        next -= segment.length;
    }
}

/// An edge where it may be seen: where the surface folds over, or at marked ones.
fn segment(ends: [u32; 2], across: [u32; 2], marked: bool, raster: &Raster) -> Option<Segment> {
    let [a, b] = ends.map(|v| raster.seen[v as usize]);
    let along = b.pixel - a.pixel;
    let length = along.norm();
    if length < 1e-6 {
        return None;
    }
    let normal = Vector2::new(along.y, -along.x) / length;
    let side = |v: u32| (raster.seen[v as usize].pixel - a.pixel).dot(&normal);
    let [one, other] = across.map(side);
    let folds = (one < 0.0) == (other < 0.0);
    (folds || marked).then(|| Segment {
        ends: [a, b],
        normal: if one < 0.0 { normal } else { -normal },
        length,
        folds,
    })
}

/// The point at a share of a segment's length, where it is seen and its sides differ.
fn at(segment: &Segment, share: f64, raster: &Raster, diameter: f64) -> Option<EdgePoint> {
    let [a, b] = segment.ends;
    let pixel = a.pixel + (b.pixel - a.pixel) * share;
    // What lies evenly in the picture lies by 1/z on the edge.
    let (near_a, near_b) = ((1.0 - share) / a.point.z, share / b.point.z);
    let point = (a.point.coords * near_a + b.point.coords * near_b) / (near_a + near_b);
    let beside = |distance: f64| raster.index(pixel + segment.normal * distance);
    let (within, outside) = (beside(-BESIDE)?, beside(BESIDE)?);
    let sides = [within, outside].map(|index| raster.label(index));
    let depths = [within, outside].map(|index| raster.depth(index));
    let behind = if segment.folds { BEHIND_FOLD } else { BEHIND };
    let hidden = point.z > depths[0].min(depths[1]) + behind * diameter;
    if sides[0] == BACKGROUND || (hidden && sides[1] != BACKGROUND) {
        return None;
    }
    Some(EdgePoint {
        pixel,
        normal: segment.normal,
        point: point.into(),
        sides,
    })
}
