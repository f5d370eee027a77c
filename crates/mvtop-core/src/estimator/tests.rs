//! The whole flow with a network that answers from geometry alone.

mod arguments;
mod closer;
mod closeups;
mod coordinates;
mod detected;
mod doubts;
mod frames;
mod instances;
mod judged;
mod occlusion;
mod proposers;
mod wanted;

use super::grouping::mean_rotation;
use super::*;
use crate::bundle::{Class, CloseUps, Detector, Input, PoseInput};
use crate::image::Letterbox;
use crate::network::{Decoded, DetectorMaps, Queries};
use crate::rays::LosEncoding;
use crate::symmetry::Symmetry;
use crate::{BBox, Camera, Error, Intrinsics, Projection};
use image::RgbImage;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use ndarray::{Array2, Array3, Array4, ArrayView2, ArrayView3, ArrayView4, array, s};

const RADIUS: f64 = 0.07;
const STRIDE: usize = 8;
const NET: (u32, u32) = (320, 240);

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
        poses: PoseInput::WholeImages {
            strides: vec![STRIDE, 16],
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

/// A network that knows where the balls are, and checks that all it is given agrees with that.
struct Geometry {
    /// Boxes of each image, in the rig's order.
    boxes: Vec<Vec<BBox>>,
    letterboxes: Vec<Letterbox>,
    /// Positions of every ball in the frame of every camera.
    in_cameras: Vec<Vector3<f64>>,
    /// What a network in disorder does to its answer.
    disorder: fn(&mut Decoded),
    /// Likewise, to the detector's.
    detector_disorder: fn(&mut DetectorMaps),
}

impl Geometry {
    /// - `seen`: for each image, the camera's index and the balls seen there
    fn new(rig: &Rig, seen: &[(usize, &[[f64; 3]])]) -> Self {
        let in_cameras = rig.cameras().iter().flat_map(|camera| {
            let cam_from_world = camera.world_from_cam().inverse();
            BALLS.map(|ball| (cam_from_world * Point3::from(ball)).coords)
        });
        let cameras = || seen.iter().map(|&(index, _)| &rig.cameras()[index]);
        let boxes = cameras()
            .zip(seen)
            .map(|(camera, (_, balls))| balls.iter().map(|&ball| ball_box(camera, ball)).collect());
        let letterbox = |c: &Camera| Letterbox::new(c.width(), c.height(), NET.0, NET.1);
        Self {
            boxes: boxes.collect(),
            letterboxes: cameras().map(letterbox).collect(),
            in_cameras: in_cameras.collect(),
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
    fn encode(&self, _: ArrayView4<f32>, camera_rays: ArrayView3<f32>) -> Result<Array3<f32>> {
        Ok(camera_rays.to_owned())
    }

    /// Objects where they are, turned as the anchor camera is.
    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let objects = queries.class_index.len();
        assert!(objects > 0, "nothing to decode");
        // Rotations keep angles: the one between two cells' rays tells the cameras apart.
        let angle = |rays: ArrayView2<f32>| rays.row(105).dot(&rays.row(125));
        for (rays, memory) in queries.rays.outer_iter().zip(memory.outer_iter()) {
            let encoded = angle(rays.slice(s![.., 3..]));
            assert!(
                (encoded - angle(memory)).abs() < 1e-5,
                "memory and rays of different views"
            );
        }
        let mut decoded = Decoded {
            rotation_6d: Array2::zeros((objects, 6)),
            translation: Array2::zeros((objects, 3)),
            sigma: Array2::from_elem((objects, 2), 0.5),
            hypotheses: None,
        };
        for q in 0..objects {
            let line = |v: usize| {
                let numbers = queries.box_rays.slice(s![v, q, ..]);
                let vector = |i: usize| Vector3::from_fn(|row, _| f64::from(numbers[3 * i + row]));
                (vector(0), vector(1))
            };
            let off = |v: usize, point: &Vector3<f64>| {
                let (origin, direction) = line(v);
                (point - origin).cross(&direction).norm()
            };
            let nearest = |a: &&Vector3<f64>, b: &&Vector3<f64>| off(0, a).total_cmp(&off(0, b));
            let center = *self.in_cameras.iter().min_by(nearest).unwrap();
            assert_eq!(queries.valid[(0, q)], 1.0, "the anchor sees its objects");
            assert!(line(0).0.norm() < 1e-6, "the anchor is the origin");
            for v in 0..queries.valid.nrows() {
                if queries.valid[(v, q)] == 1.0 {
                    assert!(off(v, &center) < 1e-4, "a box of another object");
                } else {
                    assert!(
                        queries
                            .box_rays
                            .slice(s![v, q, ..])
                            .iter()
                            .all(|&x| x == 0.0)
                    );
                    assert_eq!(queries.centers.slice(s![v, q, ..]), array![0.5, 0.5]);
                    assert_eq!(queries.half_sizes.slice(s![v, q, ..]), array![0.0, 0.0]);
                }
            }
            for axis in 0..3 {
                decoded.translation[(q, axis)] = center[axis] as f32;
            }
            decoded.rotation_6d[(q, 0)] = 2.0;
            decoded.rotation_6d[(q, 4)] = 3.0;
        }
        (self.disorder)(&mut decoded);
        Ok(decoded)
    }

    fn provider(&self) -> &str {
        "geometry"
    }
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
