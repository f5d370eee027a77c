//! Where cameras stand and look, and which share how much of their views.

use std::fmt::Write;

use mvtop_core::{Camera, Rig};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Unit, Vector3};

/// Columns and rows of the lines of sight that are followed.
const GRID: [u32; 2] = [12, 9];
/// Distances that they are followed to, in the rig's size: an object is not much nearer than a twentieth
/// of the rig, nor much farther than twenty times it.
const NEAREST: f64 = 0.05;
const FARTHEST: f64 = 20.0;
const STEPS: i32 = 60;
/// Cameras that look apart share little of their views below this share: what looks outwards on
/// purpose shares more, most often.
const LITTLE: f64 = 0.25;
/// Cameras that share this much of their views as they are look at the same, wherever their axes meet.
const NEARLY_ALL: f64 = 0.9;
/// Most pairs that are printed.
const MOST_LINES: usize = 30;
/// Halvings of half an image's side, down to what a pixel's angle does not show.
const HALVINGS: usize = 40;

/// Another meaning of a pose; the second argument is half a turn about x.
type Reading = fn(&Isometry3<f64>, &Isometry3<f64>) -> Isometry3<f64>;

/// What two cameras see of the same.
pub struct Shared {
    pub pair: [usize; 2],
    pub distance: f64,
    /// Between the directions in which they look, degrees.
    pub angle_deg: f64,
    /// Share of the lines of sight of each that the other sees somewhere.
    pub shares: [f64; 2],
    /// From the first camera, where it is seen from both: nearest and farthest, metres.
    pub range: Option<[f64; 2]>,
}

/// What hints at poses in other axes or the other direction.
pub struct Doubt {
    pub sentence: String,
    /// Whether it is reason enough to refuse the rig, where no images tell.
    pub refuses: bool,
}

/// All pairs.
pub struct Views {
    /// Largest distance between two cameras, metres.
    size: f64,
    pairs: Vec<Shared>,
    poses: Vec<Isometry3<f64>>,
}

impl Views {
    pub fn of(rig: &Rig) -> Self {
        let poses = rig
            .cameras()
            .iter()
            .map(|camera| *camera.world_from_cam())
            .collect();
        Self::with(rig, poses)
    }

    /// Of the same cameras at other places.
    fn with(rig: &Rig, poses: Vec<Isometry3<f64>>) -> Self {
        let cameras = rig.cameras();
        let size = size(&poses);
        let mut pairs = Vec::new();
        for b in 1..cameras.len() {
            for a in 0..b {
                let from = |i: usize, j: usize| {
                    seen((&cameras[i], &poses[i]), (&cameras[j], &poses[j]), size)
                };
                let ((ab, range), (ba, _)) = (from(a, b), from(b, a));
                let z = |i: usize| poses[i].rotation * Vector3::z();
                pairs.push(Shared {
                    pair: [a, b],
                    distance: (poses[a].translation.vector - poses[b].translation.vector).norm(),
                    angle_deg: z(a).angle(&z(b)).to_degrees(),
                    shares: [ab, ba],
                    range,
                });
            }
        }
        Self { size, pairs, poses }
    }

    /// Mean share of lines of sight that two cameras have in common.
    fn mean(&self) -> f64 {
        let shares = self.pairs.iter().flat_map(|pair| pair.shares);
        shares.sum::<f64>() / (2 * self.pairs.len()).max(1) as f64
    }

    /// Mean share of each camera's lines of sight that the one with which it shares most sees.
    fn with_nearest(&self) -> f64 {
        let mut most = vec![0.0f64; self.poses.len()];
        for pair in &self.pairs {
            for (camera, share) in pair.pair.into_iter().zip(pair.shares) {
                most[camera] = most[camera].max(share);
            }
        }
        most.iter().sum::<f64>() / most.len().max(1) as f64
    }

    /// The point nearest to all axes, and whether it is in front of the cameras.
    fn focus(&self) -> Option<(Point3<f64>, usize)> {
        let mut matrix = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for pose in &self.poses {
            let z = pose.rotation * Vector3::z();
            let across = Matrix3::identity() - z * z.transpose();
            matrix += across;
            right += across * pose.translation.vector;
        }
        // Axes that are nearly parallel meet nowhere in particular.
        let smallest = matrix.symmetric_eigenvalues().min();
        let point = (smallest > 1e-3).then(|| matrix.try_inverse())?? * right;
        let in_front = self
            .poses
            .iter()
            .filter(|pose| pose.inverse_transform_point(&Point3::from(point)).z > 0.0);
        Some((Point3::from(point), in_front.count()))
    }

    pub fn text(&self, rig: &Rig) -> String {
        let cameras = rig.cameras();
        let mut out = String::new();
        let reference = rig.reference_camera().id();
        let _ = writeln!(
            out,
            "cameras: {}, reference {reference}, metres",
            cameras.len()
        );
        for camera in cameras {
            let pose = camera.world_from_cam();
            let (t, z) = (pose.translation.vector, pose.rotation * Vector3::z());
            let intrinsics = camera.intrinsics();
            let projection = intrinsics.projection();
            let _ = writeln!(
                out,
                "  {:<16} at [{:.4} {:.4} {:.4}] looks along [{:.3} {:.3} {:.3}], {}x{} px, sees {:.0} x \
                 {:.0} deg, {}",
                camera.id(),
                t.x,
                t.y,
                t.z,
                z.x,
                z.y,
                z.z,
                camera.width(),
                camera.height(),
                angle_of_view(camera, 0),
                angle_of_view(camera, 1),
                projection.distortion().unwrap_or("pinhole"),
            );
        }
        for pair in self.pairs.iter().take(MOST_LINES) {
            let [a, b] = pair.pair.map(|index| cameras[index].id());
            let [ab, ba] = pair.shares.map(|share| 100.0 * share);
            let seen = match pair.range {
                None => "no view in common".to_owned(),
                Some([near, far]) => {
                    let far = match far > 0.99 * self.size * FARTHEST {
                        true => "on".to_owned(),
                        false => format!("to {far:.2} m"),
                    };
                    format!(
                        "in common: {ab:.0} % of {a}'s view and {ba:.0} % of {b}'s, from {near:.2} m {far} \
                         before {a}"
                    )
                }
            };
            let (distance, angle) = (pair.distance, pair.angle_deg);
            let _ = writeln!(
                out,
                "  {a} - {b}: {distance:.4} m apart, {angle:.1} deg; {seen}"
            );
        }
        if self.pairs.len() > MOST_LINES {
            let _ = writeln!(
                out,
                "  ... and {} pairs more",
                self.pairs.len() - MOST_LINES
            );
        }
        if let Some((point, in_front)) = self.focus() {
            let [x, y, z] = [point.x, point.y, point.z];
            let of = cameras.len();
            let _ = writeln!(
                out,
                "axes pass nearest to each other at [{x:.3} {y:.3} {z:.3}], in front of {in_front} of {of}"
            );
        }
        out
    }

    /// What hints at poses in other axes or the other direction, if anything.
    pub fn doubt(&self, rig: &Rig) -> Option<Doubt> {
        if self.pairs.is_empty() {
            return None;
        }
        let lonely = self.pairs.iter().all(|pair| pair.range.is_none());
        let behind = self
            .focus()
            .is_some_and(|(_, in_front)| 2 * in_front < self.poses.len());
        if !(lonely || behind) || self.with_nearest() >= NEARLY_ALL {
            return None;
        }
        let flip = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
        let ways: [(&str, Reading); 3] = [
            ("in OpenGL's axes (y up, z backward)", |pose, flip| {
                pose * flip
            }),
            (
                "in the other direction (world to camera instead of camera to world)",
                |pose, _| pose.inverse(),
            ),
            (
                "in the other direction and in OpenGL's axes",
                |pose, flip| pose.inverse() * flip,
            ),
        ];
        let now = self.mean();
        let best = ways
            .iter()
            .map(|(name, change)| {
                let poses = self.poses.iter().map(|pose| change(pose, &flip)).collect();
                let views = Self::with(rig, poses);
                let faces = views
                    .focus()
                    .is_none_or(|(_, in_front)| in_front == self.poses.len());
                (*name, views.mean(), faces)
            })
            .filter(|(_, mean, faces)| *mean > now + 0.05 || (behind && *faces && *mean >= now))
            .max_by(|a, b| {
                (a.2, a.1)
                    .partial_cmp(&(b.2, b.1))
                    .unwrap_or(std::cmp::Ordering::Equal)
            });
        let what = match lonely {
            true => "no two cameras have any view in common".to_owned(),
            false => "the cameras look away from where their axes meet".to_owned(),
        };
        let sentence = match best {
            Some((name, mean, _)) => format!(
                "{what}, which is what swapped poses look like: read {name} they share {:.0} % of their \
                 views, {:.0} % as they are",
                100.0 * mean,
                100.0 * now
            ),
            None => format!(
                "{what}, and neither other axes nor the other direction would change it; check the poses"
            ),
        };
        Some(Doubt {
            sentence,
            refuses: self.with_nearest() < LITTLE,
        })
    }
}

/// Largest distance between two cameras, or 1 m.
fn size(poses: &[Isometry3<f64>]) -> f64 {
    let center = |pose: &Isometry3<f64>| pose.translation.vector;
    let largest = poses
        .iter()
        .flat_map(|a| poses.iter().map(move |b| (center(a) - center(b)).norm()))
        .fold(0.0, f64::max);
    if largest > 0.0 { largest } else { 1.0 }
}

/// Share of a camera's lines of sight that another one sees, and at what distances.
fn seen(
    (a, world_from_a): (&Camera, &Isometry3<f64>),
    (b, world_from_b): (&Camera, &Isometry3<f64>),
    size: f64,
) -> (f64, Option<[f64; 2]>) {
    let b_from_a = world_from_b.inverse() * world_from_a;
    let [columns, rows] = GRID;
    let (mut all, mut common) = (0, 0);
    let mut range: Option<[f64; 2]> = None;
    for index in 0..columns * rows {
        let along = |i: u32, count: u32, side: u32| {
            (f64::from(i) + 0.5) / f64::from(count) * f64::from(side) - 0.5
        };
        let pixel = Point2::new(
            along(index % columns, columns, a.width()),
            along(index / columns, rows, a.height()),
        );
        let Some(ray) = a.intrinsics().unproject(&pixel) else {
            continue;
        };
        all += 1;
        let mut hit = false;
        for step in 0..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            let depth = size * NEAREST * (FARTHEST / NEAREST).powf(share);
            let point = b_from_a * Point3::from(ray.scale(depth));
            let inside = |p: Point2<f64>| {
                (-0.5..=f64::from(b.width()) - 0.5).contains(&p.x)
                    && (-0.5..=f64::from(b.height()) - 0.5).contains(&p.y)
            };
            if b.intrinsics().project(&point).is_some_and(inside) {
                hit = true;
                let [near, far] = range.unwrap_or([depth; 2]);
                range = Some([near.min(depth), far.max(depth)]);
            }
        }
        common += u32::from(hit);
    }
    (f64::from(common) / f64::from(all.max(1)), range)
}

/// Between the rays of opposite edges, or of where the lens ends before these, degrees; axis 0 is x.
fn angle_of_view(camera: &Camera, axis: usize) -> f64 {
    let (w, h) = (f64::from(camera.width()), f64::from(camera.height()));
    let middle = Point2::new((w - 1.0) / 2.0, (h - 1.0) / 2.0);
    let edges = [-0.5, [w, h][axis] - 0.5].map(|place| {
        let mut edge = middle;
        edge[axis] = place;
        edge
    });
    let from_axis = |edge| Some(last_ray(camera, middle, edge)?.angle(&Vector3::z()));
    let angles = edges.map(|edge| from_axis(edge).unwrap_or(f64::NAN));
    angles.iter().sum::<f64>().to_degrees()
}

/// The ray of a pixel at the edge, or else of the last one on the way there from the middle, where a
/// rig's lenses have one.
fn last_ray(camera: &Camera, middle: Point2<f64>, edge: Point2<f64>) -> Option<Unit<Vector3<f64>>> {
    let ray = |pixel: &Point2<f64>| camera.intrinsics().unproject(pixel);
    if let Some(ray) = ray(&edge) {
        return Some(ray);
    }
    let (mut inside, mut outside) = (middle, edge);
    for _ in 0..HALVINGS {
        let between = nalgebra::center(&inside, &outside);
        match ray(&between) {
            Some(_) => inside = between,
            None => outside = between,
        }
    }
    ray(&inside)
}
