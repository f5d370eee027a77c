//! Reading fixtures.

use image::RgbImage;
use mvtop_core::{BBox, Camera, Rig, image as images};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use ndarray::{ArrayD, ArrayViewD};
use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

pub fn fixture_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures")
        .join(name)
}

/// The tensors of one fixture file.
pub struct Fixture(Vec<u8>);

impl Fixture {
    pub fn load(name: &str) -> Self {
        Self(std::fs::read(fixture_path(name)).unwrap())
    }

    pub fn f64(&self, name: &str) -> ArrayD<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file
            .tensor(name)
            .unwrap_or_else(|_| panic!("no tensor `{name}`"));
        let numbers = match tensor.dtype() {
            Dtype::F64 => chunks(tensor.data(), f64::from_le_bytes),
            Dtype::F32 => chunks(tensor.data(), |b| f64::from(f32::from_le_bytes(b))),
            Dtype::U8 => chunks(tensor.data(), |b: [u8; 1]| f64::from(b[0])),
            Dtype::I64 => chunks(tensor.data(), |b| i64::from_le_bytes(b) as f64),
            other => panic!("{name}: {other:?}"),
        };
        ArrayD::from_shape_vec(tensor.shape(), numbers).unwrap()
    }

    pub fn f32(&self, name: &str) -> ArrayD<f32> {
        self.f64(name).mapv(|x| x as f32)
    }
}

fn chunks<const N: usize>(bytes: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    bytes
        .chunks_exact(N)
        .map(|b| read(b.try_into().unwrap()))
        .collect()
}

/// Largest absolute difference of two arrays of one shape.
pub fn gap(a: ArrayD<f64>, b: ArrayD<f64>) -> f64 {
    assert_eq!(a.shape(), b.shape());
    (a - b).iter().fold(0.0, |m, x| m.max(x.abs()))
}

/// The rigid motion of a 4x4 matrix.
pub fn rigid(m: ArrayViewD<f64>) -> Isometry3<f64> {
    let r = Matrix3::from_fn(|i, j| m[[i, j]]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
    Isometry3::from_parts(Translation3::new(m[[0, 3]], m[[1, 3]], m[[2, 3]]), rotation)
}

/// The rig of the sample with six cameras, three of which have lenses that bend.
pub fn sample_rig() -> Rig {
    Rig::load(&fixture_path("six/rig.json")).unwrap()
}

/// What the sample's camera took.
pub fn sample_image(camera: &Camera) -> RgbImage {
    let path = fixture_path("six").join(format!("{}.png", camera.id()));
    images::load(&path, camera).unwrap()
}

/// The true box of the sample's one object, by camera.
pub fn sample_boxes() -> HashMap<String, BBox> {
    let text = std::fs::read_to_string(fixture_path("six/truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&text).unwrap();
    serde_json::from_value(truth["objects"][0]["boxes"].clone()).unwrap()
}
