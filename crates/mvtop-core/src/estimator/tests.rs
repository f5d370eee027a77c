//! The whole flow with a network that answers from geometry alone.

mod arguments;
mod closer;
mod coordinates;
mod detected;
mod doubts;
mod frames;
mod instances;
mod judged;
mod occlusion;
mod proposers;
mod rematch;
mod wanted;

use super::grouping::mean_rotation;
use super::*;
use crate::bundle::{Class, CloseUps, Detector, Input};
use crate::image::Letterbox;
use crate::network::{Decoded, DetectorMaps, Queries};
use crate::rays::LosEncoding;
use crate::symmetry::Symmetry;
use crate::{BBox, Camera, Error, Intrinsics, Projection};
use image::RgbImage;
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use ndarray::{Array2, Array3, Array4, ArrayView1, ArrayView2, ArrayView3, ArrayView4, array, s};

const RADIUS: f64 = 0.07;
const STRIDE: usize = 8;
const NET: (u32, u32) = (320, 240);
const CLOSE: u32 = 96;

fn bundle() -> Bundle {
    Bundle {
        dir: "bundle".into(),
        preset: "geometry".into(),
        input: Input {
            width: NET.0,
            height: NET.1,
            mean: [0.5; 3],
            std: [0.25; 3],
        },
        los_encoding: LosEncoding::OriginDirection,
        classes: vec![Class {
            id: 7,
            name: "ball".into(),
            diameter_m: 2.0 * RADIUS,
            symmetry: Symmetry::default(),
            mesh: None,
            coordinates_extent_m: None,
            points: vec![],
        }],
        detector: Detector {
            score_threshold: 0.3,
            agree_threshold: None,
            nms_iou: 0.5,
        },
        scorer: None,
        inference: InferenceConfig::default(),
        closeups: CloseUps {
            size: CLOSE,
            strides: vec![STRIDE, 16],
            graph: "closeup.onnx".into(),
        },
        features: "features.onnx".into(),
        decoder: Some("decoder.onnx".into()),
        portable: false,
        self_test: None,
        provenance: serde_json::Value::Null,
    }
}

/// Whether a rotation is the mean of some of these: answers that differ are other hypotheses.
fn is_mean_of_some(rotation: &UnitQuaternion<f64>, turns: &[UnitQuaternion<f64>]) -> bool {
    (1..1 << turns.len()).any(|some: u32| {
        let chosen = turns.iter().enumerate().filter(|(n, _)| some >> n & 1 == 1);
        let mean = mean_rotation(chosen.map(|(_, turn)| (1.0, *turn)));
        rotation.angle_to(&mean) < 1e-6
    })
}

/// Looks from `center` at the point one metre above the world's origin.
fn camera(id: &str, size: (u32, u32), f: f64, center: [f64; 3]) -> Camera {
    let center = Vector3::from(center);
    let z = (Vector3::new(0.0, 0.0, 1.0) - center).normalize();
    let rotation = UnitQuaternion::face_towards(&z, &Vector3::new(0.0, 0.0, -1.0));
    let (cx, cy) = (f64::from(size.0) / 2.0 - 0.5, f64::from(size.1) / 2.0 - 0.5);
    let intrinsics = Intrinsics::new(f, f, cx, cy, Projection::Pinhole).unwrap();
    let world_from_cam = Isometry3::from_parts(Translation3::from(center), rotation);
    Camera::new(id, size.into(), intrinsics, world_from_cam).unwrap()
}

/// Cameras of three sizes, shapes and focal lengths.
fn rig() -> Rig {
    let cameras = vec![
        camera("left", (320, 240), 300.0, [-1.2, -0.8, 1.2]),
        camera("middle", (200, 200), 260.0, [0.1, -1.5, 0.7]),
        camera("right", (640, 360), 500.0, [1.1, -0.9, 1.5]),
    ];
    Rig::new(cameras, 0).unwrap()
}

const BALLS: [[f64; 3]; 2] = [[-0.1, 0.05, 1.0], [0.15, -0.05, 1.1]];

/// Box of a ball in a camera's image.
fn ball_box(camera: &Camera, ball: [f64; 3]) -> BBox {
    let in_camera = camera.world_from_cam().inverse() * Point3::from(ball);
    let center = camera.intrinsics().project(&in_camera).unwrap();
    let radius = camera.intrinsics().fx() * RADIUS / in_camera.z;
    BBox {
        x0: center.x - radius,
        y0: center.y - radius,
        x1: center.x + radius,
        y1: center.y + radius,
    }
}

/// Detects the balls, and puts every object where the axes of its close-ups meet, which look at the
/// middles of its boxes; what one view sees as far away as the ball of about that size.
struct Geometry {
    /// Boxes of each image, in the rig's order.
    boxes: Vec<Vec<BBox>>,
    letterboxes: Vec<Letterbox>,
    /// Of all balls from the cameras of the images, metres.
    distances: Vec<f64>,
    /// What a network in disorder does to its answer.
    disorder: fn(&mut Decoded),
    /// Likewise, to the detector's.
    detector_disorder: fn(&mut DetectorMaps),
}

impl Geometry {
    /// - `seen`: for each image, the camera's index and the balls seen there
    fn new(rig: &Rig, seen: &[(usize, &[[f64; 3]])]) -> Self {
        let cameras = || seen.iter().map(|&(index, _)| &rig.cameras()[index]);
        let boxes = cameras()
            .zip(seen)
            .map(|(camera, (_, balls))| balls.iter().map(|&ball| ball_box(camera, ball)).collect());
        let distances = |camera: &Camera| {
            let center = camera.world_from_cam().translation.vector;
            BALLS.map(|ball| (Vector3::from(ball) - center).norm())
        };
        let letterbox = |c: &Camera| Letterbox::new(c.width(), c.height(), NET.0, NET.1);
        Self {
            boxes: boxes.collect(),
            letterboxes: cameras().map(letterbox).collect(),
            distances: cameras().flat_map(distances).collect(),
            disorder: |_| (),
            detector_disorder: |_| (),
        }
    }
}

impl Network for Geometry {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        let views = self.boxes.len();
        assert_eq!(images.dim(), (views, 3, NET.1 as usize, NET.0 as usize));
        let (h, w) = (NET.1 as usize / STRIDE, NET.0 as usize / STRIDE);
        let mut scores = Array4::zeros((views, 1, h, w));
        let mut maps = Array4::zeros((views, 4, h, w));
        for (v, boxes) in self.boxes.iter().enumerate() {
            for (i, &bbox) in boxes.iter().enumerate() {
                let bbox = self.letterboxes[v].net_box(bbox);
                let [column, row] = [bbox.center().x, bbox.center().y].map(|x| x as usize / STRIDE);
                scores[(v, 0, row, column)] = 0.9 - 0.1 * i as f32;
                for (side, value) in <[f64; 4]>::from(bbox).into_iter().enumerate() {
                    maps[(v, side, row, column)] = value as f32;
                }
            }
        }
        let mut maps = DetectorMaps {
            scores,
            boxes: maps,
        };
        (self.detector_disorder)(&mut maps);
        Ok(maps)
    }

    /// The memory is the cells' rays, so that the decoder can tell whose they are.
    fn encode(
        &self,
        pictures: ArrayView4<f32>,
        camera_rays: ArrayView3<f32>,
    ) -> Result<Array3<f32>> {
        let size = CLOSE as usize;
        assert_eq!(pictures.dim(), (camera_rays.dim().0, 3, size, size));
        Ok(camera_rays.to_owned())
    }

    /// The object where it is, turned as the anchor is.
    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        assert_eq!(queries.class_index.len(), 1, "each object has its memory");
        assert!(queries.valid.iter().all(|&valid| valid == 1.0));
        // Rotations keep angles: the one between two cells' rays tells the cameras apart.
        let angle = |rays: ArrayView2<f32>| rays.row(70).dot(&rays.row(83));
        for (rays, memory) in queries.rays.outer_iter().zip(memory.outer_iter()) {
            assert!((angle(rays.slice(s![.., 3..])) - angle(memory)).abs() < 1e-5);
        }
        let views = queries.rays.outer_iter().zip(queries.box_rays.outer_iter());
        let axes: Vec<_> = views.map(|(rays, one)| axis(rays, one.row(0))).collect();
        assert!(axes[0].0.norm() < 1e-6, "the anchor is the origin");
        let center = match &axes[..] {
            [(_, direction)] => {
                let half_width = queries.box_rays.slice(s![0, 0, 6..9]);
                let half_width = half_width.mapv(|x| f64::from(x).powi(2)).sum().sqrt() / 10.0;
                let by_size = RADIUS / half_width;
                let nearest =
                    |a: &f64, b: &f64| (a - by_size).abs().total_cmp(&(b - by_size).abs());
                let known = self.distances.iter().copied().min_by(nearest);
                direction * known.unwrap_or(by_size)
            }
            axes => nearest_point(axes),
        };
        let mut decoded = Decoded {
            rotation_6d: array![[2.0, 0.0, 0.0, 0.0, 3.0, 0.0]],
            translation: array![[center.x as f32, center.y as f32, center.z as f32]],
            sigma: array![[0.5, 0.5]],
            hypotheses: None,
        };
        (self.disorder)(&mut decoded);
        Ok(decoded)
    }

    fn provider(&self) -> &str {
        "geometry"
    }
}

/// Origin and direction of a close-up's axis: between its four cells in the middle, or where these are off
/// the image, through the middle of its box.
///
/// - `rays`: `[N, 6]`, origin and direction of each cell
fn axis(rays: ArrayView2<f32>, box_rays: ArrayView1<f32>) -> (Vector3<f64>, Vector3<f64>) {
    let vector = |numbers: ArrayView1<f32>| Vector3::from_fn(|i, _| f64::from(numbers[i]));
    let cells = CLOSE as usize / STRIDE;
    let middle = [cells / 2 - 1, cells / 2];
    let four = middle
        .iter()
        .flat_map(|row| middle.map(|column| row * cells + column));
    let four: Vec<_> = four.map(|cell| vector(rays.slice(s![cell, 3..]))).collect();
    let direction = match four.iter().all(|ray| ray.norm() > 0.5) {
        true => four.iter().sum(),
        false => vector(box_rays.slice(s![3..6])),
    };
    (vector(box_rays.slice(s![..3])), direction.normalize())
}

/// The point with the least squared distance to lines.
fn nearest_point(lines: &[(Vector3<f64>, Vector3<f64>)]) -> Vector3<f64> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (origin, direction) in lines {
        let across = Matrix3::identity() - direction * direction.transpose();
        a += across;
        b += across * origin;
    }
    a.try_inverse().unwrap() * b
}

fn images(rig: &Rig, cameras: &[usize]) -> Vec<ViewImage> {
    let image = |&i: &usize| ViewImage {
        camera: i,
        // Not of one color, of which is warned.
        image: RgbImage::from_fn(
            rig.cameras()[i].width(),
            rig.cameras()[i].height(),
            |x, _| image::Rgb([x as u8; 3]),
        ),
    };
    cameras.iter().map(image).collect()
}

/// - `seen`: for each image, the camera's index and the balls seen there
fn predict(rig: &Rig, seen: &[(usize, &[[f64; 3]])], options: &PredictOptions) -> Prediction {
    let estimator = Estimator::new(bundle(), Box::new(Geometry::new(rig, seen)));
    let cameras: Vec<usize> = seen.iter().map(|view| view.0).collect();
    estimator
        .predict(rig, &images(rig, &cameras), options)
        .unwrap()
}

fn assert_at(object: &ObjectPose, ball: [f64; 3]) {
    let off = (object.world_from_obj.translation.vector - Vector3::from(ball)).norm();
    assert!(off < 1e-5, "{off} m off");
}

fn given(boxes: &[(&str, BBox)]) -> GivenBoxes {
    let boxes = boxes
        .iter()
        .map(|&(id, bbox)| (id.to_owned(), bbox))
        .collect();
    GivenBoxes {
        class: "ball".into(),
        boxes,
    }
}
