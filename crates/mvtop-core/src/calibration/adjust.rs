//! Bundle adjustment: cameras and objects are moved to where all views agree best, each view being
//! believed to some pixels and each camera to stand near where it is said to.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion, Vector6,
};

use super::Expected;

/// What edges of one object in one view err by together, px in each of the six directions of a pose:
/// as measured on another renderer's images of true rigs. It counts as this many measurements beside
/// those of the images at hand.
const NOISE_PX: f64 = 0.3;
const NOISE_COUNTS: f64 = 12.0;
/// What views err by alike does not show in how they contradict each other: how many times as much as
/// this a true rig's views are off, over sets of the renderers at hand.
const ALIKE: f64 = 1.5;
/// Standard deviations in each direction at which a view of an object keeps a quarter of its weight.
const ROBUST: f64 = 3.0;
/// Steps once robust weights are as they stay; the noise is measured in them.
const STEPS: usize = 8;
/// What an object's step is held back by, radians and metres: next to nothing.
const HELD: [f64; 2] = [0.5, 0.3];

/// How far outwards edges are found in all images alike, px: mean and standard deviation over the
/// classes and renderers at hand.
const OUTWARDS: [f64; 2] = [0.1, 0.15];
/// Edges that move by less than this, px, for a metre along the line of sight do not tell distances.
const MOVED: f64 = 1.0;

/// Where one view shows one object.
#[derive(Debug, Clone)]
pub struct Sighting {
    pub camera: usize,
    pub object: usize,
    pub cam_from_obj: Isometry3<f64>,
    /// Inverse covariance of a turn about the object's center and a shift, camera frame, were edges a
    /// pixel off.
    pub edges: Matrix6<f64>,
}

/// An object at a place.
#[derive(Debug, Clone)]
pub struct Object {
    pub world_from_obj: Isometry3<f64>,
    /// About which it turns, object frame.
    pub center: Point3<f64>,
}

/// What is sought.
#[derive(Debug, Clone)]
pub struct Scene {
    pub cams_from_world: Vec<Isometry3<f64>>,
    pub objects: Vec<Object>,
    /// How far outwards of where they are edges are found in all images alike, px.
    pub outwards: f64,
}

/// A scene on which all views agree best.
pub struct Adjusted {
    pub scene: Scene,
    /// Of motions of the world in each camera's frame: a turn about the camera and a shift.
    pub covariance: DMatrix<f64>,
    /// What each view of an object errs by in each direction, px.
    pub noise_px: f64,
    /// How far edges are from where each sighting shows them: root mean square, px.
    pub px: Vec<f64>,
}

/// - `given`: where cameras are said to stand
/// - `expected`: how far each is expected to be off that
/// - `from_px`: how far edges may be off in `start`
/// - returns: `None` where numbers do not allow it
pub fn adjusted(
    given: &[Isometry3<f64>],
    expected: &[Expected],
    start: Scene,
    sightings: &[Sighting],
    from_px: f64,
) -> Option<Adjusted> {
    let (mut scene, mut noise) = (start, ALIKE * NOISE_PX);
    let mut wider = (from_px / noise).max(1.0);
    let (mut left, mut covariance) = (STEPS, DMatrix::zeros(0, 0));
    while left > 0 {
        let scale = ROBUST * noise * wider;
        covariance = step(given, expected, &mut scene, sightings, noise, scale)?;
        if wider > 1.0 {
            wider = (wider / 1.5).max(1.0);
        } else {
            left -= 1;
            noise = measured(&scene, sightings, noise);
        }
    }
    let px = sightings.iter().map(|s| s.off(&scene).1.sqrt());
    Some(Adjusted {
        px: px.collect(),
        scene,
        covariance,
        noise_px: noise,
    })
}

/// What sightings that keep their weight err by.
fn measured(scene: &Scene, sightings: &[Sighting], noise: f64) -> f64 {
    let mut free = vec![-6.0; scene.objects.len()];
    let mut squares = 0.0;
    for sighting in sightings {
        let square = sighting.off(scene).1;
        let weight = robust(square, ROBUST * noise);
        squares += weight * square;
        free[sighting.object] += weight * 6.0;
    }
    let cameras = 6.0 * (scene.cams_from_world.len() as f64 - 1.0);
    let free = free.iter().map(|free| free.max(0.0)).sum::<f64>() - cameras;
    let count = NOISE_COUNTS + free.max(0.0);
    ALIKE * ((NOISE_COUNTS * NOISE_PX * NOISE_PX + squares) / count).sqrt()
}

/// Geman-McClure's weight of six squares together.
fn robust(square: f64, scale: f64) -> f64 {
    (1.0 + square / (6.0 * scale * scale)).powi(-2)
}

impl Sighting {
    /// The motion from where the object is expected to where it is shown, camera frame, and its
    /// square, px².
    fn off(&self, scene: &Scene) -> (Vector6<f64>, f64) {
        let object = &scene.objects[self.object];
        let cam_from_obj = scene.cams_from_world[self.camera] * object.world_from_obj;
        let mut off = between(&cam_from_obj, &self.cam_from_obj, &object.center);
        off -= self.by_outwards(&(cam_from_obj * object.center)) * scene.outwards;
        (off, off.dot(&(self.edges * off)).max(0.0))
    }

    /// How an object seems to be moved where its edges are found a pixel outwards: to the camera.
    fn by_outwards(&self, center: &Point3<f64>) -> Vector6<f64> {
        let to_camera = -center.coords.normalize();
        let by_shift = self.edges.fixed_view::<3, 3>(3, 3) * to_camera;
        let px = to_camera.dot(&by_shift).max(MOVED * MOVED).sqrt();
        let mut motion = Vector6::zeros();
        motion.fixed_rows_mut::<3>(3).copy_from(&(to_camera / px));
        motion
    }
}

/// The turn and shift from one pose to another.
///
/// - `center`: what the shift is of, in the frame that the poses map from
pub fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, center: &Point3<f64>) -> Vector6<f64> {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let shift = to * center - from * center;
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// The pose after a turn about a point and a shift.
fn moved(motion: &Vector6<f64>, about: &Point3<f64>, pose: &Isometry3<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(0).into_owned());
    let arm = turn * (pose.translation.vector - about.coords);
    let place = about.coords + arm + motion.fixed_rows::<3>(3);
    Isometry3::from_parts(Translation3::from(place), turn * pose.rotation)
}

/// A step of Gauss-Newton; returns the covariance of the cameras. The objects are taken out of the
/// system (Schur's complement), as each is tied to the cameras alone.
fn step(
    given: &[Isometry3<f64>],
    expected: &[Expected],
    scene: &mut Scene,
    sightings: &[Sighting],
    noise: f64,
    scale: f64,
) -> Option<DMatrix<f64>> {
    let size = 6 * given.len() + 1;
    let last = size - 1;
    let (mut system, mut pull) = (DMatrix::zeros(size, size), DVector::zeros(size));
    for (i, (given, now)) in given.iter().zip(&scene.cams_from_world).enumerate() {
        // Of the camera's own center, which is where it turns about.
        let turn = given.rotation * now.rotation.inverse();
        let shift = given.translation.vector - turn * now.translation.vector;
        let turn = turn.scaled_axis();
        let back = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        let prior = expected[i].information();
        let mut diagonal = system.view_mut((6 * i, 6 * i), (6, 6));
        diagonal.set_diagonal(&prior);
        pull.rows_mut(6 * i, 6)
            .copy_from(&prior.component_mul(&back));
    }
    let [mean, sd] = OUTWARDS;
    system[(last, last)] = sd.powi(-2);
    pull[last] = (mean - scene.outwards) / (sd * sd);
    let held = HELD.map(|held| 1.0 / (held * held));
    let held = Matrix6::from_diagonal(&Vector6::from_fn(|i, _| held[i / 3]));
    // Of each object: what is known of it, what pulls it, and how it is tied to the rest.
    let alone = (held, Vector6::zeros(), DMatrix::zeros(size, 6));
    let mut own = vec![alone; scene.objects.len()];
    for sighting in sightings {
        let (off, square) = sighting.off(scene);
        let weight = robust(square, scale) / (noise * noise);
        let information = sighting.edges * weight;
        let cam_from_world = &scene.cams_from_world[sighting.camera];
        let object = &scene.objects[sighting.object];
        let middle = cam_from_world * (object.world_from_obj * object.center);
        let turn = *cam_from_world.rotation.to_rotation_matrix().matrix();
        let mut by_object = Matrix6::zeros();
        by_object.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        by_object.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        let mut by_rest = DMatrix::zeros(6, size);
        let at = 6 * sighting.camera;
        by_rest.view_mut((0, at), (6, 6)).fill_with_identity();
        // What lies off the camera is shifted by its turn.
        let arm = -middle.coords.cross_matrix();
        by_rest.view_mut((3, at), (3, 3)).copy_from(&arm);
        by_rest.set_column(last, &sighting.by_outwards(&middle));
        system += by_rest.transpose() * information * &by_rest;
        pull += by_rest.transpose() * information * off;
        let (block, right, tie) = &mut own[sighting.object];
        *block += by_object.transpose() * information * by_object;
        *right += by_object.transpose() * information * off;
        *tie += by_rest.transpose() * information * by_object;
    }
    let mut solved = Vec::with_capacity(own.len());
    for (block, right, tie) in own {
        let inverse = block.cholesky()?.inverse();
        system -= &tie * inverse * tie.transpose();
        pull -= &tie * (inverse * right);
        solved.push((inverse, right, tie));
    }
    let system = system.cholesky()?;
    let motions = system.solve(&pull);
    if !motions.iter().all(|x| x.is_finite()) {
        return None;
    }
    for (object, (inverse, right, tie)) in scene.objects.iter_mut().zip(solved) {
        let motion = inverse * (right - tie.transpose() * &motions);
        let pose = &mut object.world_from_obj;
        *pose = moved(&motion, &(*pose * object.center), pose);
    }
    for (i, pose) in scene.cams_from_world.iter_mut().enumerate() {
        let motion = motions.fixed_rows::<6>(6 * i).into_owned();
        *pose = moved(&motion, &Point3::origin(), pose);
    }
    scene.outwards += motions[last];
    Some(system.inverse())
}

impl Adjusted {
    /// How far edges are off where a sighting loses three quarters of its weight.
    pub fn keeps_weight_px(&self) -> f64 {
        6f64.sqrt() * ROBUST * self.noise_px
    }

    /// How a camera is to be moved, in its own axes, for a base camera that stays.
    ///
    /// - returns: the motion; its covariance; and that which was expected beforehand
    pub fn relative(
        &self,
        given: &[Isometry3<f64>],
        expected: &Expected,
        camera: usize,
        base: usize,
    ) -> (Isometry3<f64>, Matrix6<f64>, Matrix6<f64>) {
        let between = |poses: &[Isometry3<f64>]| poses[base] * poses[camera].inverse();
        let now = &self.scene.cams_from_world;
        let motion = between(given).inv_mul(&between(now));
        let cam_from_base = now[camera] * now[base].inverse();
        let turn = *cam_from_base.rotation.to_rotation_matrix().matrix();
        let mut by_both = SMatrix::<f64, 6, 12>::zeros();
        by_both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        by_both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        let arm = cam_from_base.translation.vector.cross_matrix() * turn;
        by_both.fixed_view_mut::<3, 3>(3, 0).copy_from(&arm);
        by_both
            .fixed_view_mut::<6, 6>(0, 6)
            .copy_from(&-Matrix6::identity());
        let blocks = [base, camera];
        let both = SMatrix::<f64, 12, 12>::from_fn(|i, j| {
            self.covariance[(6 * blocks[i / 6] + i % 6, 6 * blocks[j / 6] + j % 6)]
        });
        let before = expected.information().map(f64::recip);
        let before = SMatrix::<f64, 12, 12>::from_fn(|i, j| match i == j {
            true => before[i % 6],
            false => 0.0,
        });
        (
            motion,
            by_both * both * by_both.transpose(),
            by_both * before * by_both.transpose(),
        )
    }
}
