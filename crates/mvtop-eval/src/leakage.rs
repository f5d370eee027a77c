//! Do poses of one split of a data set recur in another?
//!
//! A pose of split *a* **has a twin** in split *b* where *b* holds a pose of the same object whose
//! translation is within `Settings::within_mm`; the twin is the most alike of these. The pose
//! **recurs** where it and its twin differ by at most `Settings::limit`: ADD in percent of the
//! object's diameter, or the angle between the rotations in degrees where there are no models. So
//! poses that coincide in translation alone are counted, but not as recurring.
//!
//! Source: Ranftl et al., MVTOP, section 8, which found the training data of YCB-V to hold poses of
//! its test split. `docs/how-to/audit-leakage.md` says more.

mod grid;
mod shape;
mod split;

use std::collections::{BTreeMap, BTreeSet};
use std::iter::Sum;

use rayon::prelude::*;
use serde::Serialize;

use self::grid::Grid;
pub use self::shape::Shape;
pub use self::split::{Files, PoseRecord, Split};
use crate::bop::Model;
use crate::{Error, Result};

/// Bins of a [`Histogram`].
pub const BINS: usize = 10;

/// When a pose counts as recurring.
#[derive(Debug, Clone, Copy)]
pub struct Settings<'a> {
    /// Largest distance of two translations that count as the same, millimetres.
    pub within_mm: f64,
    /// Largest difference of poses that count as the same: percent of the diameter with models,
    /// degrees without.
    pub limit: f64,
    /// Of every object that both splits hold; without them, rotations are compared.
    pub models: Option<&'a BTreeMap<u32, Model>>,
}

/// How many poses of one split, compared with the other one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// All that it has.
    pub poses: u64,
    /// Have a twin in the other split: the same translation.
    pub same_translation: u64,
    /// Recur in the other split.
    pub recurring: u64,
    /// Recur elsewhere in their own split, which is no leak.
    pub repeated: u64,
}

/// Poses of split *a* by their difference to the most alike pose of *b*.
///
/// With models: ADD to the nearest of **all** poses of the object in *b*, as in the paper's figure,
/// in bins of 1 % of the diameter. Without: angle to the twin, in bins of 1 degree.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Histogram {
    /// Bin i holds differences d with i < d ≤ i + 1, the first one zero as well.
    pub bins: [u64; BINS],
    /// Poses with a larger difference, or with no pose to compare with.
    pub beyond: u64,
}

/// What was found of one object.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct ObjectLeakage {
    /// Number of the object.
    pub object_id: u32,
    /// Poses of split *a*.
    pub a: Counts,
    /// Poses of split *b*.
    pub b: Counts,
    /// Poses of split *a* by their difference.
    pub histogram: Histogram,
}

/// A recurring pose of *a* and its twin in *b*.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Number of the object.
    pub object_id: u32,
    /// Index into the object's poses in split *a*.
    pub a: usize,
    /// Index into the object's poses in split *b*.
    pub b: usize,
    /// Percent of the diameter with models, degrees without.
    pub difference: f64,
}

/// What was found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Leakage {
    /// Of every object that either split holds, by id.
    pub objects: Vec<ObjectLeakage>,
    /// One for each recurring pose of *a*, in the order of its poses.
    pub pairs: Vec<Pair>,
}

impl Leakage {
    /// Sums over all objects; the id is 0.
    pub fn total(&self) -> ObjectLeakage {
        ObjectLeakage {
            object_id: 0,
            a: self.objects.iter().map(|object| object.a).sum(),
            b: self.objects.iter().map(|object| object.b).sum(),
            histogram: self.objects.iter().map(|object| object.histogram).sum(),
        }
    }
}

/// The objects that both splits hold.
///
/// # Errors
/// [`Error::Input`] where there is none.
pub fn common_objects(a: &Split, b: &Split) -> Result<BTreeSet<u32>> {
    let ids = |split: &Split| split.objects.keys().copied().collect::<BTreeSet<u32>>();
    let (in_a, in_b) = (ids(a), ids(b));
    let common: BTreeSet<u32> = in_a.intersection(&in_b).copied().collect();
    if common.is_empty() {
        return Err(Error::Input(format!(
            "no object is in both splits: expected the same object ids, got {in_a:?} and {in_b:?}"
        )));
    }
    Ok(common)
}

/// Compares the poses of two splits, object by object, on all threads of rayon's pool.
///
/// # Errors
/// [`Error::Input`] where no object is in both splits, where one that is has no model, or where
/// `within_mm` is less than 1e-4.
pub fn leakage(a: &Split, b: &Split, settings: &Settings) -> Result<Leakage> {
    // Finer cells than that could not be numbered.
    if !(settings.within_mm >= 1e-4 && settings.within_mm.is_finite()) {
        return Err(Error::Input(format!(
            "distance of translations: expected at least 0.0001 mm, got {}",
            settings.within_mm
        )));
    }
    let common = common_objects(a, b)?;
    if let Some(models) = settings.models
        && let Some(id) = common.iter().find(|id| !models.contains_key(id))
    {
        return Err(Error::Input(format!(
            "models: expected one of each object in both splits, got none of object {id}; add it to \
             models_info.json"
        )));
    }
    let mut found = Leakage::default();
    let ids: BTreeSet<u32> = a.objects.keys().chain(b.objects.keys()).copied().collect();
    for id in ids {
        let model = settings.models.and_then(|models| models.get(&id));
        let compare = Compare {
            shape: model.map(Shape::new).transpose()?,
            settings,
        };
        let (object, pairs) = compare.object(id, a.poses_of(id), b.poses_of(id));
        found.objects.push(object);
        found.pairs.extend(pairs);
    }
    Ok(found)
}

/// Another pose and how much it differs.
#[derive(Clone, Copy)]
struct Twin {
    index: usize,
    difference: f64,
}

struct Compare<'a> {
    /// `None`, too, of an object that only one split holds: its repeats are told by rotation.
    shape: Option<Shape>,
    settings: &'a Settings<'a>,
}

impl Compare<'_> {
    fn object(
        &self,
        object_id: u32,
        a: &[PoseRecord],
        b: &[PoseRecord],
    ) -> (ObjectLeakage, Vec<Pair>) {
        // Larger than what is searched, so that few searches leave their cell.
        let cell = 8.0 * self.settings.within_mm;
        let grid = |poses: &[PoseRecord]| Grid::new(poses.iter().map(|p| p.translation_mm), cell);
        let (grid_a, grid_b) = (grid(a), grid(b));
        let twins = |from: &[PoseRecord], to: &[PoseRecord], grid: &Grid| -> Vec<Option<Twin>> {
            let twin = |pose| self.twin(pose, to, grid, None);
            from.par_iter().map(twin).collect()
        };
        let repeated = |poses: &[PoseRecord], grid: &Grid| {
            let own = |(i, pose)| self.twin(pose, poses, grid, Some(i));
            let twins = poses.par_iter().enumerate().map(own);
            twins.flatten().filter(|twin| self.recurs(twin)).count() as u64
        };
        let counts = |twins: &[Option<Twin>], repeated| Counts {
            poses: twins.len() as u64,
            same_translation: twins.iter().flatten().count() as u64,
            recurring: twins.iter().flatten().filter(|t| self.recurs(t)).count() as u64,
            repeated,
        };
        let of_a = twins(a, b, &grid_b);
        let of_b = twins(b, a, &grid_a);
        let pairs = of_a.iter().enumerate().filter_map(|(a, twin)| {
            let twin = twin.filter(|twin| self.recurs(twin))?;
            Some(Pair {
                object_id,
                a,
                b: twin.index,
                difference: twin.difference,
            })
        });
        let object = ObjectLeakage {
            object_id,
            a: counts(&of_a, repeated(a, &grid_a)),
            b: counts(&of_b, repeated(b, &grid_b)),
            histogram: self.histogram(a, b, &of_a),
        };
        (object, pairs.collect())
    }

    fn recurs(&self, twin: &Twin) -> bool {
        twin.difference <= self.settings.limit
    }

    /// The most alike of the poses with the same translation. `except` is the pose's own index where
    /// it is one of them.
    fn twin(
        &self,
        pose: &PoseRecord,
        among: &[PoseRecord],
        grid: &Grid,
        except: Option<usize>,
    ) -> Option<Twin> {
        let within = self.settings.within_mm;
        let mut best: Option<Twin> = None;
        for index in grid.near(pose.translation_mm, within) {
            let other = &among[index];
            let apart = pose.translation_error_mm(other);
            if apart > within || except == Some(index) {
                continue;
            }
            let limit = best.map_or(f64::INFINITY, |twin| twin.difference);
            if let Some(difference) = self.difference(pose, other, limit)
                && (difference < limit || best.is_none())
            {
                best = Some(Twin { index, difference });
                // A split may hold one pose thousands of times.
                if difference == 0.0 {
                    break;
                }
            }
        }
        best
    }

    /// `None` where it is more than `limit`.
    fn difference(&self, a: &PoseRecord, b: &PoseRecord, limit: f64) -> Option<f64> {
        match &self.shape {
            Some(shape) => {
                let diameter_mm = shape.diameter_mm();
                let add_mm = shape.add_mm(a, b, limit * diameter_mm / 100.0)?;
                Some(100.0 * add_mm / diameter_mm)
            }
            None => Some(a.rotation_error_deg(b)).filter(|angle| *angle <= limit),
        }
    }

    fn histogram(&self, a: &[PoseRecord], b: &[PoseRecord], twins: &[Option<Twin>]) -> Histogram {
        let known = twins.iter().map(|twin| twin.map(|twin| twin.difference));
        let Some(shape) = &self.shape else {
            return known.map(Histogram::of).sum();
        };
        let range_mm = shape.diameter_mm() * BINS as f64 / 100.0;
        let grid = Grid::new(b.iter().map(|pose| shape.center(pose)), range_mm);
        let known: Vec<_> = known.collect();
        let nearest = |(pose, mut best): (&PoseRecord, Option<f64>)| {
            for index in grid.near(shape.center(pose), range_mm) {
                let limit = best.unwrap_or(f64::INFINITY).min(BINS as f64);
                if limit == 0.0 {
                    break;
                }
                best = self.difference(pose, &b[index], limit).or(best);
            }
            Histogram::of(best)
        };
        a.par_iter().zip(known).map(nearest).sum()
    }
}

impl Histogram {
    /// Of one pose.
    fn of(difference: Option<f64>) -> Self {
        let mut histogram = Self::default();
        match difference {
            Some(d) if d <= BINS as f64 => histogram.bins[(d.ceil() as usize).max(1) - 1] = 1,
            _ => histogram.beyond = 1,
        }
        histogram
    }
}

impl Sum for Histogram {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, next| Self {
            bins: std::array::from_fn(|i| sum.bins[i] + next.bins[i]),
            beyond: sum.beyond + next.beyond,
        })
    }
}

impl Sum for Counts {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, next| Self {
            poses: sum.poses + next.poses,
            same_translation: sum.same_translation + next.same_translation,
            recurring: sum.recurring + next.recurring,
            repeated: sum.repeated + next.repeated,
        })
    }
}
