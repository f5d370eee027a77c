//! Close-ups: what a box shows, through a virtual camera of its own. A close-up is a crop of the
//! image's region of interest (RoI), taken as a camera would take it instead of cut out.
//!
//! The camera stands where the real one does, looks at the middle of the box, turned as little as
//! possible, and has the focal length at which the box's longer side fills `FILL` of the picture.
//! So the pose network sees every object in the same size and place, at the image's own resolution,
//! without the lens's distortion.

mod pixels;

use nalgebra::{Isometry3, Point2, Point3, Unit, UnitQuaternion, Vector3};
use ndarray::{Array2, Array3, ArrayViewMut2, ArrayViewMut3, Axis};
use rayon::prelude::*;

use crate::BBox;
use crate::camera::{Camera, Intrinsics, Projection};
use crate::image::{Letterbox, Pyramid};
use crate::parallel;
use crate::rays::camera_rays;

/// What the longer side of the box takes of the picture; the rest shows what is around it.
pub const FILL: f64 = 0.6;
/// Most samples along each axis of a pixel.
const MAX_TAPS: u32 = 8;
/// Px of the image per pixel of a network's picture, from which on a halved one is read. Networks
/// are trained on means of this many samples.
const SMOOTH: f64 = 4.0;
/// The same for the refinement, which reads one sample per pixel.
const SHARP: f64 = 1.5;

/// A virtual pinhole camera that looks at a box of a real one's image.
#[derive(Debug, Clone)]
pub struct CloseUp {
    /// The virtual camera; its id is the real one's.
    pub camera: Camera,
    /// The box in its picture.
    pub bbox: BBox,
    /// Pixels of the real image along each axis of a pixel.
    step: f64,
    cam_from_close: UnitQuaternion<f64>,
}

impl CloseUp {
    /// The close-up of `size` px a side of a box in an image of `camera`.
    ///
    /// `None` where the lens gives no rays for the box, or it spans half the view around.
    pub fn new(camera: &Camera, bbox: BBox, size: u32) -> Option<Self> {
        let BBox { x0, y0, x1, y1 } = bbox;
        let (xc, yc) = (bbox.center().x, bbox.center().y);
        let ray = |u, v| camera.intrinsics().unproject(&Point2::new(u, v));
        let close_from_cam =
            UnitQuaternion::rotation_between_axis(&ray(xc, yc)?, &Vector3::z_axis())?;
        // Where the lines of sight of the box's sides meet the plane one unit ahead.
        let on_plane = |u, v| {
            let ray = close_from_cam * ray(u, v)?;
            (ray.z > 0.0).then(|| [ray.x / ray.z, ray.y / ray.z])
        };
        let (left, right) = (on_plane(x0, yc)?[0], on_plane(x1, yc)?[0]);
        let (top, bottom) = (on_plane(xc, y0)?[1], on_plane(xc, y1)?[1]);
        let across_px = bbox.width().max(bbox.height());
        Self::looking(
            camera,
            close_from_cam,
            [left, top, right, bottom],
            across_px,
            size,
        )
    }

    /// Whether there is one of a box.
    pub fn is_of(camera: &Camera, bbox: BBox) -> bool {
        const ANY: u32 = 64;
        Self::new(camera, bbox, ANY).is_some()
    }

    /// The close-up of `size` px a side of what lies at some points, as a box about them would have it
    /// in the image of a camera that is rolled about its line of sight to their middle.
    ///
    /// `None` where one of them is not in front of it.
    ///
    /// - `points`: in the frame of `camera`, metres
    /// - `roll`: radians
    pub fn rolled(camera: &Camera, points: &[Point3<f64>], roll: f64, size: u32) -> Option<Self> {
        let middle = points
            .iter()
            .map(|point| point.coords)
            .sum::<Vector3<f64>>();
        let ahead = UnitQuaternion::rotation_between_axis(
            &Unit::try_new(middle, 0.0)?,
            &Vector3::z_axis(),
        )?;
        let rolled_from_cam = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll) * ahead;
        let middle = box_ahead(points, &rolled_from_cam)?.center();
        let middle = Vector3::new(middle.x, middle.y, 1.0);
        let close_from_rolled = UnitQuaternion::rotation_between(&middle, &Vector3::z())?;
        let close_from_cam = close_from_rolled * rolled_from_cam;
        let sides = box_ahead(points, &close_from_cam)?;
        let across_px = sides.width().max(sides.height()) * camera.intrinsics().fx();
        Self::looking(camera, close_from_cam, sides.into(), across_px, size)
    }

    /// - `sides`: left, top, right and bottom of the box, on the plane one unit ahead
    /// - `across_px`: the longer side of the box in the real image
    fn looking(
        camera: &Camera,
        close_from_cam: UnitQuaternion<f64>,
        sides: [f64; 4],
        across_px: f64,
        size: u32,
    ) -> Option<Self> {
        let [left, top, right, bottom] = sides;
        let reach = (-left).max(right).max(-top).max(bottom);
        let side = f64::from(size);
        let (focal, middle) = (FILL * side / 2.0 / reach, (side - 1.0) / 2.0);
        let cam_from_close = close_from_cam.inverse();
        let intrinsics = Intrinsics::new(focal, focal, middle, middle, Projection::Pinhole).ok()?;
        let world_from_close = camera.world_from_cam()
            * Isometry3::from_parts(Vector3::zeros().into(), cam_from_close);
        Some(Self {
            camera: Camera::new(camera.id(), [size; 2], intrinsics, world_from_close).ok()?,
            bbox: sides.map(|x| x * focal + middle).into(),
            step: across_px / (FILL * side),
            cam_from_close,
        })
    }

    /// How its picture lies in the network's input: as it is.
    pub fn letterbox(&self) -> Letterbox {
        let (width, height) = (self.camera.width(), self.camera.height());
        Letterbox::new(width, height, width, height)
    }

    /// The picture as the network takes it, from the image of the real camera.
    ///
    /// A pixel is the mean of some bilinear samples of the image, halved where it is large; then `(x/255 - mean)/std`; 0 where its center is
    /// off the image.
    ///
    /// - returns: `[3, size, size]`
    pub fn picture(
        &self,
        real: &Camera,
        image: &Pyramid,
        mean: [f32; 3],
        std: [f32; 3],
    ) -> Array3<f32> {
        let size = self.camera.width() as usize;
        let mut picture = Array3::zeros((3, size, size));
        self.fill(picture.view_mut(), real, image, mean, std);
        picture
    }

    /// [`CloseUp::picture`] into zeros.
    ///
    /// - `picture`: `[3, size, size]`
    pub(crate) fn fill(
        &self,
        mut picture: ArrayViewMut3<f32>,
        real: &Camera,
        image: &Pyramid,
        mean: [f32; 3],
        std: [f32; 3],
    ) {
        let job = self.job(real, image, SMOOTH);
        let size = self.camera.width() as usize;
        let rows = picture.axis_iter_mut(Axis(1)).enumerate().collect();
        parallel::each(rows, |(v, mut row): (usize, ArrayViewMut2<f32>)| {
            let mut pixels = vec![None; size];
            pixels::row(&job, v, &mut pixels);
            for (c, mut channel) in row.outer_iter_mut().enumerate() {
                for (out, pixel) in channel.iter_mut().zip(&pixels) {
                    *out = pixel.map_or(0.0, |rgb| (rgb[c] / 255.0 - mean[c]) / std[c]);
                }
            }
        });
    }

    /// R, G and B, 0 to 255, of its pixels, row by row, from the image of the real camera.
    ///
    /// A pixel is one bilinear sample of the image, halved where it is large; `None` off the image.
    pub fn pixels(&self, real: &Camera, image: &Pyramid) -> Vec<Option<[f32; 3]>> {
        let size = self.camera.width() as usize;
        let job = self.job(real, image, SHARP);
        let mut pixels = vec![None; size * size];
        let rows = pixels.par_chunks_mut(size).enumerate();
        rows.for_each(|(v, row)| pixels::row(&job, v, row));
        pixels
    }

    /// - `most`: px of the image that is read per pixel: a larger one is halved until it has fewer
    fn job<'a>(&self, real: &'a Camera, image: &'a Pyramid, most: f64) -> pixels::Job<'a> {
        let (image, halved) = image.of_step(self.step, most);
        let scale = 0.5_f64.powi(halved as i32);
        let taps = match most <= SHARP {
            true => 1,
            false => ((self.step * scale).ceil() as u32).clamp(1, MAX_TAPS),
        };
        pixels::Job {
            directions: self.directions(),
            taps,
            real,
            image: pixels::Between::new(image, scale),
        }
    }

    /// Direction in which each feature cell looks, in the close-up's frame; 0 for cells whose center
    /// is off the real camera's image.
    ///
    /// - returns: `[N, 3]`, as [`camera_rays`]
    pub fn camera_rays(&self, real: &Camera, strides: &[usize]) -> Array2<f32> {
        let mut rays = camera_rays(&self.camera, &self.letterbox(), strides);
        for mut ray in rays.axis_iter_mut(Axis(0)) {
            let direction = Vector3::from_fn(|i, _| f64::from(ray[i]));
            let direction = (self.cam_from_close * direction).into();
            if on_image(real, &direction).is_none() {
                ray.fill(0.0);
            }
        }
        rays
    }

    /// Whether pixel (u, v) looks at something on the real camera's image.
    pub fn shows(&self, real: &Camera, u: f64, v: f64) -> bool {
        on_image(real, &self.directions().of(u, v)).is_some()
    }

    fn directions(&self) -> Directions {
        let close = self.camera.intrinsics();
        let turn = self.cam_from_close.to_rotation_matrix();
        let [right, down] = [0, 1].map(|axis| turn.matrix().column(axis) / close.fx());
        let axis = turn.matrix().column(2).into_owned();
        Directions {
            first: axis - right * close.cx() - down * close.cy(),
            right,
            down,
        }
    }
}

/// Box of points on the plane one unit ahead; `None` where one of them is not in front.
fn box_ahead(points: &[Point3<f64>], close_from_cam: &UnitQuaternion<f64>) -> Option<BBox> {
    let at = |point: &Point3<f64>| {
        let ahead = close_from_cam * point;
        (ahead.z > 0.0).then(|| Point2::new(ahead.x / ahead.z, ahead.y / ahead.z))
    };
    BBox::around(points.iter().map(at))
}

/// Where pixels look, in the real camera's frame: linear in column and row.
struct Directions {
    /// Of pixel (0, 0).
    first: Vector3<f64>,
    /// How the next column's differs.
    right: Vector3<f64>,
    /// How the next row's differs.
    down: Vector3<f64>,
}

impl Directions {
    /// Of a place (u, v) in the picture; of any length.
    #[inline]
    fn of(&self, u: f64, v: f64) -> Point3<f64> {
        (self.first + self.right * u + self.down * v).into()
    }
}

/// Where the camera's image shows what lies in a direction, if it does.
#[inline]
fn on_image(camera: &Camera, direction: &Point3<f64>) -> Option<Point2<f64>> {
    let at = camera.intrinsics().project(direction)?;
    is_on_image(camera, &at).then_some(at)
}

#[inline]
fn is_on_image(camera: &Camera, at: &Point2<f64>) -> bool {
    (-0.5..=f64::from(camera.width()) - 0.5).contains(&at.x)
        && (-0.5..=f64::from(camera.height()) - 0.5).contains(&at.y)
}
