//! The Brown-Conrady or Kannala-Brandt lens nearest to another one, by least squares over the image.

use mvtop_geometry::{Intrinsics, Projection};
use nalgebra::{DMatrix, DVector, Point2, Point3, Vector3};

use super::{Foreign, Plane};

/// Columns and rows of the pixels that are fitted, and of those that the error is measured at.
const FITTED: [u32; 2] = [33, 25];
const MEASURED: [u32; 2] = [90, 70];
const STEPS: usize = 200;
/// A pinhole's coefficients are of little use beyond this angle from the axis, 80°.
const NARROW: f64 = 0.173_648;

/// A fitted lens.
pub struct Fit {
    pub intrinsics: Intrinsics,
    /// Largest distance, over the image, of where the two lenses image the same ray.
    pub worst_px: f64,
    /// Share of the image that is fitted: what the lens covers, up to the greatest angle.
    pub covered: f64,
    /// Greatest angle from the axis of that share, degrees.
    pub angle_deg: f64,
}

impl Fit {
    pub fn name(&self) -> &'static str {
        self.intrinsics
            .projection()
            .distortion()
            .unwrap_or("pinhole")
    }
}

/// A pixel and the ray that is imaged there.
type Sample = (Point2<f64>, Vector3<f64>);

/// The better of the two kinds; `None` where the lens has no image.
///
/// - `max_angle`: from the axis, degrees; beyond it nothing is fitted
pub fn fit(lens: &Foreign, plane: &Plane, size: [u32; 2], max_angle: Option<f64>) -> Option<Fit> {
    let most = max_angle.unwrap_or(180.0).to_radians();
    let samples = |grid| {
        let mut samples = samples(lens, plane, size, grid);
        samples.retain(|(_, ray)| ray.angle(&Vector3::z()) <= most);
        samples
    };
    let (fitted, measured) = (samples(FITTED), samples(MEASURED));
    let angles = measured
        .iter()
        .map(|(_, ray)| ray.angle(&Vector3::z()).to_degrees());
    let angle_deg = angles.fold(0.0, f64::max);
    if fitted.len() < 20 {
        return None;
    }
    let covered = measured.len() as f64 / f64::from(MEASURED[0] * MEASURED[1]);
    // The focal length on the axis: models differ in what they call so.
    let step = 1e-4;
    let ray = lens.unproject(&Point2::new(step, 0.0))?;
    let scale = step * ray.z / ray.x;
    let narrow = fitted.iter().all(|(_, ray)| ray.z > NARROW * ray.norm());
    let radial: &[usize] = &[0, 1, 4, 5, 6, 7];
    // Decentering that is not quite OpenCV's takes its thin prisms, too.
    let brown = match lens.is_radial() {
        true => (Kind::BROWN, radial),
        false => (Kind::PRISM, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11][..]),
    };
    // Decentering moves the image as well.
    let centered = lens.is_radial();
    let kinds = narrow
        .then_some(brown)
        .into_iter()
        .chain([(Kind::KANNALA, &[0, 1, 2, 3][..])]);
    let fits = kinds.filter_map(|(kind, free)| {
        let problem = Problem {
            kind,
            free,
            centered,
            plane,
            samples: &fitted,
        };
        let intrinsics = problem.solve(scale)?;
        let worst_px = measured
            .iter()
            .map(|sample| residual(&intrinsics, sample).map_or(f64::INFINITY, |r| r.norm()))
            .fold(0.0, f64::max);
        Some(Fit {
            intrinsics,
            worst_px,
            covered,
            angle_deg,
        })
    });
    fits.min_by(|a, b| a.worst_px.total_cmp(&b.worst_px))
}

/// On a grid of pixels from edge to edge, where the lens has an image.
fn samples(lens: &Foreign, plane: &Plane, size: [u32; 2], grid: [u32; 2]) -> Vec<Sample> {
    let at = |index: u32, of: u32, side: u32| {
        f64::from(index) / f64::from(of - 1) * f64::from(side) - 0.5
    };
    let pixels = (0..grid[1]).flat_map(|row| {
        (0..grid[0])
            .map(move |column| Point2::new(at(column, grid[0], size[0]), at(row, grid[1], size[1])))
    });
    pixels
        .filter_map(|pixel| {
            let ray = lens.unproject(&plane.unit(&pixel))?;
            Some((pixel, ray))
        })
        .collect()
}

fn residual(intrinsics: &Intrinsics, (pixel, ray): &Sample) -> Option<nalgebra::Vector2<f64>> {
    Some(intrinsics.project(&Point3::from(*ray))? - pixel)
}

#[derive(Clone, Copy)]
struct Kind {
    family: &'static str,
    count: usize,
}

impl Kind {
    const BROWN: Self = Self {
        family: "pinhole",
        count: 8,
    };
    const PRISM: Self = Self {
        family: "pinhole",
        count: 12,
    };
    const KANNALA: Self = Self {
        family: "fisheye",
        count: 4,
    };
}

struct Problem<'a> {
    kind: Kind,
    /// Coefficients that are fitted; the others are 0.
    free: &'a [usize],
    /// Whether the principal point is that of the other lens.
    centered: bool,
    plane: &'a Plane,
    samples: &'a [Sample],
}

impl Problem<'_> {
    /// How many unknowns come before the coefficients.
    fn first(&self) -> usize {
        if self.centered { 1 } else { 3 }
    }

    /// - `unknowns`: factor of the focal lengths, what the principal point moves by in px unless it is
    ///   centered, then the free coefficients
    fn lens(&self, unknowns: &DVector<f64>) -> Option<Intrinsics> {
        let mut params = vec![0.0; self.kind.count];
        for (&index, &value) in self.free.iter().zip(unknowns.iter().skip(self.first())) {
            params[index] = value;
        }
        let projection = Projection::from_params(self.kind.family, None, &params).ok()?;
        let plane = self.plane.scaled(unknowns[0]);
        let plane = match self.centered {
            true => plane,
            false => plane.moved(unknowns[1], unknowns[2]),
        };
        plane.under(projection).ok()
    }

    /// `[2 N]`, px; `None` where the lens cannot image a ray.
    fn residuals(&self, unknowns: &DVector<f64>) -> Option<DVector<f64>> {
        let lens = self.lens(unknowns)?;
        let mut all = Vec::with_capacity(2 * self.samples.len());
        for sample in self.samples {
            all.extend(residual(&lens, sample)?.iter());
        }
        Some(DVector::from_vec(all))
    }

    /// Levenberg and Marquardt's method, from a lens without distortion.
    fn solve(&self, scale: f64) -> Option<Intrinsics> {
        let count = self.first() + self.free.len();
        let mut at = DVector::zeros(count);
        at[0] = scale;
        let mut error = self.residuals(&at)?;
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            // At the edge of what the lens can image there is no derivative to go on by.
            let Some(jacobian) = self.jacobian(&at) else {
                break;
            };
            let norms: Vec<f64> = jacobian
                .column_iter()
                .map(|c| c.norm().max(1e-12))
                .collect();
            let scaled =
                DMatrix::from_fn(jacobian.nrows(), count, |i, j| jacobian[(i, j)] / norms[j]);
            let (before, mut gained) = (error.norm_squared(), 0.0);
            while damping < 1e12 {
                // Stacked rather than squared: the coefficients are nearly dependent.
                let rows = scaled.nrows();
                let root = f64::sqrt(damping);
                let system =
                    DMatrix::from_fn(rows + count, count, |i, j| match i.checked_sub(rows) {
                        None => scaled[(i, j)],
                        Some(k) => {
                            if k == j {
                                root
                            } else {
                                0.0
                            }
                        }
                    });
                let target =
                    DVector::from_fn(rows + count, |i, _| if i < rows { -error[i] } else { 0.0 });
                let step = system.svd(true, true).solve(&target, 1e-15).ok()?;
                let next = DVector::from_fn(count, |j, _| at[j] + step[j] / norms[j]);
                let left = self
                    .residuals(&next)
                    .filter(|left| left.norm_squared() < before);
                if let Some(left) = left {
                    gained = 1.0 - left.norm_squared() / before;
                    (at, error) = (next, left);
                    damping = (damping / 10.0).max(1e-15);
                    break;
                }
                damping *= 10.0;
            }
            if gained < 1e-9 {
                break;
            }
        }
        self.lens(&at)
    }

    /// By central differences.
    fn jacobian(&self, at: &DVector<f64>) -> Option<DMatrix<f64>> {
        let columns: Option<Vec<_>> = (0..at.len())
            .map(|j| {
                let step = 1e-6;
                let moved = |by: f64| {
                    let mut moved = at.clone();
                    moved[j] += by;
                    self.residuals(&moved)
                };
                Some((moved(step)? - moved(-step)?) / (2.0 * step))
            })
            .collect();
        Some(DMatrix::from_columns(&columns?))
    }
}
