//! Which points lie near a place, in time that does not depend on how many there are in all.

use std::collections::HashMap;

use nalgebra::Vector3;

/// Ends a chain of points.
const END: u32 = u32::MAX;

/// Points in the cells of a cubic grid.
///
/// A grid, not a k-d tree: many poses of a split may be exactly the same, and such points cannot be
/// split along an axis.
pub struct Grid {
    cell: f64,
    /// The first point of each cell that has any.
    first: HashMap<[i64; 3], u32>,
    /// The point after each one in its cell.
    next: Vec<u32>,
}

impl Grid {
    /// - `points`: finite; fewer than 2^32
    /// - `cell`: side of a cell in the points' unit
    pub fn new(points: impl ExactSizeIterator<Item = Vector3<f64>>, cell: f64) -> Self {
        let points: Vec<_> = points.collect();
        let mut grid = Self {
            cell,
            first: HashMap::with_capacity(points.len()),
            next: vec![END; points.len()],
        };
        // From the last to the first, so that chains are in the points' order.
        for (i, point) in points.iter().enumerate().rev() {
            let key = [0, 1, 2].map(|axis| grid.index(point[axis]));
            if let Some(after) = grid.first.insert(key, i as u32) {
                grid.next[i] = after;
            }
        }
        grid
    }

    /// Every point within `radius` of `center`, and others near it.
    pub fn near(&self, center: Vector3<f64>, radius: f64) -> impl Iterator<Item = usize> {
        // The caller rounds distances; a point on the rim must not be lost to that.
        let radius = radius * (1.0 + 1e-9);
        let [xs, ys, zs] = [0, 1, 2]
            .map(|axis| self.index(center[axis] - radius)..=self.index(center[axis] + radius));
        let cells = xs.flat_map(move |x| {
            let zs = zs.clone();
            ys.clone()
                .flat_map(move |y| zs.clone().map(move |z| [x, y, z]))
        });
        cells.flat_map(move |key| {
            let first = self.first.get(&key).copied();
            let after = move |&i: &u32| Some(self.next[i as usize]).filter(|&i| i != END);
            std::iter::successors(first, after).map(|i| i as usize)
        })
    }

    fn index(&self, coordinate: f64) -> i64 {
        (coordinate / self.cell).floor() as i64
    }
}
