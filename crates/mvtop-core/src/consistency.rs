//! How well boxes, poses and the calibration agree: one set of residuals.
//!
//! The points of a found object, projected into a view, fill the box that shows it there, if the pose
//! and the cameras are right. Its position is first moved to where all boxes agree best, so that what
//! is left is no error of the position: lines of sight that miss each other, and sizes that do not
//! belong to the distances at which they meet.

pub mod alone;

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector2, Vector3};

use crate::bundle::SurfacePoint;
use crate::{BBox, Camera};

/// Steps of Gauss-Newton; the residuals are nearly linear.
const STEPS: usize = 4;
/// Step of the position for derivatives, as a share of the distance.
const DELTA: f64 = 1e-5;

/// A box that shows an object.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// In whose image it is.
    pub camera: &'a Camera,
    /// px
    pub bbox: BBox,
}

/// How an object's projection differs from a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// From the box's center to that of the projection, px.
    pub offset: Vector2<f64>,
    /// Square root of the box's area, px.
    pub side: f64,
    /// Logarithm of the projection's side over the box's.
    pub log_size: f64,
    /// Logarithm of the projection's width over its height, less the same of the box.
    pub log_aspect: f64,
    /// Standard deviations of a detected box: of its center and of the logarithm of its size, as shares
    /// of its side.
    pub box_sigma: [f64; 2],
}

impl Residual {
    /// Length of the offset as a share of the box's side.
    pub fn offset_share(&self) -> f64 {
        self.offset.norm() / self.side
    }

    /// How many standard deviations of a detected box it is off, in place and size together.
    ///
    /// A box of another shape than the projection is wrong by itself: one side that is off changes
    /// center and size by half of what it changes the shape by. Half of that is laid to the box.
    pub fn deviation(&self) -> f64 {
        let by_shape = self.log_aspect / 4.0;
        let [center, size] = self.box_sigma.map(|sigma| sigma.hypot(by_shape));
        (self.offset_share() / center).hypot(self.log_size / size)
    }

    /// Whether it is off in size more than in place.
    pub fn is_of_size(&self) -> bool {
        self.log_size.abs() / self.box_sigma[1] > self.offset_share() / self.box_sigma[0]
    }
}

/// What the boxes of one object say.
#[derive(Debug, Clone)]
pub struct Agreement {
    /// Of the pose that was found, by sight.
    pub found: Vec<Residual>,
    /// Of the same rotation where the boxes agree best, by sight.
    pub nearest: Vec<Residual>,
    /// From the found position to that one, world frame, metres.
    pub shift: Vector3<f64>,
}

/// How well the boxes that show an object agree with each other and with its pose.
///
/// - `points`: on its surface, object frame, metres
/// - `box_sigma`: see [`Residual::box_sigma`]
/// - returns: `None` where a camera's lens does not image the whole object
pub fn agreement(
    points: &[SurfacePoint],
    sights: &[Sight],
    world_from_obj: &Isometry3<f64>,
    box_sigma: [f64; 2],
) -> Option<Agreement> {
    let at = |position: &Vector3<f64>| {
        let pose = Isometry3::from_parts((*position).into(), world_from_obj.rotation);
        let all = sights
            .iter()
            .map(|sight| residual(points, sight, &pose, box_sigma));
        all.collect::<Option<Vec<Residual>>>()
    };
    let start = world_from_obj.translation.vector;
    let found = at(&start)?;
    let (mut position, mut nearest) = (start, found.clone());
    for _ in 0..STEPS {
        let Some(next) = step(sights, &position, &nearest, at) else {
            break;
        };
        let Some(there) = at(&next).filter(|there| cost(there) < cost(&nearest)) else {
            break;
        };
        (position, nearest) = (next, there);
    }
    Some(Agreement {
        found,
        nearest,
        shift: position - start,
    })
}

/// The extent of an object's points in an image, px; `None` where the lens does not image all of them.
pub fn extent(
    points: &[SurfacePoint],
    camera: &Camera,
    world_from_obj: &Isometry3<f64>,
) -> Option<BBox> {
    let cam_from_obj = camera.world_from_cam().inv_mul(world_from_obj);
    let pixel = |point: &SurfacePoint| {
        let in_cam = cam_from_obj * Point3::from(point.position);
        camera.intrinsics().project(&in_cam)
    };
    BBox::around(points.iter().map(pixel)).filter(BBox::is_proper)
}

/// How far beside its line of sight an object is by a residual, metres.
pub fn miss(sight: &Sight, residual: &Residual, world_from_obj: &Isometry3<f64>) -> Option<f64> {
    let center = sight.bbox.center();
    let ray = |pixel: Point2<f64>| sight.camera.intrinsics().unproject(&pixel);
    let angle = ray(center)?.angle(ray(center + residual.offset)?.as_ref());
    let from_camera =
        world_from_obj.translation.vector - sight.camera.world_from_cam().translation.vector;
    Some(from_camera.norm() * angle)
}

fn residual(
    points: &[SurfacePoint],
    sight: &Sight,
    world_from_obj: &Isometry3<f64>,
    box_sigma: [f64; 2],
) -> Option<Residual> {
    let whole = extent(points, sight.camera, world_from_obj)?;
    // A box ends where the image does. Far off it, there is nothing to cut.
    let shown = whole.clip(sight.camera.width(), sight.camera.height());
    let shown = shown.unwrap_or(whole);
    let side = |bbox: &BBox| (bbox.width() * bbox.height()).sqrt();
    let aspect = |bbox: &BBox| bbox.width() / bbox.height();
    let residual = Residual {
        offset: shown.center() - sight.bbox.center(),
        side: side(&sight.bbox),
        log_size: (side(&shown) / side(&sight.bbox)).ln(),
        log_aspect: (aspect(&shown) / aspect(&sight.bbox)).ln(),
        box_sigma,
    };
    residual.deviation().is_finite().then_some(residual)
}

/// Offset along both axes and size, in standard deviations of a box of the right shape.
fn numbers(residual: &Residual) -> Vector3<f64> {
    let offset = residual.offset / (residual.side * residual.box_sigma[0]);
    Vector3::new(
        offset.x,
        offset.y,
        residual.log_size / residual.box_sigma[1],
    )
}

fn cost(residuals: &[Residual]) -> f64 {
    residuals.iter().map(|r| numbers(r).norm_squared()).sum()
}

/// The position after a step of Gauss-Newton; `None` where there is no way on.
fn step(
    sights: &[Sight],
    position: &Vector3<f64>,
    now: &[Residual],
    at: impl Fn(&Vector3<f64>) -> Option<Vec<Residual>>,
) -> Option<Vector3<f64>> {
    let origin = sights.first()?.camera.world_from_cam().translation.vector;
    let delta = DELTA * (position - origin).norm();
    let mut moved = Vec::new();
    for axis in 0..3 {
        let mut beside = *position;
        beside[axis] += delta;
        moved.push(at(&beside)?);
    }
    let (mut information, mut slope) = (Matrix3::zeros(), Vector3::zeros());
    for (sight, residual) in now.iter().enumerate() {
        let value = numbers(residual);
        let change = |axis: usize| (numbers(&moved[axis][sight]) - value) / delta;
        let by_position = Matrix3::from_columns(&[change(0), change(1), change(2)]);
        information += by_position.transpose() * by_position;
        slope += by_position.transpose() * value;
    }
    let step = information.cholesky()?.solve(&slope);
    step.iter().all(|x| x.is_finite()).then(|| position - step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Intrinsics, Projection};

    /// Focal length 500 px, beside each other, the second 0.4 m to the right.
    fn cameras() -> [Camera; 2] {
        [("left", 0.0), ("right", 0.4)].map(|(id, x)| {
            let intrinsics = Intrinsics::new(500., 500., 319.5, 239.5, Projection::Pinhole);
            let place = Isometry3::translation(x, 0.0, 0.0);
            Camera::new(id, [640, 480], intrinsics.unwrap(), place).unwrap()
        })
    }

    /// A square of 0.1 m, upright: it is 50 px wide 1 m away.
    fn square() -> Vec<SurfacePoint> {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let point = |(x, y)| SurfacePoint {
            position: [0.05 * x, 0.05 * y, 0.0],
            color: [0; 3],
        };
        corners.map(point).to_vec()
    }

    fn boxes(cameras: &[Camera; 2], place: Isometry3<f64>) -> [BBox; 2] {
        [0, 1].map(|i| extent(&square(), &cameras[i], &place).unwrap())
    }

    fn judged(cameras: &[Camera; 2], boxes: [BBox; 2], found: Isometry3<f64>) -> Agreement {
        let sights = [0, 1].map(|i| Sight {
            camera: &cameras[i],
            bbox: boxes[i],
        });
        agreement(&square(), &sights, &found, [0.006, 0.022]).unwrap()
    }

    #[test]
    fn position_that_is_off_is_not_laid_to_the_rig() {
        let cameras = cameras();
        let place = Isometry3::translation(0.2, 0.0, 1.0);
        let boxes = boxes(&cameras, place);
        assert_eq!(<[f64; 4]>::from(boxes[0]), [394.5, 214.5, 444.5, 264.5]);
        // 10 mm are 5 px.
        let off = Isometry3::translation(0.21, 0.0, 1.0);
        let Agreement {
            found,
            nearest,
            shift,
        } = judged(&cameras, boxes, off);
        for residual in found {
            assert!((residual.offset - Vector2::new(5.0, 0.0)).norm() < 1e-9);
            assert!(
                (residual.offset_share() - 0.1).abs() < 1e-9 && residual.log_size.abs() < 1e-12
            );
        }
        assert!((shift - Vector3::new(-0.01, 0.0, 0.0)).norm() < 1e-6);
        assert!(nearest.iter().all(|residual| residual.deviation() < 1e-2));
    }

    #[test]
    fn lines_that_miss_each_other_share_the_miss() {
        let cameras = cameras();
        let place = Isometry3::translation(0.2, 0.0, 1.0);
        let mut boxes = boxes(&cameras, place);
        (boxes[1].y0, boxes[1].y1) = (boxes[1].y0 + 4.0, boxes[1].y1 + 4.0);
        let sight = Sight {
            camera: &cameras[1],
            bbox: boxes[1],
        };
        let nearest = judged(&cameras, boxes, place).nearest;
        for (residual, down) in nearest.iter().zip([2.0, -2.0]) {
            assert!((residual.offset - Vector2::new(0.0, down)).norm() < 1e-3);
            assert!(!residual.is_of_size());
        }
        // 2 px, 1.02 m away along a line that is 11.3 degrees off the axis: 4 mm.
        let miss = miss(&sight, &nearest[1], &place).unwrap();
        assert!((miss - 0.004).abs() < 1e-4, "{miss}");
    }

    #[test]
    fn size_tells_cameras_that_stand_too_far_apart() {
        let cameras = cameras();
        let place = Isometry3::translation(0.2, 0.0, 1.0);
        let boxes = boxes(&cameras, place);
        let longer = cameras.map(|camera| {
            let intrinsics = Intrinsics::new(550., 550., 319.5, 239.5, Projection::Pinhole);
            let pose = *camera.world_from_cam();
            Camera::new(camera.id(), [640, 480], intrinsics.unwrap(), pose).unwrap()
        });
        // The lines meet 1.1 times as far away, where 550 px show the square as large as 500 px did.
        for residual in judged(&longer, boxes, place).nearest {
            assert!(residual.offset_share() < 2e-3, "{residual:?}");
            assert!(residual.log_size.abs() < 2e-3, "{residual:?}");
        }
        // Not so where they stand 1.1 times as far apart.
        let apart = longer.map(|camera| {
            let x = camera.world_from_cam().translation.x * 1.1;
            let intrinsics = Intrinsics::new(500., 500., 319.5, 239.5, Projection::Pinhole);
            let pose = Isometry3::translation(x, 0.0, 0.0);
            Camera::new(camera.id(), [640, 480], intrinsics.unwrap(), pose).unwrap()
        });
        let nearest = judged(&apart, boxes, Isometry3::translation(0.22, 0.0, 1.1)).nearest;
        for residual in nearest {
            assert!(
                (residual.log_size + 1.1f64.ln()).abs() < 0.02,
                "{residual:?}"
            );
            assert!(residual.is_of_size());
        }
    }

    #[test]
    fn box_of_another_shape_weighs_less() {
        let off = |log_aspect| Residual {
            offset: Vector2::new(3.0, 0.0),
            side: 100.0,
            log_size: 0.0,
            log_aspect,
            box_sigma: [0.006, 0.022],
        };
        assert!((off(0.0).deviation() - 5.0).abs() < 1e-9);
        // 0.03 / hypot(0.006, 0.008)
        assert!((off(-0.032).deviation() - 3.0).abs() < 1e-9);
    }
}
