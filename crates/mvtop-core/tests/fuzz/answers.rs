//! Predictions, checks of rigs, refinement and trackers answer whatever rig, mesh or order of images
//! comes with numbers that are some, or with a sentence.

use std::sync::{Arc, LazyLock};

use ::image::RgbImage;
use mvtop_core::annotations::{self, TruePose};
use mvtop_core::calibration::{Expected, observe};
use mvtop_core::image::Pyramid;
use mvtop_core::prediction::Sigma;
use mvtop_core::refine::{Refiner, View};
use mvtop_core::{
    Estimator, Intrinsics, Options, PredictOptions, Rig, Tracker, ViewImage, image, mesh,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::mutate::{changed, edits};
use crate::{answered, good, repo};

/// Each case runs a network, some of them often: a share of the cases of files that are read.
fn one_in(so_many: u32) -> ProptestConfig {
    let usual = ProptestConfig::default();
    ProptestConfig {
        cases: usual.cases.div_ceil(so_many),
        ..usual
    }
}

/// The example's rig, images and known poses, and the network that finds them.
struct Example {
    rig: Rig,
    images: Vec<ViewImage>,
    known: Vec<TruePose>,
    estimator: Arc<Estimator>,
}

static EXAMPLE: LazyLock<Example> = LazyLock::new(|| {
    let at = |file: &str| repo(&format!("examples/mvball/{file}"));
    let rig = Rig::load(&at("rig.json")).unwrap();
    let view = |(camera, of): (usize, &mvtop_core::Camera)| ViewImage {
        camera,
        image: image::load(&at(&format!("{}.png", of.id())), of).unwrap(),
    };
    Example {
        images: rig.cameras().iter().enumerate().map(view).collect(),
        rig,
        known: annotations::load_truth(&at("truth.json")).unwrap(),
        estimator: Arc::new(Estimator::load(&repo("models/mvball"), &Options::default()).unwrap()),
    }
});

/// What is wrong with a camera: a turn, a shift in metres, and what its focal length is multiplied by.
type Wrong = ([f64; 3], [f64; 3], f64);

fn wrong() -> impl Strategy<Value = Wrong> {
    let number = |most: f64| {
        prop_oneof![
            Just(0.0),
            -0.1 * most..0.1 * most,
            -most..most,
            -1e3 * most..1e3 * most
        ]
    };
    let three = |most: f64| prop::array::uniform3(number(most));
    let focal = prop_oneof![Just(1.0), 0.5..2.0, 0.01..100.0];
    (three(1.0), three(1.0), focal)
}

/// The example's rig with cameras that stand elsewhere and have other lenses, where that is a rig.
fn rig_of(wrong: &[Wrong; 2]) -> Option<Rig> {
    let rig = &EXAMPLE.rig;
    let mut cameras = rig.cameras().to_vec();
    for (camera, (turn, shift, focal)) in cameras.iter_mut().zip(wrong) {
        let off = Isometry3::from_parts(
            Translation3::from(Vector3::from(*shift)),
            UnitQuaternion::from_scaled_axis(Vector3::from(*turn)),
        );
        let (of, size) = (camera.intrinsics(), [camera.width(), camera.height()]);
        let (fx, fy) = (of.fx() * focal, of.fy() * focal);
        let lens = answered(Intrinsics::new(
            fx,
            fy,
            of.cx(),
            of.cy(),
            of.projection().clone(),
        ))?;
        let pose = camera.world_from_cam() * off;
        *camera = answered(mvtop_core::Camera::new(camera.id(), size, lens, pose))?;
    }
    answered(Rig::new(cameras, rig.reference()))
}

fn finite(pose: &Isometry3<f64>) -> bool {
    pose.to_homogeneous().iter().all(|x| x.is_finite())
}

proptest! {
    #![proptest_config(one_in(16))]

    #[test]
    fn predictions_with_any_rig(wrong in [wrong(), wrong()]) {
        let Some(rig) = rig_of(&wrong) else { return Ok(()) };
        let (estimator, images) = (&EXAMPLE.estimator, &EXAMPLE.images);
        let Some(prediction) = answered(estimator.predict(&rig, images, &PredictOptions::default()))
        else {
            return Ok(());
        };
        for object in &prediction.objects {
            prop_assert!(finite(&object.world_from_obj) && finite(&object.ref_from_obj));
            prop_assert!(object.sigma.rot_deg >= 0.0 && object.sigma.t_m.is_finite());
            prop_assert!(object.confidence.is_none_or(|p| (0.0..=1.0).contains(&p)));
            let share: f64 = object.hypotheses.iter().map(|one| one.probability).sum();
            prop_assert!((share - 1.0).abs() < 1e-9, "{share}");
            for edges in estimator.edges(&rig, images, object) {
                prop_assert!(edges.iter().all(|edge| edge.point.coords.norm().is_finite()));
            }
        }
        if let Some(fit) = &prediction.rig_consistency {
            prop_assert!(fit.px >= 0.0 && fit.deviation >= 0.0);
        }
    }

    #[test]
    fn refinement_on_any_mesh(edits in edits(), off in wrong()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        std::fs::write(&path, changed(&good("models/mvball/mvball.mesh.ply"), &edits)).unwrap();
        let Some(mesh) = answered(mesh::load_ply(&path, 1.0)) else { return Ok(()) };
        let refiner = Refiner::new(&mesh, 0.131);
        let Example { rig, images, known, .. } = &*EXAMPLE;
        let pyramids: Vec<Pyramid> = images.iter().map(|view| Pyramid::new(&view.image)).collect();
        let views: Vec<View> = images
            .iter()
            .zip(&pyramids)
            .map(|(view, image)| View { camera: &rig.cameras()[view.camera], image })
            .collect();
        let start = known[0].world_from_obj * Isometry3::new(Vector3::from(off.1), Vector3::from(off.0));
        for start in [&known[0].world_from_obj, &start] {
            let sigma = Sigma { rot_deg: 5.0, t_m: 0.003 };
            if let Some(found) = refiner.refine(&views, start, sigma) {
                prop_assert!(finite(&found.world_from_obj));
                prop_assert!((0.0..=1.0).contains(&found.contour_inliers));
            }
            for view in &views {
                let edges = refiner.edges(view, start);
                prop_assert!(edges.iter().all(|edge| edge.point.coords.norm().is_finite()));
            }
        }
    }

    /// Whatever is updated, removed and asked for, in any order: as a cold run has it.
    #[test]
    fn trackers_in_any_order(steps in prop::collection::vec((0..2usize, 0..4u8), 1..8)) {
        let Example { rig, images, estimator, .. } = &*EXAMPLE;
        let mut tracker = Tracker::new(estimator.clone(), Arc::new(rig.clone()));
        let mut kept: [Option<RgbImage>; 2] = [None, None];
        for (camera, action) in steps {
            let mut image = images[camera].image.clone();
            match action {
                0 => {
                    tracker.remove(camera);
                    kept[camera] = None;
                }
                1 => {
                    let wrong = vec![ViewImage { camera, image: RgbImage::new(8, 8) }];
                    prop_assert!(tracker.update(wrong).is_err());
                }
                _ => {
                    if action == 3 {
                        ::image::imageops::rotate180_in_place(&mut image);
                    }
                    kept[camera] = Some(image.clone());
                    tracker.update(vec![ViewImage { camera, image }]).unwrap();
                }
            }
            let images: Vec<ViewImage> = (0..2)
                .filter_map(|camera| Some(ViewImage { camera, image: kept[camera].clone()? }))
                .collect();
            let warm = answered(tracker.predict(&PredictOptions::default()));
            let cold = answered(estimator.predict(rig, &images, &PredictOptions::default()));
            let poses = |found: Option<mvtop_core::Prediction>| {
                found.map(|found| -> Vec<_> {
                    found.objects.iter().map(|one| one.world_from_obj).collect()
                })
            };
            let (warm, cold) = (poses(warm), poses(cold));
            prop_assert_eq!(warm.as_ref().map(Vec::len), cold.as_ref().map(Vec::len));
            for (a, b) in warm.unwrap_or_default().iter().zip(&cold.unwrap_or_default()) {
                let gap = (a.to_homogeneous() - b.to_homogeneous()).abs().max();
                prop_assert!(gap < 1e-5, "{}", gap);
            }
        }
    }
}

proptest! {
    #![proptest_config(one_in(64))]

    #[test]
    fn checks_of_any_rig(wrong in [wrong(), wrong()], sets in 1..3usize) {
        let Some(rig) = rig_of(&wrong) else { return Ok(()) };
        let (estimator, sets) = (&EXAMPLE.estimator, vec![EXAMPLE.images.clone(); sets]);
        let Some(seen) = answered(observe(estimator, &rig, &sets, Expected::default())) else {
            return Ok(());
        };
        prop_assert!(seen.noise_px() > 0.0 && seen.noise_px().is_finite());
        for pair in seen.pairs(&rig) {
            prop_assert!(pair.px >= 0.0);
        }
        prop_assert!(seen.problem().is_none_or(|problem| problem.len() > 10));
        if let Some(refined) = answered(seen.refined(&[1])) {
            prop_assert!(refined.rig.cameras().iter().all(|one| finite(one.world_from_cam())));
        }
    }
}
