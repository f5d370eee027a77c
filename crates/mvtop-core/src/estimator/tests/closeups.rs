//! Networks with close-ups.

use super::*;
use crate::closeup::CloseUp;

const CLOSE: u32 = 96;

/// Detects as `Geometry` does, and puts every object where its boxes' lines of sight meet; what one
/// view sees as far away as its size tells.
pub(super) struct Triangulation(pub(super) Geometry);

impl Network for Triangulation {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        self.0.detect(images)
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

    fn detect_and_encode(
        &self,
        _: ArrayView4<f32>,
        _: ArrayView3<f32>,
    ) -> Result<(DetectorMaps, Array3<f32>)> {
        panic!("rays of whole images are not needed")
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        assert_eq!(
            queries.class_index.len(),
            1,
            "every object has its own memory"
        );
        assert_eq!(memory.dim().0, queries.rays.dim().0);
        let angle = |rays: ArrayView2<f32>| rays.row(70).dot(&rays.row(83));
        for (rays, memory) in queries.rays.outer_iter().zip(memory.outer_iter()) {
            assert!((angle(rays.slice(s![.., 3..])) - angle(memory)).abs() < 1e-5);
        }
        assert!(queries.valid.iter().all(|&valid| valid == 1.0));
        // The point with the least squared distance to all lines.
        let (mut a, mut b) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
        for line in queries.box_rays.outer_iter() {
            let vector = |i: usize| Vector3::from_fn(|row, _| f64::from(line[(0, 3 * i + row)]));
            let across = nalgebra::Matrix3::identity() - vector(1) * vector(1).transpose();
            a += across;
            b += across * vector(0);
        }
        let center = match queries.box_rays.dim().0 {
            1 => {
                let numbers = queries.box_rays.slice(s![0, 0, ..]).mapv(f64::from);
                let half_width = numbers.slice(s![6..9]).mapv(|x| x * x).sum().sqrt() / 10.0;
                Vector3::from_fn(|axis, _| numbers[3 + axis]) * RADIUS / half_width
            }
            _ => a.try_inverse().unwrap() * b,
        };
        Ok(Decoded {
            rotation_6d: array![[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]],
            translation: array![[center.x as f32, center.y as f32, center.z as f32]],
            sigma: array![[1.0, 0.01]],
            hypotheses: None,
        })
    }

    fn provider(&self) -> &str {
        "triangulation"
    }
}

pub(super) fn closeup_bundle() -> Bundle {
    Bundle {
        poses: PoseInput::CloseUps(CloseUps {
            size: CLOSE,
            strides: vec![8, 16],
            graph: "closeup.onnx".into(),
        }),
        ..bundle()
    }
}

#[test]
fn closeups_look_at_their_object_from_every_camera_that_sees_it() {
    let rig = rig();
    let [first, second] = BALLS;
    // The second ball is hidden from the reference.
    let seen: [(usize, &[[f64; 3]]); 3] =
        [(0, &[first]), (1, &[second, first]), (2, &[first, second])];
    let network = Triangulation(Geometry::new(&rig, &seen));
    let estimator = Estimator::new(closeup_bundle(), Box::new(network));
    let prediction = estimator
        .predict(&rig, &images(&rig, &[0, 1, 2]), &PredictOptions::default())
        .unwrap();
    assert_eq!(prediction.objects.len(), 2);
    for object in &prediction.objects {
        let by_reference = object.cameras[0].bbox.is_some();
        let ball = if by_reference { first } else { second };
        let off = object.world_from_obj.translation.vector - Vector3::from(ball);
        // The middle of a box is not quite the middle of its close-up's box.
        assert!(off.norm() < 5e-3, "{off}");
        // Each answer is turned as its anchor's close-up.
        let turns: Vec<UnitQuaternion<f64>> = (rig.cameras().iter())
            .zip(&object.cameras)
            .filter_map(|(camera, seen)| CloseUp::new(camera, seen.bbox?, CLOSE))
            .map(|closeup| closeup.camera.world_from_cam().rotation)
            .collect();
        assert_eq!(turns.len(), if by_reference { 3 } else { 2 });
        assert!(is_mean_of_some(&object.world_from_obj.rotation, &turns));
    }
    assert!(prediction.timings.crop > 0.0);
}

#[test]
fn nothing_seen_needs_no_closeups() {
    let rig = rig();
    let network = Triangulation(Geometry::new(&rig, &[(0, &[]), (2, &[])]));
    let estimator = Estimator::new(closeup_bundle(), Box::new(network));
    let prediction = estimator
        .predict(&rig, &images(&rig, &[0, 2]), &PredictOptions::default())
        .unwrap();
    assert!(prediction.objects.is_empty());
}
