//! Disturbances that an evaluation adds to what is known exactly: calibration and true boxes.
//!
//! Each is drawn from SHA-256 of its own name instead of a generator's state, so that it depends on
//! neither the order of samples nor the number of views, and grows in proportion to its size: a
//! camera is turned about the same axis by 0.5 and by 2 degrees. `docs/output.md` gives the recipe.

use std::f64::consts::TAU;

use mvtop_core::annotations::GivenBoxes;
use mvtop_core::{BBox, Rig};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use sha2::{Digest, Sha256};

/// How much is added, and which draw of it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Noise {
    pub seed: u64,
    /// Angle by which each camera but the reference is turned about its own center.
    pub rig_deg: f64,
    /// Distance by which its center is moved.
    pub rig_mm: f64,
    /// Standard deviation of each side of a box, in widths (left, right) or heights (top, bottom).
    pub boxes: f64,
}

impl Noise {
    /// The rig with the poses of all cameras but the reference disturbed.
    ///
    /// # Errors
    /// [`mvtop_core::Error::Camera`] for a camera that is moved further than can be.
    pub fn disturb_rig(&self, rig: &Rig, sample: &str) -> mvtop_core::Result<Rig> {
        if self.rig_deg == 0.0 && self.rig_mm == 0.0 {
            return Ok(rig.clone()); // not even by rounding
        }
        rig.moved(|index, camera| {
            if index == rig.reference() {
                return *camera.world_from_cam();
            }
            let [a, b, c, d] = self.uniform(&format!("{sample}/{}/rig", camera.id()));
            let cam_from_disturbed = Isometry3::from_parts(
                Translation3::from(direction(c, d).into_inner() * (self.rig_mm / 1e3)),
                UnitQuaternion::from_axis_angle(&direction(a, b), self.rig_deg.to_radians()),
            );
            camera.world_from_cam() * cam_from_disturbed
        })
    }

    /// Moves the four sides of an object's box in every camera; a box of which nothing is left
    /// within the image goes.
    ///
    /// - `object`: its place in the sample's truth
    pub fn disturb_boxes(&self, seen: &mut GivenBoxes, rig: &Rig, sample: &str, object: usize) {
        if self.boxes == 0.0 {
            return;
        }
        seen.boxes.retain(|id, bbox| {
            let [a, b, c, d] = self.uniform(&format!("{sample}/{id}/box{object}"));
            let (horizontal, vertical) = (normal(a, b), normal(c, d));
            let (width, height) = (bbox.width() * self.boxes, bbox.height() * self.boxes);
            *bbox = BBox {
                x0: bbox.x0 + width * horizontal[0],
                y0: bbox.y0 + height * vertical[0],
                x1: bbox.x1 + width * horizontal[1],
                y1: bbox.y1 + height * vertical[1],
            };
            let clipped = rig
                .index_of(id)
                .and_then(|i| bbox.clip(rig.cameras()[i].width(), rig.cameras()[i].height()));
            *bbox = clipped.unwrap_or(*bbox);
            clipped.is_some()
        });
    }

    /// Four numbers from 0 to 1: the 64-bit words (little endian) of SHA-256 of `SEED/NAME`.
    fn uniform(&self, name: &str) -> [f64; 4] {
        let hash = Sha256::digest(format!("{}/{name}", self.seed));
        std::array::from_fn(|i| {
            let bytes = std::array::from_fn(|byte| hash[8 * i + byte]);
            u64::from_le_bytes(bytes) as f64 / 2f64.powi(64)
        })
    }
}

/// Uniform on the sphere: its height is uniform, and so is its angle about z.
fn direction(height: f64, turn: f64) -> Unit<Vector3<f64>> {
    let z = 2.0 * height - 1.0;
    let (sin, cos) = (TAU * turn).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Unit::new_normalize(Vector3::new(radius * cos, radius * sin, z))
}

/// Two standard normal numbers (Box and Muller 1958).
fn normal(a: f64, b: f64) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - a).max(f64::MIN_POSITIVE).ln()).sqrt();
    let (sin, cos) = (TAU * b).sin_cos();
    [radius * cos, radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvtop_core::pose::rotation_error_deg;
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
            let (exact, noisy) = (&exact.world_from_cam(), &noisy.world_from_cam());
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
    fn draw_is_the_documented_one() {
        // python3: hashlib.sha256(b"7/000000/cam1/rig").digest(), struct.unpack("<4Q", ...), / 2**64
        let noise = Noise {
            seed: 7,
            ..Noise::default()
        };
        let expected = [
            0.48721892301287695,
            0.4571008882228475,
            0.2835332461265554,
            0.7677293870904406,
        ];
        for (number, expected) in noise.uniform("000000/cam1/rig").iter().zip(expected) {
            assert!((number - expected).abs() < 1e-15, "{number}");
        }
        // Height 0 at a quarter turn is y; height 1 is z wherever it is turned.
        assert!((direction(0.5, 0.25).into_inner() - Vector3::y()).norm() < 1e-12);
        assert!((direction(1.0, 0.3).into_inner() - Vector3::z()).norm() < 1e-12);
        // 1 - exp(-2) makes the radius 2; no turn leaves it on the first number.
        let [x, y] = normal(1.0 - (-2f64).exp(), 0.0);
        assert!((x - 2.0).abs() < 1e-12 && y.abs() < 1e-12);
        assert!(normal(1.0, 0.0)[0].is_finite());
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
