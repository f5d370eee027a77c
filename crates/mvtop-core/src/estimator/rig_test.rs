//! Whether one error of the rig explains how the views of all objects differ.
//!
//! Each view gives a pose of each object by itself. If the rig is right, these differ by noise alone. If
//! a camera is off, all objects that it shows are off in the same way; if the rig has a wrong scale, all
//! objects have the wrong size for their distance. So small corrections of all cameras are estimated
//! from all objects and views at once (robust least squares, Student weights), and the rig is judged by
//! how much better the views agree with them. An object that one view takes for something else is an
//! outlier and tells nothing of the rig.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Point3, Vector3, Vector6};

use crate::config::RigConfig;

/// What one view says of one object, as a motion from the pose of all views.
#[derive(Debug, Clone)]
pub struct Measurement {
    /// Index of the object.
    pub object: usize,
    /// Index of the object's class.
    pub class: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Turn about the object's center, radians, and shift, metres; world frame.
    pub motion: Vector6<f64>,
    /// Covariance of that.
    pub covariance: Matrix6<f64>,
    /// Center of the object, world frame.
    pub center: Point3<f64>,
    /// Center of the camera, world frame.
    pub camera_center: Point3<f64>,
    /// Optical axis of the camera, world frame.
    pub axis: Vector3<f64>,
}

/// What speaks against a rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judgement {
    /// Square root of the gain in log-likelihood by corrections of all cameras: about the number of
    /// standard deviations by which the rig is off.
    pub cameras: f64,
    /// The same of one scale of all distances between cameras, or of all focal lengths.
    pub scale: f64,
    /// By how much that scale is off, as a share.
    pub by: f64,
    /// Index of the camera whose correction is largest.
    pub worst_camera: usize,
}

/// Degrees of freedom of Student's distribution: smaller ones trust outliers less.
const STUDENT: f64 = 4.0;
const ROUNDS: usize = 8;

/// Judges a rig; `None` where fewer than two views measure an object.
pub fn judge(config: &RigConfig, all: &[Measurement]) -> Option<Judgement> {
    let mut objects: Vec<usize> = all.iter().map(|one| one.object).collect();
    objects.sort_unstable();
    objects.dedup();
    let several = |object: &usize| all.iter().filter(|one| one.object == *object).count() > 1;
    objects.retain(several);
    let used: Vec<&Measurement> = all
        .iter()
        .filter(|one| objects.contains(&one.object))
        .collect();
    let mut cameras: Vec<usize> = used.iter().map(|one| one.camera).collect();
    cameras.sort_unstable();
    cameras.dedup();
    if cameras.len() < 2 {
        return None;
    }
    let mut classes: Vec<usize> = used.iter().map(|one| one.class).collect();
    classes.sort_unstable();
    classes.dedup();
    let information: Option<Vec<Matrix6<f64>>> = used
        .iter()
        .map(|one| Some(one.covariance.cholesky()?.inverse()))
        .collect();
    let problem = Problem {
        config,
        information: information?,
        objects,
        cameras,
        classes,
        used,
    };
    let (none, _) = problem.solve(Model::None)?;
    let (cameras, solved) = problem.solve(Model::Cameras)?;
    let (scale, by) = [Model::Scale, Model::Focal]
        .into_iter()
        .filter_map(|model| {
            let (cost, x) = problem.solve(model)?;
            Some((cost, x[problem.corrections()]))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    let freedom = 6.0 * (problem.cameras.len() - 1) as f64;
    let size = |camera: &usize| {
        let at = problem.corrections() + 6 * camera;
        let (turn, shift) = (solved.rows(at, 3).norm(), solved.rows(at + 3, 3).norm());
        (turn / config.camera_prior[0].to_radians()).hypot(shift / config.camera_prior[1])
    };
    let largest = (0..problem.cameras.len()).max_by(|a, b| size(a).total_cmp(&size(b)))?;
    Some(Judgement {
        // Corrections gain about one for each of their numbers by chance.
        cameras: (none - cameras - freedom).max(0.0).sqrt(),
        scale: (none - scale - 1.0).max(0.0).sqrt(),
        by,
        worst_camera: problem.cameras[largest],
    })
}

/// Which error of the rig is allowed for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    None,
    /// A turn and a shift of each camera.
    Cameras,
    /// One factor on all distances between cameras.
    Scale,
    /// One factor on all focal lengths.
    Focal,
}

struct Problem<'a> {
    config: &'a RigConfig,
    used: Vec<&'a Measurement>,
    information: Vec<Matrix6<f64>>,
    objects: Vec<usize>,
    cameras: Vec<usize>,
    classes: Vec<usize>,
}

impl Problem<'_> {
    /// Index of the first correction among the unknowns: motions of objects and scales of meshes come
    /// before.
    fn corrections(&self) -> usize {
        6 * self.objects.len() + self.classes.len()
    }

    /// Twice the negative log-likelihood at its least, and the unknowns there.
    fn solve(&self, model: Model) -> Option<(f64, DVector<f64>)> {
        let count = match model {
            Model::None => 0,
            Model::Cameras => 6 * self.cameras.len(),
            Model::Scale | Model::Focal => 1,
        };
        let size = self.corrections() + count;
        let rows: Vec<DMatrix<f64>> = self
            .used
            .iter()
            .map(|one| self.row(model, one, size))
            .collect();
        let prior = self.prior(model, size);
        let mut weights = vec![1.0; self.used.len()];
        let mut best = None;
        for _ in 0..ROUNDS {
            let (mut normal, mut pull) = (DMatrix::from_diagonal(&prior), DVector::zeros(size));
            for (((one, row), information), weight) in self
                .used
                .iter()
                .zip(&rows)
                .zip(&self.information)
                .zip(&weights)
            {
                let weighted = row.transpose() * information * *weight;
                normal += &weighted * row;
                pull += weighted * one.motion;
            }
            let x = normal.cholesky()?.solve(&pull);
            let mut cost = x.component_mul(&x).dot(&prior);
            for (((one, row), information), weight) in self
                .used
                .iter()
                .zip(&rows)
                .zip(&self.information)
                .zip(&mut weights)
            {
                let left = one.motion - Vector6::from_iterator((row * &x).iter().copied());
                let square = (left.transpose() * information * left).x;
                *weight = (STUDENT + 6.0) / (STUDENT + square);
                cost += (STUDENT + 6.0) * (square / STUDENT).ln_1p();
            }
            best = Some((cost, x));
        }
        best.filter(|(cost, _)| cost.is_finite())
    }

    /// Inverse variances of the unknowns.
    fn prior(&self, model: Model, size: usize) -> DVector<f64> {
        let RigConfig {
            camera_prior,
            mesh_scale_sigma,
            ..
        } = self.config;
        let mut prior = DVector::zeros(size);
        let motions = 6 * self.objects.len();
        // The joint pose is near the truth: keeps objects that few views measure well-posed.
        prior.rows_mut(0, motions).fill(1e-6);
        let scales = self.classes.len();
        prior
            .rows_mut(motions, scales)
            .fill(mesh_scale_sigma.powi(-2));
        let (turn, shift) = (
            camera_prior[0].to_radians().powi(-2),
            camera_prior[1].powi(-2),
        );
        match model {
            Model::None => {}
            Model::Cameras => {
                for camera in 0..self.cameras.len() {
                    let at = self.corrections() + 6 * camera;
                    prior.rows_mut(at, 3).fill(turn);
                    prior.rows_mut(at + 3, 3).fill(shift);
                }
            }
            Model::Scale | Model::Focal => prior[self.corrections()] = 0.1_f64.powi(-2),
        }
        prior
    }

    /// How a measurement follows from the unknowns, `[6, size]`.
    fn row(&self, model: Model, one: &Measurement, size: usize) -> DMatrix<f64> {
        let place = |all: &[usize], of: usize| all.binary_search(&of).unwrap_or(0);
        let mut row = DMatrix::zeros(6, size);
        let object = 6 * place(&self.objects, one.object);
        row.view_mut((0, object), (6, 6)).fill_with_identity();
        // A mesh that is too large looks nearer: its distance by size is too great.
        let ray = one.center - one.camera_center;
        let class = 6 * self.objects.len() + place(&self.classes, one.class);
        row.view_mut((3, class), (3, 1)).copy_from(&ray);
        let at = self.corrections();
        match model {
            Model::None => {}
            Model::Cameras => {
                // If the camera really is turned and shifted, the object seems to move the other way.
                let at = at + 6 * place(&self.cameras, one.camera);
                row.view_mut((0, at), (3, 3))
                    .copy_from(&Matrix3::identity());
                row.view_mut((3, at), (3, 3))
                    .copy_from(&(-ray.cross_matrix()));
                row.view_mut((3, at + 3), (3, 3))
                    .copy_from(&Matrix3::identity());
            }
            Model::Scale => {
                let shift = one.camera_center.coords - self.middle();
                row.view_mut((3, at), (3, 1)).copy_from(&shift);
            }
            // Directions and distances by size change together: the object moves along the axis.
            Model::Focal => {
                let along = one.axis * ray.dot(&one.axis);
                row.view_mut((3, at), (3, 1)).copy_from(&along);
            }
        }
        row
    }

    /// Middle of the cameras.
    fn middle(&self) -> Vector3<f64> {
        let sum: Vector3<f64> = self.used.iter().map(|one| one.camera_center.coords).sum();
        sum / self.used.len() as f64
    }
}
