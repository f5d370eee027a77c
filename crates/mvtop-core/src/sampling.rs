//! Deformable sampling: weighted bilinear reads of a multi-level feature map.
//!
//! For batch `b`, query `q`, head `h` and channel `d`, with `(x, y)` a sampling location,
//!
//! ```text
//! out[b, q, h, d] = Σ_{l,k} weights[b, q, h, l, k] · bilinear(value_l[b, :, h, d], x·W_l − ½, y·H_l − ½)
//! ```
//!
//! where locations run from 0 to 1 over the full extent of a level (not from center to center) and
//! cells outside the map read as zero. A location that is not finite contributes nothing.
//!
//! Source: Zhu et al., "Deformable DETR", ICLR 2021, eq. 3.

use crate::{Error, Result};
use ndarray::{Array3, ArrayView, ArrayView4, ArrayView5, ArrayView6, Dimension};
use rayon::prelude::*;
use std::ops::Range;

mod kernel;
mod places;

/// Enough work to hide the cost of scheduling a block.
const QUERIES_PER_BLOCK: usize = 64;

/// Heights and widths of the feature levels, finest first, concatenated row-major into N cells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LevelShapes {
    levels: Vec<Level>,
    cells: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Level {
    first_cell: usize,
    height: usize,
    width: usize,
}

impl LevelShapes {
    /// Levels from their `(height, width)`, in cells.
    ///
    /// # Errors
    /// [`Error::Shape`] when a level is empty or the cells do not fit `usize`.
    pub fn new(shapes: &[(usize, usize)]) -> Result<Self> {
        let mut levels = Vec::with_capacity(shapes.len());
        let mut cells = 0usize;
        for &(height, width) in shapes {
            // Cell indices are computed in i32 and coordinates in f32: both are exact below 2^24.
            let sides = [height, width];
            if sides.iter().any(|side| !(1..1 << 24).contains(side)) {
                return Err(shape_error("level", "1 to 2^24 - 1 cells a side", &sides));
            }
            levels.push(Level {
                first_cell: cells,
                height,
                width,
            });
            cells = height
                .checked_mul(width)
                .and_then(|n| n.checked_add(cells))
                .filter(|&n| n <= 1 << 31) // kept in u32 by the kernel
                .ok_or_else(|| shape_error("levels", "fewer cells", &sides))?;
        }
        Ok(Self { levels, cells })
    }

    /// Number of cells N of all levels together.
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// Number of levels L.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// Whether there is no level.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }
}

/// The axis lengths of a sampling problem that the levels do not fix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dims {
    /// B, independent problems.
    pub batch: usize,
    /// H, attention heads.
    pub heads: usize,
    /// D, channels of one head.
    pub head_dim: usize,
    /// Q, queries.
    pub queries: usize,
    /// K, points of one query, head and level.
    pub points: usize,
}

impl Dims {
    /// Of value, weights and locations.
    fn shapes(&self, levels: &LevelShapes) -> [Vec<usize>; 3] {
        let Self { batch, queries, .. } = *self;
        let taps = [batch, queries, self.heads, levels.len(), self.points];
        let value = vec![batch, levels.cells(), self.heads, self.head_dim];
        [value, taps.to_vec(), [&taps[..], &[2]].concat()]
    }

    /// Of the output, `[B, Q, H, D]`.
    fn output(&self) -> [usize; 4] {
        [self.batch, self.queries, self.heads, self.head_dim]
    }
}

/// One sampling problem over borrowed, contiguous arrays.
#[derive(Debug, Clone, Copy)]
pub struct Sampling<'a> {
    levels: &'a LevelShapes,
    dims: Dims,
    value: &'a [f32],
    locations: &'a [f32],
    weights: &'a [f32],
}

/// Gradients with respect to the inputs, in the inputs' layouts; what they held is overwritten.
#[derive(Debug)]
pub struct Gradients<'a> {
    /// `[B, N, H, D]`
    pub value: &'a mut [f32],
    /// `[B, Q, H, L, K, 2]`
    pub locations: &'a mut [f32],
    /// `[B, Q, H, L, K]`
    pub weights: &'a mut [f32],
}

/// A run of queries of one batch, and where their output goes.
#[derive(Debug)]
pub(crate) struct Block<'o> {
    batch: usize,
    queries: Range<usize>,
    out: &'o mut [f32],
}

impl<'a> Sampling<'a> {
    /// Checks that the arrays belong together.
    ///
    /// - `value`: `[B, N, H, D]`
    /// - `locations`: `[B, Q, H, L, K, 2]`, `(x, y)` from 0 to 1 over the level
    /// - `weights`: `[B, Q, H, L, K]`
    ///
    /// # Errors
    /// [`Error::Shape`] when an array has another length than its shape says, or the value has 2^32
    /// numbers or more in a batch.
    pub fn new(
        levels: &'a LevelShapes,
        dims: Dims,
        value: &'a [f32],
        locations: &'a [f32],
        weights: &'a [f32],
    ) -> Result<Self> {
        let [values, taps, places] = dims.shapes(levels);
        check_len("value", value.len(), &values)?;
        check_len("weights", weights.len(), &taps)?;
        check_len("locations", locations.len(), &places)?;
        check_len("output", 0, &[&[0], &dims.output()[..]].concat())?;
        if values[1..].iter().product::<usize>() > u32::MAX as usize {
            // The kernel keeps places in it in u32.
            return Err(shape_error("value", "fewer numbers of a batch", &values));
        }
        Ok(Self {
            levels,
            dims,
            value,
            locations,
            weights,
        })
    }

    /// The problem of arrays in standard layout.
    ///
    /// # Errors
    /// [`Error::Shape`] when an array has another layout, or the shapes do not belong together.
    pub fn of_arrays(
        levels: &'a LevelShapes,
        value: ArrayView4<'a, f32>,
        locations: ArrayView6<'a, f32>,
        weights: ArrayView5<'a, f32>,
    ) -> Result<Self> {
        let (batch, _, heads, head_dim) = value.dim();
        let (_, queries, _, _, points) = weights.dim();
        let dims = Dims {
            batch,
            heads,
            head_dim,
            queries,
            points,
        };
        let [values, taps, places] = dims.shapes(levels);
        let value = numbers("value", value, &values)?;
        let weights = numbers("weights", weights, &taps)?;
        let locations = numbers("locations", locations, &places)?;
        Self::new(levels, dims, value, locations, weights)
    }

    /// Length of the output.
    pub fn output_len(&self) -> usize {
        self.output_shape().iter().product()
    }

    /// Shape of the output `[B, Q, H·D]`.
    pub fn output_shape(&self) -> [usize; 3] {
        let [batch, queries, heads, head_dim] = self.dims.output();
        [batch, queries, heads * head_dim]
    }

    /// Samples in parallel over batches and blocks of queries, in rayon's current pool.
    ///
    /// - `out`: `[B, Q, H·D]`, overwritten
    ///
    /// # Errors
    /// [`Error::Shape`] when `out` has another length.
    pub fn forward(&self, out: &mut [f32]) -> Result<()> {
        let blocks = self.blocks(out)?.into_par_iter();
        blocks.for_each(|block| self.sample(block));
        Ok(())
    }

    /// Cuts the work into independent pieces, for a thread pool of the caller's choice; refuses an
    /// `out` that is not `[B, Q, H·D]`.
    pub(crate) fn blocks<'o>(&self, out: &'o mut [f32]) -> Result<Vec<Block<'o>>> {
        check_len("output", out.len(), &self.dims.output())?;
        let per_query = self.dims.heads * self.dims.head_dim;
        let mut blocks = Vec::new();
        if out.is_empty() {
            return Ok(blocks);
        }
        for (batch, out) in out.chunks_mut(self.dims.queries * per_query).enumerate() {
            for (i, out) in out.chunks_mut(QUERIES_PER_BLOCK * per_query).enumerate() {
                let first = i * QUERIES_PER_BLOCK;
                let queries = first..first + out.len() / per_query;
                blocks.push(Block {
                    batch,
                    queries,
                    out,
                });
            }
        }
        Ok(blocks)
    }

    /// Fills one block, which [`Sampling::blocks`] of the same problem has made.
    pub(crate) fn sample(&self, block: Block<'_>) {
        kernel::forward(&self.batch(block.batch, block.queries), block.out);
    }

    /// Back-propagates `grad_out`, in parallel over batches.
    ///
    /// One task owns the whole gradient of its batch, so the scatter into `gradients.value` needs
    /// no locks and adds in the same order whatever the number of threads.
    ///
    /// - `grad_out`: `[B, Q, H·D]`
    ///
    /// # Errors
    /// [`Error::Shape`] when a gradient has another length than what it belongs to.
    pub fn backward(&self, grad_out: &[f32], gradients: Gradients<'_>) -> Result<()> {
        check_len(
            "gradient of the output",
            grad_out.len(),
            &self.dims.output(),
        )?;
        for (name, gradient, of) in [
            ("gradient of value", &mut *gradients.value, self.value),
            ("gradient of locations", gradients.locations, self.locations),
            ("gradient of weights", gradients.weights, self.weights),
        ] {
            check_len(name, gradient.len(), &[of.len()])?;
            gradient.fill(0.0);
        }
        let batch = self.dims.batch.max(1);
        let per_batch = [grad_out.len(), self.value.len(), self.weights.len()].map(|n| n / batch);
        if per_batch.contains(&0) {
            return Ok(()); // An empty axis: every gradient is zero.
        }
        let [outputs, values, taps] = per_batch;
        grad_out
            .par_chunks(outputs)
            .zip(gradients.value.par_chunks_mut(values))
            .zip(gradients.locations.par_chunks_mut(2 * taps))
            .zip(gradients.weights.par_chunks_mut(taps))
            .enumerate()
            .for_each(|(batch, (((grad_out, value), locations), weights))| {
                let gradients = Gradients {
                    value,
                    locations,
                    weights,
                };
                kernel::backward(
                    &self.batch(batch, 0..self.dims.queries),
                    grad_out,
                    gradients,
                );
            });
        Ok(())
    }

    /// The part of the inputs that some queries of one batch read.
    fn batch(&self, batch: usize, queries: Range<usize>) -> kernel::Job<'a> {
        let dims = self.dims;
        let values = self.levels.cells() * dims.heads * dims.head_dim;
        let taps = dims.heads * self.levels.len() * dims.points;
        let first = batch * dims.queries;
        let (from, to) = ((first + queries.start) * taps, (first + queries.end) * taps);
        kernel::Job {
            levels: &self.levels.levels,
            heads: dims.heads,
            head_dim: dims.head_dim,
            points: dims.points,
            value: &self.value[batch * values..(batch + 1) * values],
            locations: &self.locations[2 * from..2 * to],
            weights: &self.weights[from..to],
        }
    }
}

/// Samples `value` at `locations`; see the module for the definition.
///
/// - `value`: `[B, N, H, D]`
/// - `locations`: `[B, Q, H, L, K, 2]`, `(x, y)` from 0 to 1 over the level
/// - `weights`: `[B, Q, H, L, K]`
/// - `levels`: `(height, width)` of each level, in cells
/// - returns: `[B, Q, H·D]`
///
/// # Errors
/// [`Error::Shape`] when the shapes do not belong together.
pub fn deformable_sampling(
    value: ArrayView4<f32>,
    locations: ArrayView6<f32>,
    weights: ArrayView5<f32>,
    levels: &[(usize, usize)],
) -> Result<Array3<f32>> {
    let levels = LevelShapes::new(levels)?;
    let (value, locations) = (value.as_standard_layout(), locations.as_standard_layout());
    let weights = weights.as_standard_layout();
    let sampling = Sampling::of_arrays(&levels, value.view(), locations.view(), weights.view())?;
    let mut out = vec![0.0; sampling.output_len()];
    sampling.forward(&mut out)?;
    Array3::from_shape_vec(sampling.output_shape(), out)
        .map_err(|_| shape_error("output", "contiguous numbers", &sampling.output_shape()))
}

/// The array's numbers, refused where it has another shape or layout.
fn numbers<'a, D: Dimension>(
    name: &'static str,
    array: ArrayView<'a, f32, D>,
    shape: &[usize],
) -> Result<&'a [f32]> {
    if array.shape() != shape {
        return Err(shape_error(name, format!("{shape:?}"), array.shape()));
    }
    let contiguous = array.to_slice();
    contiguous.ok_or_else(|| shape_error(name, "a contiguous array", shape))
}

fn check_len(name: &'static str, len: usize, shape: &[usize]) -> Result<()> {
    // Empty axes must not hide an overflow of the others, so they count as one here.
    let mut axes = shape.iter();
    let fits = axes.try_fold(1usize, |n, &axis| n.checked_mul(axis.max(1)));
    match fits.is_some() && len == shape.iter().product::<usize>() {
        true => Ok(()),
        false => Err(shape_error(
            name,
            format!("numbers of shape {shape:?}"),
            &[len],
        )),
    }
}

fn shape_error(name: &'static str, expected: impl Into<String>, got: &[usize]) -> Error {
    Error::Shape {
        name,
        expected: expected.into(),
        got: got.to_vec(),
    }
}

#[cfg(test)]
mod tests;
