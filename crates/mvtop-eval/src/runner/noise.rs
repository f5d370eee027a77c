//! Disturbances that an evaluation adds to what is known exactly: calibration and true boxes.
//!
//! Each is drawn from a generator of its own, seeded by its name, so that it depends on neither the
//! order of samples nor the number of views, and grows in proportion to its size: a camera is turned
//! about the same axis by 0.5 and by 2 degrees. `docs/reference/json.md` gives the recipe.

use mvtop_core::annotations::GivenBoxes;
use mvtop_core::rays::BoxRays;
use mvtop_core::{BBox, Rig};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand::rngs::ChaCha20Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};
use sha2::{Digest, Sha256};

/// How much is added, and which draw; nothing by default.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation by which each side of the true boxes is moved, as a share of the box's size.
    pub boxes: f64,
    /// Angle by which every camera but the reference is turned about a random axis through its center.
    pub rig_deg: f64,
    /// Distance by which the center of every camera but the reference is moved in a random direction.
    pub rig_mm: f64,
    /// Which random axes and directions: the same seed gives the same ones, scaled, for any noise.
    pub seed: u64,
}

impl Noise {
    /// The rig with the poses of all cameras but the reference disturbed.
    ///
    /// # Errors
    /// [`mvtop_geometry::Error::Camera`] for a camera that is moved further than can be.
    pub fn disturb_rig(&self, rig: &Rig, sample: &str) -> mvtop_geometry::Result<Rig> {
        if self.rig_deg == 0.0 && self.rig_mm == 0.0 {
            return Ok(rig.clone()); // not even by rounding
        }
        rig.moved(|index, camera| {
            if index == rig.reference() {
                return *camera.world_from_cam();
            }
            let mut rng = self.generator(&format!("{sample}/{}/rig", camera.id()));
            let mut direction = || Vector3::from(UnitSphere.sample(&mut rng));
            let axis = Unit::new_normalize(direction());
            let cam_from_disturbed = Isometry3::from_parts(
                Translation3::from(direction() * (self.rig_mm / 1e3)),
                UnitQuaternion::from_axis_angle(&axis, self.rig_deg.to_radians()),
            );
            camera.world_from_cam() * cam_from_disturbed
        })
    }

    /// Moves the four sides of an object's box in every camera; a box of which nothing is left
    /// within the image, or that the lens has no rays for, goes, also without noise.
    ///
    /// - `object`: its place in the sample's truth
    pub fn disturb_boxes(&self, seen: &mut GivenBoxes, rig: &Rig, sample: &str, object: usize) {
        seen.boxes.retain(|id, bbox| {
            let (width, height) = (bbox.width(), bbox.height());
            let camera = rig.index_of(id).map(|index| &rig.cameras()[index]);
            let Some(camera) = camera.filter(|_| width >= 0.0 && height >= 0.0) else {
                return true; // A mistake, for the estimator to name.
            };
            let mut rng = self.generator(&format!("{sample}/{id}/box{object}"));
            let mut moved = |side: f64, size: f64| {
                let off: f64 = StandardNormal.sample(&mut rng);
                side + self.boxes * size * off
            };
            *bbox = BBox {
                x0: moved(bbox.x0, width),
                y0: moved(bbox.y0, height),
                x1: moved(bbox.x1, width),
                y1: moved(bbox.y1, height),
            };
            let clipped = (bbox.clip(camera.width(), camera.height()))
                .filter(|&bbox| BoxRays::new(camera, bbox).is_some());
            *bbox = clipped.unwrap_or(*bbox);
            clipped.is_some()
        });
    }

    /// ChaCha20 is the same on every machine and in every version of `rand`.
    fn generator(&self, name: &str) -> ChaCha20Rng {
        ChaCha20Rng::from_seed(Sha256::digest(format!("{}/{name}", self.seed)).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvtop_core::pose::rotation_error_deg;
    use rand::Rng;
    use std::collections::BTreeMap;

    fn rig() -> Rig {
        let camera = |id: &str, x: f64| {
            format!(
                r#"{{"id": "{id}", "width": 640, "height": 480, "model": "pinhole", "fx": 500,
                    "fy": 500, "cx": 320, "cy": 240, "T_world_cam": [[0, -1, 0, {x}],
                    [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}}"#
            )
        };
        let cameras = [
            camera("cam0", 0.0),
            camera("cam1", 1.0),
            camera("cam2", 2.0),
        ]
        .join(",");
        Rig::from_json(&format!(
            r#"{{"format": "mvtop-rig", "version": 1, "unit": "m", "reference": "cam1",
                "cameras": [{cameras}]}}"#
        ))
        .unwrap()
    }

    fn seen() -> GivenBoxes {
        GivenBoxes {
            class: "ball".into(),
            boxes: BTreeMap::from([
                ("cam0".into(), [100.0, 100.0, 200.0, 150.0].into()),
                ("cam1".into(), [300.0, 200.0, 320.0, 220.0].into()),
            ]),
        }
    }

    fn rig_noise(rig_deg: f64, rig_mm: f64) -> Noise {
        Noise {
            rig_deg,
            rig_mm,
            ..Noise::default()
        }
    }

    #[test]
    fn no_noise_changes_nothing() {
        let mut noisy_boxes = seen();
        let none = Noise {
            seed: 7,
            ..Noise::default()
        };
        let noisy_rig = none.disturb_rig(&rig(), "000000").unwrap();
        none.disturb_boxes(&mut noisy_boxes, &noisy_rig, "000000", 0);
        assert_eq!((noisy_rig, noisy_boxes), (rig(), seen()));
    }

    #[test]
    fn cameras_are_turned_and_moved_by_exactly_that_much_but_not_the_reference() {
        let noisy = rig_noise(1.5, 20.0).disturb_rig(&rig(), "000003").unwrap();
        for (i, (exact, noisy)) in rig().cameras().iter().zip(noisy.cameras()).enumerate() {
            let (deg, m) = if i == 1 { (0.0, 0.0) } else { (1.5, 0.02) };
            let (exact, noisy) = (exact.world_from_cam(), noisy.world_from_cam());
            let turned = rotation_error_deg(&exact.rotation, &noisy.rotation);
            let moved = (exact.translation.vector - noisy.translation.vector).norm();
            assert!(
                (turned - deg).abs() < 1e-9,
                "camera {i} is turned by {turned} degrees"
            );
            assert!(
                (moved - m).abs() < 1e-12,
                "camera {i} is moved by {moved} m"
            );
        }
    }

    #[test]
    fn draw_depends_on_seed_sample_and_camera_but_not_on_what_came_before() {
        let pose = |seed: u64, sample: &str, cameras: usize, camera: usize| {
            let rig = Rig::new(rig().cameras()[..cameras].to_vec(), 1).unwrap();
            let noise = Noise {
                seed,
                ..rig_noise(1.0, 10.0)
            };
            let rig = noise.disturb_rig(&rig, sample).unwrap();
            *rig.cameras()[camera].world_from_cam()
        };
        let first = pose(0, "a", 3, 0);
        assert_eq!(first, pose(0, "a", 2, 0));
        let other_camera = rig().cameras()[2]
            .world_from_cam()
            .inv_mul(&pose(0, "a", 3, 2));
        let own_camera = rig().cameras()[0].world_from_cam().inv_mul(&first);
        for other in [pose(1, "a", 3, 0), pose(0, "b", 3, 0)] {
            assert!((first.translation.vector - other.translation.vector).norm() > 1e-6);
        }
        assert!((other_camera.translation.vector - own_camera.translation.vector).norm() > 1e-6);
    }

    #[test]
    fn boxes_beyond_a_lens_field_of_view_go() {
        // Its radius is greatest at 297 px.
        let rig = Rig::from_json(
            r#"{"format": "mvtop-rig", "version": 1, "unit": "m", "cameras": [{"id": "cam0",
                "width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240,
                "distortion": {"model": "brown_conrady", "params": [-0.42, 0, 0, 0, 0]},
                "T_world_cam": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}"#,
        )
        .unwrap();
        for (bbox, stays) in [
            ([100.0, 200.0, 120.0, 220.0], true),
            ([0.0, 0.0, 20.0, 20.0], false),
        ] {
            let mut seen = seen();
            seen.boxes = BTreeMap::from([("cam0".into(), bbox.into())]);
            Noise::default().disturb_boxes(&mut seen, &rig, "000000", 0);
            assert_eq!(seen.boxes.len(), usize::from(stays));
        }
    }

    #[test]
    fn draw_is_the_documented_one() {
        let noise = Noise {
            seed: 7,
            ..rig_noise(1.0, 1000.0)
        };
        // python3: key = hashlib.sha256(b"7/000000/cam0/rig").digest(), 16 bytes of the stream of
        // algorithms.ChaCha20(key, bytes(16)) of the package cryptography, struct.unpack("<2Q", ...)
        let mut rng = noise.generator("000000/cam0/rig");
        let first = [rng.next_u64(), rng.next_u64()];
        assert_eq!(first, [9963092875442148147, 3498282736940708117]);
        // Marsaglia's method by hand from that stream: the axis first, then the direction.
        let noisy = noise.disturb_rig(&rig(), "000000").unwrap();
        let [exact, noisy] = [rig(), noisy].map(|rig| *rig.cameras()[0].world_from_cam());
        let moved = exact.inv_mul(&noisy);
        let near = |a: Vector3<f64>, b: [f64; 3]| (a - Vector3::from(b)).norm() < 1e-9;
        let axis = [
            0.12510076499292358,
            -0.9682207309987203,
            0.21656041804191528,
        ];
        let direction = [-0.7080490191747765, 0.4323594336606449, -0.5583295680601945];
        assert!(
            near(moved.rotation.scaled_axis(), axis.map(f64::to_radians)),
            "{moved}"
        );
        assert!(near(moved.translation.vector, direction), "{moved}");
        // Noise of boxes stays the same in later versions of the library.
        let mut noisy = seen();
        let noise = Noise {
            boxes: 0.1,
            ..noise
        };
        noise.disturb_boxes(&mut noisy, &rig(), "000000", 0);
        let expected = [95.8798324619, 93.8724913729, 209.4264142183, 151.6786569353];
        for (side, expected) in <[f64; 4]>::from(noisy.boxes["cam0"]).iter().zip(expected) {
            assert!((side - expected).abs() < 1e-9, "{:?}", noisy.boxes);
        }
    }

    #[test]
    fn sides_of_boxes_scatter_by_that_share_of_the_size() {
        let noise = Noise {
            boxes: 0.05,
            ..Noise::default()
        };
        let mut squares = [0.0; 4];
        for sample in 0..2000 {
            let mut noisy = seen();
            noise.disturb_boxes(&mut noisy, &rig(), &sample.to_string(), 0);
            let [exact, noisy] = [seen(), noisy].map(|seen| <[f64; 4]>::from(seen.boxes["cam0"]));
            for side in 0..4 {
                let size = [100.0, 50.0][side % 2];
                squares[side] += ((noisy[side] - exact[side]) / size).powi(2);
            }
        }
        for square in squares {
            let deviation = (square / 2000.0).sqrt();
            assert!((deviation - 0.05).abs() < 0.005, "{deviation}");
        }
    }

    #[test]
    fn box_that_is_not_in_the_image_goes_without_noise_and_others_stay_as_they_are() {
        let mut boxes = seen();
        let add = |boxes: &mut GivenBoxes, id: &str, sides: [f64; 4]| {
            boxes.boxes.insert(id.into(), sides.into());
        };
        add(&mut boxes, "cam1", [700.0, 100.0, 800.0, 150.0]);
        add(&mut boxes, "cam2", [100.0, 100.0, 100.5, 150.0]);
        Noise::default().disturb_boxes(&mut boxes, &rig(), "a", 0);
        let left: Vec<_> = boxes.boxes.iter().collect();
        assert_eq!(left, [(&"cam0".to_owned(), &seen().boxes["cam0"])]);
        // What is no box, or of no camera, is left for the estimator to refuse.
        add(&mut boxes, "cam1", [200.0, 100.0, 100.0, 150.0]);
        add(&mut boxes, "cam7", [100.0, 100.0, 200.0, 150.0]);
        Noise::default().disturb_boxes(&mut boxes, &rig(), "a", 0);
        assert_eq!(boxes.boxes.len(), 3);
    }

    #[test]
    fn box_that_leaves_the_image_goes() {
        let noise = Noise {
            boxes: 10.0,
            ..Noise::default()
        };
        let mut kept = 0;
        for sample in 0..100 {
            let mut noisy = seen();
            noise.disturb_boxes(&mut noisy, &rig(), &sample.to_string(), 0);
            for bbox in noisy.boxes.values() {
                assert_eq!(bbox.clip(640, 480), Some(*bbox));
                kept += 1;
            }
        }
        assert!(kept > 0 && kept < 200, "{kept}");
    }
}
