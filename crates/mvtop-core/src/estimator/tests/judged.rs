//! Rigs judged by what each view measures.

use super::*;
use crate::config::RigConfig;
use crate::estimator::rig_test::{Measurement, judge};
use nalgebra::{Matrix6, Vector6};

/// Numbers about 0, mostly within 1, the same in every run.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..12 {
            let next = self.0.wrapping_mul(6364136223846793005);
            self.0 = next.wrapping_add(1442695040888963407);
            sum += (self.0 >> 40) as f64 / (1u64 << 24) as f64;
        }
        sum - 6.0
    }
}

/// Objects around the origin, each measured by cameras around them, 1.2 m away.
///
/// - `error`: of a camera: a motion of the object as it sees it, by camera, its center and the object's
fn measured(
    cameras: usize,
    objects: usize,
    seed: u64,
    error: impl Fn(usize, &Vector3<f64>, &Vector3<f64>) -> Vector6<f64>,
) -> Vec<Measurement> {
    let mut noise = Noise(seed);
    let mut all = Vec::new();
    for object in 0..objects {
        let [x, y, z] = [0, 1, 2].map(|axis| (object * (axis + 2)) as f64 * 0.61 % 1.0 - 0.5);
        let center = Vector3::new(0.4 * x, 0.4 * y, 0.2 * z);
        for camera in 0..cameras {
            let (sin, cos) = (0.7 * camera as f64).sin_cos();
            let from = Vector3::new(1.2 * sin, -1.2 * cos, 0.5);
            let ray = center - from;
            let ahead = ray.normalize();
            // Turns of 2 degrees, 0.6 mm across, 7 mm along.
            let across = nalgebra::Matrix3::identity() - ahead * ahead.transpose();
            let root = across * 0.0006 + ahead * ahead.transpose() * 0.007;
            let mut covariance = Matrix6::identity() * 0.035f64.powi(2);
            covariance
                .fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&(root * root));
            let turn = Vector3::from_fn(|_, _| 0.035 * noise.next());
            let shift = root * Vector3::from_fn(|_, _| noise.next());
            let by_noise = Vector6::from_iterator(turn.iter().chain(&shift).copied());
            all.push(Measurement {
                object,
                class: 0,
                camera,
                motion: by_noise + error(camera, &from, &center),
                covariance,
                center: center.into(),
                camera_center: from.into(),
                axis: -from.normalize(),
            });
        }
    }
    all
}

#[test]
fn true_rigs_are_not_doubted() {
    let config = RigConfig::default();
    for (cameras, objects) in [(2, 1), (2, 4), (3, 3), (4, 5)] {
        for seed in 0..10 {
            let all = measured(cameras, objects, seed, |_, _, _| Vector6::zeros());
            let found = judge(&config, &all).unwrap();
            assert!(
                found.cameras < config.max_camera_deviation,
                "{cameras} {objects}: {found:?}"
            );
            assert!(
                found.scale < config.max_scale_deviation,
                "{cameras} {objects}: {found:?}"
            );
        }
    }
}

#[test]
fn true_rigs_of_many_cameras_are_not_doubted() {
    let config = RigConfig::default();
    for seed in 0..10 {
        let all = measured(8, 6, seed, |_, _, _| Vector6::zeros());
        let found = judge(&config, &all).unwrap();
        assert!(found.cameras < config.max_camera_deviation, "{found:?}");
    }
}

/// All centers of cameras too far from each other.
fn scaled(by: f64, seed: u64) -> Vec<Measurement> {
    measured(4, 5, seed, |_, from, _| {
        let mut motion = Vector6::zeros();
        motion.fixed_rows_mut::<3>(3).copy_from(&(from * by));
        motion
    })
}

#[test]
fn a_rig_of_another_scale_is_told_by_its_scale() {
    let config = RigConfig::default();
    for seed in 0..5 {
        let scale = |by| judge(&config, &scaled(by, seed)).unwrap();
        let (none, two, three) = (scale(0.0), scale(0.02), scale(0.03));
        assert!(none.scale < 2.0 && two.scale > 3.0, "{none:?} {two:?}");
        assert!(three.scale > config.max_scale_deviation, "{three:?}");
        for (found, by) in [(two, 0.02), (three, 0.03)] {
            assert!((found.by.abs() - by).abs() < 0.005, "{found:?}");
        }
        // The mesh may be that much too small instead, which its prior allows for.
        assert!(two.scale <= 0.02 / config.mesh_scale_sigma + 1.0, "{two:?}");
    }
}

#[test]
fn a_turned_camera_is_named() {
    let config = RigConfig::default();
    let (mut named, mut all) = (0, 0);
    let axes = [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.6, 0.0, 0.8],
    ];
    for (turned, axis) in (0..5).flat_map(|n| axes.map(|axis| (n, Vector3::from(axis)))) {
        let turn = axis * 1f64.to_radians();
        // What it shows is turned about the camera.
        let seen = measured(5, 5, all, |camera, from, center| match camera == turned {
            true => {
                let shift = turn.cross(&(center - from));
                Vector6::from_iterator(turn.iter().chain(&shift).copied())
            }
            false => Vector6::zeros(),
        });
        let found = judge(&config, &seen).unwrap();
        assert!(found.cameras > config.max_camera_deviation, "{found:?}");
        let by_scale = found.scale / config.max_scale_deviation;
        assert!(
            by_scale < found.cameras / config.max_camera_deviation,
            "{found:?}"
        );
        named += u64::from(found.worst_camera == turned);
        all += 1;
    }
    // Where it turns about its line of sight there is little to see.
    assert!(named >= all - 2, "{named} of {all}");
}

#[test]
fn an_object_that_one_view_takes_for_something_else_does_not_count() {
    let config = RigConfig::default();
    for seed in 0..5 {
        let mut all = measured(4, 5, seed, |_, _, _| Vector6::zeros());
        // The second camera has the first object upside down, and 5 cm beside its place.
        all[1].motion += Vector6::new(3.0, 0.0, 0.0, 0.05, 0.0, 0.0);
        let found = judge(&config, &all).unwrap();
        assert!(found.cameras < config.max_camera_deviation, "{found:?}");
        assert!(found.scale < config.max_scale_deviation, "{found:?}");
    }
}

#[test]
fn fewer_than_two_views_of_an_object_judge_nothing() {
    let config = RigConfig::default();
    assert_eq!(judge(&config, &[]), None);
    assert_eq!(
        judge(&config, &measured(1, 5, 1, |_, _, _| Vector6::zeros())),
        None
    );
    // Each object is seen by another camera.
    let all = measured(3, 3, 1, |_, _, _| Vector6::zeros());
    let apart = all.into_iter().filter(|one| one.object == one.camera);
    assert_eq!(judge(&config, &apart.collect::<Vec<_>>()), None);
}
