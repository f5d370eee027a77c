//! Sum of the distances from all moved points of an object to the nearest unmoved one, which is
//! what ADD-S asks for.
//!
//! A k-d tree whose leaves are blocks of points. As the points that ask are the same that are asked
//! for, a whole block of them walks the tree together: neighbours in space have their nearest
//! points in the same leaves, and distances are computed a block by a block, with vector
//! instructions. Asking a library's k-d tree for one point after the other was not fast enough,
//! least of all for poses that are far off, where every search visits many leaves.

use nalgebra::{Isometry3, Point3};

use super::kernel::{Affine, larger, smaller};
use mvtop_core::dispatch;

/// Points in a leaf.
const BLOCK: usize = 16;

type Lanes = [f64; BLOCK];

/// A leaf's points; unused places repeat its last point.
#[derive(Debug, Clone)]
struct Block {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    count: usize,
}

/// In preorder: what follows an inner node is its first child.
#[derive(Debug, Clone)]
struct Node {
    /// Corners of the box around the node's points.
    low: [f64; 3],
    high: [f64; 3],
    next: Next,
}

#[derive(Debug, Clone, Copy)]
enum Next {
    /// Index of the second child.
    Inner(usize),
    /// Index of the block.
    Leaf(usize),
}

/// The tree, of at least one point.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    depth: usize,
}

/// What one block of asking points knows so far.
struct Asking {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    /// Least squared distances.
    best: Lanes,
    /// Greatest of them: how far it is worth looking.
    worst: f64,
    /// Corners of the box around the points.
    low: [f64; 3],
    high: [f64; 3],
}

impl Tree {
    /// - `points`: at least one
    pub fn new(points: &[Point3<f64>]) -> Self {
        let mut tree = Self {
            nodes: Vec::new(),
            blocks: Vec::new(),
            depth: 0,
        };
        tree.grow(&mut points.to_vec(), 1);
        tree
    }

    fn grow(&mut self, points: &mut [Point3<f64>], depth: usize) {
        self.depth = self.depth.max(depth);
        let corner = |pick: fn(f64, f64) -> f64| {
            let axis = |i: usize| points.iter().map(|p| p[i]).reduce(pick).unwrap_or(0.0);
            [axis(0), axis(1), axis(2)]
        };
        let (low, high) = (corner(f64::min), corner(f64::max));
        let here = self.nodes.len();
        let next = Next::Leaf(self.blocks.len());
        self.nodes.push(Node { low, high, next });
        if points.len() <= BLOCK {
            self.blocks.push(Block::new(points));
            return;
        }
        let extent = |&i: &usize| high[i] - low[i];
        let widest = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b)));
        let axis = widest.unwrap_or(0);
        // Cut at a multiple of the block's size, so that all leaves but the last are full.
        let half = (points.len() / 2).next_multiple_of(BLOCK);
        points.select_nth_unstable_by(half, |a, b| a[axis].total_cmp(&b[axis]));
        let (first, second) = points.split_at_mut(half);
        self.grow(first, depth + 1);
        self.nodes[here].next = Next::Inner(self.nodes.len());
        self.grow(second, depth + 1);
    }

    /// Sum over all points p of the distance of `motion * p` to the nearest point.
    pub fn sum_of_distances(&self, motion: &Isometry3<f64>) -> f64 {
        sum_of_distances(self, &Affine::new(motion))
    }
}

fn sum_of_distances(tree: &Tree, motion: &Affine) -> f64 {
    dispatch!(
        ["avx512f", "avx2"],
        sum_of_distances_portable(tree: &Tree, motion: &Affine) -> f64
    )
}

#[inline(always)]
fn sum_of_distances_portable(tree: &Tree, motion: &Affine) -> f64 {
    let mut stack = Vec::with_capacity(tree.depth + 1);
    let mut sum = 0.0;
    for (own, block) in tree.blocks.iter().enumerate() {
        let mut asking = Asking::new(block, motion);
        // Of a pose that is not far off, the nearest points are among those asking.
        asking.compare(block);
        stack.clear();
        stack.push((0, 0.0));
        while let Some((at, least)) = stack.pop() {
            // Nor where it is as far: of many points in one place, one is enough.
            if least >= asking.worst {
                continue;
            }
            match tree.nodes[at].next {
                Next::Leaf(leaf) if leaf == own => {}
                Next::Leaf(leaf) => asking.compare(&tree.blocks[leaf]),
                Next::Inner(second) => {
                    let one = (at + 1, asking.least_squared(&tree.nodes[at + 1]));
                    let two = (second, asking.least_squared(&tree.nodes[second]));
                    // The nearer one is looked at first, as it may spare the other.
                    stack.extend(if one.1 <= two.1 {
                        [two, one]
                    } else {
                        [one, two]
                    });
                }
            }
        }
        let distances = asking.best[..block.count].iter().map(|d| d.sqrt());
        sum += distances.sum::<f64>();
    }
    sum
}

impl Block {
    fn new(points: &[Point3<f64>]) -> Self {
        let lanes = |axis: usize| std::array::from_fn(|i| points[i.min(points.len() - 1)][axis]);
        Self {
            x: lanes(0),
            y: lanes(1),
            z: lanes(2),
            count: points.len(),
        }
    }
}

impl Asking {
    #[inline(always)]
    fn new(block: &Block, motion: &Affine) -> Self {
        let mut asking = Self {
            x: [0.0; BLOCK],
            y: [0.0; BLOCK],
            z: [0.0; BLOCK],
            best: [f64::INFINITY; BLOCK],
            worst: f64::INFINITY,
            low: [0.0; 3],
            high: [0.0; 3],
        };
        for i in 0..BLOCK {
            let [x, y, z] = motion.apply(block.x[i], block.y[i], block.z[i]);
            (asking.x[i], asking.y[i], asking.z[i]) = (x, y, z);
        }
        for (i, axis) in [&asking.x, &asking.y, &asking.z].into_iter().enumerate() {
            asking.low[i] = axis.iter().copied().fold(f64::INFINITY, smaller);
            asking.high[i] = axis.iter().copied().fold(f64::NEG_INFINITY, larger);
        }
        asking
    }

    /// No asking point is nearer to a point of the node than this, squared.
    #[inline(always)]
    fn least_squared(&self, node: &Node) -> f64 {
        let mut squared = 0.0;
        for i in 0..3 {
            let apart = larger(node.low[i] - self.high[i], self.low[i] - node.high[i]);
            let apart = larger(apart, 0.0);
            squared += apart * apart;
        }
        squared
    }

    #[inline(always)]
    fn compare(&mut self, leaf: &Block) {
        let mut best = self.best;
        for i in 0..BLOCK {
            let (x, y, z) = (leaf.x[i], leaf.y[i], leaf.z[i]);
            for (lane, best) in best.iter_mut().enumerate() {
                let (dx, dy, dz) = (self.x[lane] - x, self.y[lane] - y, self.z[lane] - z);
                let squared = dx * dx + dy * dy + dz * dz;
                *best = smaller(*best, squared);
            }
        }
        self.best = best;
        self.worst = best.into_iter().fold(0.0, larger);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn brute(points: &[Point3<f64>], motion: &Isometry3<f64>) -> f64 {
        let nearest = |p: &Point3<f64>| {
            let asked = motion * p;
            points
                .iter()
                .map(|q| (q - asked).norm())
                .fold(f64::INFINITY, f64::min)
        };
        points.iter().map(nearest).sum()
    }

    #[test]
    fn many_points_in_one_place_take_no_longer_than_others() {
        let points = vec![Point3::new(0.01, 0.02, -0.03); 200_000];
        let tree = Tree::new(&points);
        let start = std::time::Instant::now();
        for shift in [0.0, 0.3] {
            let motion = Isometry3::translation(shift, 0.0, 0.0);
            let sum = tree.sum_of_distances(&motion);
            assert!((sum / 200_000.0 - shift).abs() < 1e-9, "{sum}");
        }
        // Each with each, it would be 80 billion distances.
        assert!(start.elapsed().as_secs() < 5, "{:?}", start.elapsed());
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        // Coarse ones coincide, in a point or on an axis.
        prop_oneof![-50.0..50.0, (-2i8..3).prop_map(f64::from)]
    }

    proptest! {
        #[test]
        fn tree_finds_what_comparing_all_points_finds(
            points in prop::collection::vec([coordinate(), coordinate(), coordinate()], 1..200),
            shift in [-100.0..100.0, -5.0..5.0, -5.0..5.0],
            turn in [-3.0..3.0, -3.0..3.0, -3.0..3.0],
        ) {
            let points: Vec<Point3<f64>> = points.into_iter().map(Point3::from).collect();
            let motion = Isometry3::new(Vector3::from(shift), Vector3::from(turn));
            let expected = brute(&points, &motion);
            let found = Tree::new(&points).sum_of_distances(&motion);
            prop_assert!((found - expected).abs() <= 1e-9 * (1.0 + expected));
        }
    }
}
