//! Where taps read a feature map: for [`LANES`] of them at once, the four cells about each location
//! and the share that each has.

use std::array::from_fn;

use super::Level;

/// Taps that are looked up together.
pub const LANES: usize = 8;

pub type Lanes<T> = [T; LANES];

/// The levels that a group of taps reads.
#[derive(Clone)]
pub struct Group {
    pub x: Extent,
    pub y: Extent,
    /// Cells from one row to the next.
    row: Lanes<u32>,
    first_cell: Lanes<u32>,
}

impl Default for Group {
    fn default() -> Self {
        Self {
            x: Extent::default(),
            y: Extent::default(),
            row: [1; LANES],
            first_cell: [0; LANES],
        }
    }
}

/// How long one axis of each lane's level is.
#[derive(Clone)]
pub struct Extent {
    /// In cells.
    length: Lanes<f32>,
    /// The greatest first one of two neighboring cells; 0 where there is but one.
    last: Lanes<f32>,
    /// From a cell to the next; 0 where there is but one.
    step: Lanes<u32>,
    /// 1, or 0 where there is no second cell.
    second: Lanes<f32>,
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            length: [1.0; LANES],
            last: [0.0; LANES],
            step: [0; LANES],
            second: [0.0; LANES],
        }
    }
}

impl Group {
    /// The level that a lane's tap reads.
    pub fn set(&mut self, lane: usize, level: &Level) {
        self.x.set(lane, level.width);
        self.y.set(lane, level.height);
        self.row[lane] = level.width as u32;
        self.first_cell[lane] = level.first_cell as u32;
    }
}

impl Extent {
    fn set(&mut self, lane: usize, cells: usize) {
        let several = cells > 1;
        self.length[lane] = cells as f32;
        self.last[lane] = cells.saturating_sub(2) as f32;
        self.step[lane] = several.into();
        self.second[lane] = if several { 1.0 } else { 0.0 };
    }
}

/// Linear interpolation along one axis between two neighboring cells, the nearest ones within the
/// map: each has a share of 1 at its center that falls to 0 at its neighbors', also beyond the map.
/// Both shares are 0 for locations that are farther off or not finite.
#[derive(Clone, Default)]
pub struct Axis {
    cells: [Lanes<u32>; 2],
    pub shares: [Lanes<f32>; 2],
    /// How far right of the first cell's center, in cells; exact, unlike that of the second.
    beyond: Lanes<f32>,
}

impl Axis {
    /// - `locations`: 0 to 1 over the axis
    #[inline(always)]
    fn at(locations: &Lanes<f32>, extent: &Extent) -> Self {
        // Without a branch or a bool, which the vectoriser would tear lanes apart for.
        // Comparisons with NaN are false: such a location reads the first cell, with share 0.
        let places: Lanes<f32> = from_fn(|i| locations[i] * extent.length[i] - 0.5);
        let positive = |x: f32| if x > 0.0 { x } else { 0.0 };
        let least = |x: f32, most: f32| if x < most { x } else { most };
        let first: Lanes<f32> = from_fn(|i| least(positive(places[i].floor()), extent.last[i]));
        // SAFETY: from 0 to `last`, which is below 2^24.
        let cells: Lanes<u32> = from_fn(|i| unsafe { first[i].to_int_unchecked::<i32>() as u32 });
        let beyond: Lanes<f32> = from_fn(|i| places[i] - first[i]);
        Self {
            cells: [cells, from_fn(|i| cells[i] + extent.step[i])],
            shares: [
                from_fn(|i| positive(1.0 - beyond[i].abs())),
                from_fn(|i| positive(1.0 - (beyond[i] - 1.0).abs()) * extent.second[i]),
            ],
            beyond,
        }
    }

    /// How fast the shares grow with the location.
    #[inline(always)]
    pub fn slopes(&self, extent: &Extent) -> [Lanes<f32>; 2] {
        let one = |yes: bool| if yes { 1.0 } else { 0.0 };
        let mut slopes = [[0.0; LANES]; 2];
        for (i, &beyond) in self.beyond.iter().enumerate() {
            let left = one((-1.0..0.0).contains(&beyond));
            let between = one((0.0..1.0).contains(&beyond));
            let right = one((1.0..2.0).contains(&beyond));
            slopes[0][i] = extent.length[i] * (left - between);
            slopes[1][i] = extent.length[i] * (between - right) * extent.second[i];
        }
        slopes
    }
}

/// Where a group of taps reads, in the order (y0, x0), (y0, x1), (y1, x0), (y1, x1).
#[derive(Clone, Default)]
pub struct Footprints {
    pub x: Axis,
    pub y: Axis,
    pub cells: [Lanes<u32>; 4],
}

impl Footprints {
    /// - `locations`: `[taps, 2]`, at most [`LANES`]
    #[inline(always)]
    pub fn new(group: &Group, locations: &[f32]) -> Self {
        let pairs: [f32; 2 * LANES] = filled_up(locations);
        let (x, y) = (from_fn(|i| pairs[2 * i]), from_fn(|i| pairs[2 * i + 1]));
        let (x, y) = (Axis::at(&x, &group.x), Axis::at(&y, &group.y));
        let mut cells = [[0; LANES]; 4];
        for (corner, cells) in cells.iter_mut().enumerate() {
            let (rows, columns) = (&y.cells[corner / 2], &x.cells[corner % 2]);
            for (i, cell) in cells.iter_mut().enumerate() {
                *cell = group.first_cell[i] + rows[i] * group.row[i] + columns[i];
            }
        }
        Self { x, y, cells }
    }

    /// `along_y` times `along_x`, for each corner.
    #[inline(always)]
    pub fn product(along_y: &[Lanes<f32>; 2], along_x: &[Lanes<f32>; 2]) -> [Lanes<f32>; 4] {
        let mut product = [[0.0; LANES]; 4];
        for (corner, product) in product.iter_mut().enumerate() {
            for i in 0..LANES {
                product[i] = along_y[corner / 2][i] * along_x[corner % 2][i];
            }
        }
        product
    }
}

/// Numbers, at most `N`, and zeros after them. Whole groups are read without a loop.
#[inline(always)]
pub fn filled_up<const N: usize>(numbers: &[f32]) -> [f32; N] {
    match numbers.first_chunk() {
        Some(whole) => *whole,
        None => from_fn(|i| numbers.get(i).copied().unwrap_or(0.0)),
    }
}
