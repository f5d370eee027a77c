//! COLMAP's cameras and images, as text or binary: one camera of the rig per image, in a unit of its own.

mod binary;
mod text;

use std::collections::BTreeMap;

use mvtop_geometry::transform;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Foreign, Lens, Plane};
use crate::source::Source;
use crate::{Checked, Options};

/// Names of the models, in the order of their numbers, and how many parameters they have.
const MODELS: [(&str, usize); 17] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
];

/// Intrinsics that images share.
struct Shared {
    model: String,
    size: [u32; 2],
    params: Vec<f64>,
}

/// An image: the number of its intrinsics, and its pose, world to camera.
struct Image {
    name: String,
    camera: u32,
    q_wxyz: [f64; 4],
    t: [f64; 3],
}

type Cameras = BTreeMap<u32, Shared>;

pub fn read(sources: &[Source], _: &Options) -> Checked<Draft> {
    let of = |kind: &str| {
        let mut named = sources
            .iter()
            .filter(|source| source.file_name().contains(kind));
        match (named.next(), named.next()) {
            (Some(source), None) => Ok(source),
            _ => Err(format!(
                "expected COLMAP's cameras and images, both .txt or both .bin, or their folder; \
                 there must be one file whose name has `{kind}` in it"
            )),
        }
    };
    let (of_cameras, of_images) = (of("cameras")?, of("images")?);
    let place = |source: &Source| {
        let name = source.name.clone();
        move |problem: String| format!("{name}: {problem}")
    };
    let is_binary = |source: &Source| source.file_name().ends_with(".bin");
    let cameras = match is_binary(of_cameras) {
        true => binary::cameras(&of_cameras.bytes),
        false => text::cameras(of_cameras.text()?),
    };
    let cameras = cameras.map_err(place(of_cameras))?;
    let images = match is_binary(of_images) {
        true => binary::images(&of_images.bytes),
        false => text::images(of_images.text()?),
    };
    let mut images = images.map_err(place(of_images))?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    if images.is_empty() {
        return Err(format!("{}: expected images, got none", of_images.name));
    }
    let draft = images.iter().map(|image| {
        let of = |problem: String| format!("{}: image {}: {problem}", of_images.name, image.name);
        let Some(shared) = cameras.get(&image.camera) else {
            return Err(of(format!(
                "no camera {} in {}",
                image.camera, of_cameras.name
            )));
        };
        let (plane, lens) = optics(shared).map_err(|problem| {
            format!("{}: camera {}: {problem}", of_cameras.name, image.camera)
        })?;
        let pose = transform::from_quaternion_wxyz(image.q_wxyz, image.t);
        let name = image
            .name
            .rsplit_once('.')
            .map_or(&*image.name, |(name, _)| name);
        Ok(DraftCamera {
            id: draft::id(name),
            size: Some(shared.size),
            plane,
            lens,
            pose: Some(Pose::cam_from_world(
                pose.map_err(|error| of(error.to_string()))?,
            )),
        })
    });
    Ok(Draft {
        cameras: draft.collect::<Checked<_>>()?,
        metres: None,
        posing: "",
        notes: vec![
            "principal points count from the corner of the image, so half a pixel was taken off"
                .into(),
        ],
    })
}

fn optics(shared: &Shared) -> Checked<(Plane, Lens)> {
    let model = shared.model.as_str();
    let p = shared.params.as_slice();
    let Some((_, count)) = MODELS.iter().find(|(name, _)| *name == model) else {
        return Err(format!("the model {model} is not known"));
    };
    if p.len() != *count {
        return Err(format!("{model} has {count} parameters, got {}", p.len()));
    }
    let one = |k: &[f64]| -> [f64; 2] { [k[0], k.get(1).copied().unwrap_or(0.0)] };
    // One focal length, or two.
    let single = model.starts_with("SIMPLE") || model.starts_with("RADIAL");
    let (plane, rest) = match single {
        true => ([p[0], p[0], p[1], p[2]], &p[3..]),
        false => ([p[0], p[1], p[2], p[3]], &p[4..]),
    };
    let lens = match model {
        "SIMPLE_PINHOLE" | "PINHOLE" => Lens::PINHOLE,
        "SIMPLE_RADIAL" | "RADIAL" => {
            let [k1, k2] = one(rest);
            Lens::brown_conrady(&[k1, k2, 0.0, 0.0])?
        }
        "OPENCV" | "FULL_OPENCV" => Lens::brown_conrady(rest)?,
        "OPENCV_FISHEYE" => Lens::kannala_brandt(rest)?,
        "SIMPLE_FISHEYE" | "FISHEYE" => Lens::kannala_brandt(&[0.0; 4])?,
        "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" => {
            let [k1, k2] = one(rest);
            Lens::kannala_brandt(&[k1, k2, 0.0, 0.0])?
        }
        "THIN_PRISM_FISHEYE" => match rest {
            [k1, k2, 0.0, 0.0, k3, k4, 0.0, 0.0] => Lens::kannala_brandt(&[*k1, *k2, *k3, *k4])?,
            _ => {
                return Err(format!(
                    "{model} with p1, p2, sx1 or sy1 cannot be expressed"
                ));
            }
        },
        "FOV" => Lens::Foreign(Foreign::fov(rest[0])?),
        "SIMPLE_DIVISION" | "DIVISION" => Lens::Foreign(Foreign::Division { k: rest[0] }),
        "EUCM" => Lens::Foreign(Foreign::Eucm {
            alpha: rest[0],
            beta: rest[1],
        }),
        _ => {
            return Err(format!(
                "{model} cannot be expressed; undistort the images with COLMAP"
            ));
        }
    };
    Ok((Plane::from_corner(plane), lens))
}
