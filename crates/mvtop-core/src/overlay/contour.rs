//! The outline of a mesh at a pose, through the camera's true lens.

use std::collections::HashMap;

use nalgebra::{Isometry3, Point2};
use tiny_skia::{FillRule, Mask, Path, PathBuilder, Transform};

use crate::mesh::Mesh;
use crate::{BBox, Camera};

/// Triangles that are filled at once: tiny-skia takes long for paths of very many edges.
const CHUNK: usize = 256;
/// Coverage of a pixel from which on it belongs to the object, of 255. Where two chunks meet within
/// the object, it is 0.63 or more.
const INSIDE: u8 = 128;
/// Points nearer than this to the line through their neighbours are left out, px.
const TOLERANCE_PX: f64 = 0.3;

/// Closed lines around what a camera sees of a mesh: its outline and the rims of its holes.
///
/// Triangles that the lens does not image are left out. Lines run beyond the image where the object
/// does, by `margin` at most.
///
/// - `cam_from_obj`: object frame to camera frame, metres
/// - `margin`: px
/// - returns: px of the camera's image
pub fn outline(
    mesh: &Mesh,
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    margin: f64,
) -> Vec<Vec<Point2<f64>>> {
    let pixel = |point| camera.intrinsics().project(&(cam_from_obj * point));
    let pixels: Vec<Option<Point2<f64>>> = mesh.vertices().iter().map(pixel).collect();
    let Some(all) = BBox::around(pixels.iter().copied().filter(Option::is_some)) else {
        return Vec::new();
    };
    // One pixel of background on each side, so that lines are closed.
    let [width, height] = [camera.width(), camera.height()].map(f64::from);
    let (left, top) = (
        all.x0.max(-margin).floor() - 2.0,
        all.y0.max(-margin).floor() - 2.0,
    );
    let right = all.x1.min(width + margin).ceil() + 2.0;
    let bottom = all.y1.min(height + margin).ceil() + 2.0;
    if !(right > left && bottom > top) {
        return Vec::new();
    }
    let size = [(right - left) as usize + 1, (bottom - top) as usize + 1];
    let corner = Point2::new(left, top);
    let Some(coverage) = coverage(mesh, &pixels, corner, size) else {
        return Vec::new();
    };
    let mut lines = lines_at(&coverage, size[0]);
    for line in &mut lines {
        *line = simplified(line);
        line.iter_mut().for_each(|point| *point += corner.coords);
    }
    lines.retain(|line| line.len() > 2);
    lines
}

/// How much of each pixel the triangles cover, of 255, row by row; the rim stays empty.
fn coverage(
    mesh: &Mesh,
    pixels: &[Option<Point2<f64>>],
    corner: Point2<f64>,
    [width, height]: [usize; 2],
) -> Option<Vec<u8>> {
    let mut mask = Mask::new(width as u32, height as u32)?;
    for triangles in mesh.triangles().chunks(CHUNK) {
        if let Some(path) = path(triangles, pixels, corner) {
            mask.fill_path(&path, FillRule::Winding, true, Transform::identity());
        }
    }
    let mut coverage = mask.take();
    coverage[..width].fill(0);
    coverage[width * (height - 1)..].fill(0);
    for row in coverage.chunks_exact_mut(width) {
        (row[0], row[width - 1]) = (0, 0);
    }
    Some(coverage)
}

/// Triangles, all turning the same way, so that they do not cancel each other.
fn path(
    triangles: &[[u32; 3]],
    pixels: &[Option<Point2<f64>>],
    corner: Point2<f64>,
) -> Option<Path> {
    let mut path = PathBuilder::new();
    for triangle in triangles {
        let [Some(a), Some(b), Some(c)] = triangle.map(|vertex| pixels[vertex as usize]) else {
            continue;
        };
        let turns_left = (b - a).perp(&(c - a)) < 0.0;
        let (b, c) = if turns_left { (c, b) } else { (b, c) };
        // The middle of a pixel is half a pixel from its corner.
        let [a, b, c] = [a, b, c].map(|p| (p - corner).cast::<f32>().add_scalar(0.5));
        path.move_to(a.x, a.y);
        path.line_to(b.x, b.y);
        path.line_to(c.x, c.y);
        path.close();
    }
    path.finish()
}

/// A border between two neighbouring pixels: the first one's index, and whether the other one is
/// below instead of to the right.
type Border = (usize, bool);

/// Closed lines where values pass [`INSIDE`] (marching squares), between pixel centers.
fn lines_at(values: &[u8], width: usize) -> Vec<Vec<Point2<f64>>> {
    let is_in = |index: usize| values[index] >= INSIDE;
    let mut next: HashMap<Border, Border> = HashMap::new();
    let mut starts = Vec::new();
    for row in 0..values.len() / width - 1 {
        for column in 0..width - 1 {
            let at = row * width + column;
            let inside = [at, at + 1, at + width + 1, at + width].map(is_in);
            let [a, b, c, d] = inside;
            if a == b && b == c && c == d {
                continue;
            }
            // Sides of the square of four pixels: top, right, bottom, left.
            let sides = [(at, false), (at + 1, true), (at + width, false), (at, true)];
            // A line leaves through the side where the inside ends, going round clockwise.
            for (i, &leaves) in sides.iter().enumerate() {
                if inside[i] && !inside[(i + 1) % 4] {
                    let enters = (1..4).map(|step| (i + 4 - step) % 4);
                    let enters = enters
                        .into_iter()
                        .find(|&j| !inside[j] && inside[(j + 1) % 4]);
                    if let Some(enters) = enters {
                        next.insert(leaves, sides[enters]);
                        starts.push(leaves);
                    }
                }
            }
        }
    }
    let place = |(index, below): Border| {
        let other = index + if below { width } else { 1 };
        let [from, to] = [index, other].map(|i| f64::from(values[i]));
        let share = (f64::from(INSIDE) - 0.5 - from) / (to - from);
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        match below {
            true => Point2::new(x, y + share),
            false => Point2::new(x + share, y),
        }
    };
    let mut lines = Vec::new();
    for start in starts {
        let mut line = Vec::new();
        let mut at = start;
        while let Some(following) = next.remove(&at) {
            line.push(place(at));
            at = following;
        }
        if !line.is_empty() {
            lines.push(line);
        }
    }
    lines
}

/// A closed line without points that are within a tolerance of it (Douglas-Peucker).
fn simplified(line: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut kept = vec![false; line.len()];
    let middle = line.len() / 2;
    let mut open = vec![(0, middle), (middle, line.len() - 1)];
    while let Some((first, last)) = open.pop() {
        (kept[first], kept[last]) = (true, true);
        let between = first + 1..last;
        let along = line[last] - line[first];
        let distance = |index: usize| {
            let from = line[index] - line[first];
            match along.try_normalize(1e-9) {
                Some(along) => along.perp(&from).abs(),
                None => from.norm(),
            }
        };
        let farthest = between.max_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        if let Some(farthest) = farthest.filter(|&index| distance(index) > TOLERANCE_PX) {
            open.extend([(first, farthest), (farthest, last)]);
        }
    }
    let kept = line.iter().zip(&kept).filter(|(_, kept)| **kept);
    kept.map(|(point, _)| *point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Intrinsics, Projection};
    use nalgebra::Point3;

    fn camera() -> Camera {
        let pinhole = Intrinsics::new(500., 500., 320., 240., Projection::Pinhole).unwrap();
        Camera::new("left", [640, 480], pinhole, Isometry3::identity()).unwrap()
    }

    /// Squares of the plane z = 0 about the origin, as corners and two triangles each.
    fn squares(half_sides: &[f64]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let corners = |h: &f64| [[-h, -h], [*h, -h], [*h, *h], [-h, *h]];
        let vertices = half_sides.iter().flat_map(corners);
        let vertices = vertices.map(|[x, y]| Point3::new(x, y, 0.0)).collect();
        let first = (0..half_sides.len() as u32).map(|square| 4 * square);
        // Wound differently.
        let triangles = first.flat_map(|i| [[i, i + 1, i + 2], [i, i + 3, i + 2]]);
        (vertices, triangles.collect())
    }

    fn of(vertices: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>, z: f64) -> Vec<Vec<Point2<f64>>> {
        let mesh = Mesh::new(vertices, Vec::new(), triangles).unwrap();
        outline(&mesh, &camera(), &Isometry3::translation(0.0, 0.0, z), 4.0)
    }

    #[test]
    fn outline_of_a_square_is_where_its_sides_are() {
        // 0.1 m at 1 m and 500 px: 50 px to each side of the middle.
        let (vertices, triangles) = squares(&[0.1]);
        let [line] = &of(vertices, triangles, 1.0)[..] else {
            panic!("expected one line");
        };
        assert!(line.len() < 16, "{line:?}");
        for point in line {
            let off = point - Point2::new(320.0, 240.0);
            assert!((off.amax() - 50.0).abs() < 0.3, "{point}");
        }
    }

    #[test]
    fn hole_has_a_line_of_its_own() {
        let (mut vertices, _) = squares(&[0.1, 0.04]);
        vertices.truncate(8);
        let ring = (0..4).flat_map(|i| {
            let next = (i + 1) % 4;
            [[i, next, 4 + i], [next, 4 + next, 4 + i]]
        });
        let lines = of(vertices, ring.collect(), 1.0);
        let mut reach: Vec<f64> = lines
            .iter()
            .map(|line| {
                let off = line.iter().map(|p| (p - Point2::new(320.0, 240.0)).amax());
                off.fold(0.0, f64::max)
            })
            .collect();
        reach.sort_by(f64::total_cmp);
        assert_eq!(reach.len(), 2);
        assert!((reach[0] - 20.0).abs() < 0.6 && (reach[1] - 50.0).abs() < 0.6);
    }

    #[test]
    fn meshes_of_many_triangles_have_no_seams() {
        // A grid of 40 x 40 squares: several chunks.
        let at = |i: u32| 0.2 * f64::from(i) / 40.0 - 0.1;
        let vertices = (0..41 * 41).map(|i| Point3::new(at(i % 41), at(i / 41), 0.0));
        let cells = (0..40 * 40).map(|i| i / 40 * 41 + i % 40);
        let triangles = cells.flat_map(|i| [[i, i + 1, i + 41], [i + 1, i + 42, i + 41]]);
        assert_eq!(of(vertices.collect(), triangles.collect(), 1.0).len(), 1);
    }

    #[test]
    fn what_is_not_imaged_has_no_outline() {
        let (vertices, triangles) = squares(&[0.1]);
        assert!(of(vertices.clone(), triangles.clone(), -1.0).is_empty());
        let mesh = Mesh::new(vertices, Vec::new(), triangles).unwrap();
        let beside = Isometry3::translation(5.0, 0.0, 1.0);
        assert!(outline(&mesh, &camera(), &beside, 4.0).is_empty());
    }

    #[test]
    fn outline_of_an_object_larger_than_the_image_runs_outside_of_it() {
        let (vertices, triangles) = squares(&[10.0]);
        let [line] = &of(vertices, triangles, 1.0)[..] else {
            panic!("expected one line");
        };
        let inside = |p: &Point2<f64>| (0.0..640.0).contains(&p.x) && (0.0..480.0).contains(&p.y);
        assert!(!line.iter().any(inside));
    }
}
