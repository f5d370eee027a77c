//! Parts, cameras around them and what these see.

use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::camera::Intrinsics;
use crate::image::Pyramid;
use crate::mesh::Mesh;
use crate::refine::mesh_model::MeshModel;
use crate::refine::raster::Raster;
use crate::refine::{RefineConfig, View};
use crate::{Camera, Projection};

pub(crate) const SIDE: u32 = 480;
/// Pixels of the drawing along each side of one of the image.
const FINER: usize = 3;

/// Numbers from 0 to 1 that are the same in every run.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn number(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| 2.0 * self.number() - 1.0);
            if (0.1..1.0).contains(&v.norm()) {
                return v.normalize();
            }
        }
    }

    pub(crate) fn rotation(&mut self, angle: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(self.direction() * angle)
    }
}

/// A surface with `rows` by `columns` patches over the unit square.
pub(crate) fn surface(
    rows: usize,
    columns: usize,
    color: [u8; 3],
    at: impl Fn(f64, f64) -> Point3<f64>,
) -> Mesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for row in 0..=rows {
        for column in 0..=columns {
            vertices.push(at(row as f64 / rows as f64, column as f64 / columns as f64));
        }
    }
    let index = |row: usize, column: usize| (row * (columns + 1) + column) as u32;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [index(row, column), index(row, column + 1)];
            let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    let colors = vec![color; vertices.len()];
    Mesh::new(vertices, colors, triangles).unwrap()
}

pub(crate) fn united(parts: &[Mesh]) -> Mesh {
    let (mut vertices, mut colors, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for part in parts {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(part.vertices());
        colors.extend_from_slice(part.colors());
        triangles.extend(part.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    Mesh::new(vertices, colors, triangles).unwrap()
}

/// A box of 60 x 80 x 110 mm.
pub(crate) fn cuboid() -> Mesh {
    let half = Vector3::new(0.03, 0.04, 0.055);
    let sides: Vec<Mesh> = (0..6)
        .map(|side| {
            surface(1, 1, [170, 110, 60], |u, v| {
                let (axis, sign) = (side / 2, f64::from(side % 2) * 2.0 - 1.0);
                let mut at = Vector3::repeat(sign);
                at[(axis as usize + 1) % 3] = 2.0 * u - 1.0;
                at[(axis as usize + 2) % 3] = 2.0 * v - 1.0;
                Point3::from(at.component_mul(&half))
            })
        })
        .collect();
    united(&sides)
}

/// A can, 66 mm wide and 100 mm high, about z.
pub(crate) fn can() -> Mesh {
    let circle = |turn: f64| (turn * std::f64::consts::TAU).sin_cos();
    let ring = |radius: f64, z: f64, turn: f64| {
        // Exactly closed: the last column is where the first one is.
        let (sin, cos) = circle(if turn == 1.0 { 0.0 } else { turn });
        Point3::new(radius * cos, radius * sin, z)
    };
    let color = [90, 120, 170];
    united(&[
        surface(1, 72, color, |u, v| ring(0.033, 0.1 * u - 0.05, v)),
        surface(1, 72, color, |u, v| ring(0.033 * u, 0.05, v)),
        surface(1, 72, color, |u, v| ring(0.033 * u, -0.05, v)),
    ])
}

/// A ball of 60 mm radius with a green and a red knob, as in `models/mvball`.
pub(crate) fn ball() -> Mesh {
    crate::mesh::load_ply(
        std::path::Path::new("../../models/mvball/mvball.mesh.ply"),
        1.0,
    )
    .unwrap()
}

pub(crate) fn camera(degrees: f64) -> Camera {
    let middle = (f64::from(SIDE) - 1.0) / 2.0;
    let pinhole = Intrinsics::new(600.0, 600.0, middle, middle, Projection::Pinhole).unwrap();
    // Around the origin, 0.6 m away, all looking at it from a bit above.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), degrees.to_radians())
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -0.4);
    let world_from_cam = Isometry3::from_parts((turn * Vector3::new(0.0, 0.0, -0.6)).into(), turn);
    let id = format!("at{degrees}");
    Camera::new(id, [SIDE; 2], pinhole, world_from_cam).unwrap()
}

/// Blocks of any colors, of 1 to 50 px.
pub(crate) fn background(draw: &mut Draw) -> RgbImage {
    let mut image = RgbImage::from_pixel(SIDE, SIDE, Rgb([128, 128, 128]));
    for _ in 0..1500 {
        let color = Rgb(std::array::from_fn(|_| {
            (40.0 + 180.0 * draw.number()) as u8
        }));
        let at = [draw.number(), draw.number()].map(|x| (x * f64::from(SIDE)) as u32);
        let size = [draw.number(), draw.number()].map(|x| 1 + (50.0 * x * x) as u32);
        for v in at[1]..(at[1] + size[1]).min(SIDE) {
            for u in at[0]..(at[0] + size[0]).min(SIDE) {
                image.put_pixel(u, v, color);
            }
        }
    }
    image
}

/// Image of a mesh lit from the side, in front of blocks of random colors, with noise.
pub(crate) fn seen(
    mesh: &Mesh,
    camera: &Camera,
    pose: &Isometry3<f64>,
    draw: &mut Draw,
) -> RgbImage {
    let background = background(draw);
    seen_before(background, mesh, camera, pose, draw)
}

/// The same before another background.
pub(crate) fn seen_before(
    background: RgbImage,
    mesh: &Mesh,
    camera: &Camera,
    pose: &Isometry3<f64>,
    draw: &mut Draw,
) -> RgbImage {
    let mut part = MeshModel::new(mesh, &RefineConfig::default());
    // Each label is a color and how bright it is.
    let light = Vector3::new(0.5, -0.8, -0.3).normalize();
    let mut palette: Vec<[f64; 3]> = vec![[0.0; 3]];
    for (label, triangle) in part.labels.iter_mut().zip(mesh.triangles()) {
        let [a, b, c] = triangle.map(|v| pose * mesh.vertices()[v as usize]);
        let normal = (b - a).cross(&(c - a)).normalize();
        let bright = 0.65 + 0.35 * (normal.dot(&light).abs() * 8.0).round() / 8.0;
        let color = mesh.colors()[triangle[0] as usize].map(|x| f64::from(x) * bright);
        let known = palette.iter().position(|known| *known == color);
        *label = known.unwrap_or_else(|| {
            palette.push(color);
            palette.len() - 1
        }) as u8;
    }
    assert!(palette.len() < 256);
    let size = SIDE as usize * FINER;
    let (focal, middle) = (
        camera.intrinsics().fx() * FINER as f64,
        (size as f64 - 1.0) / 2.0,
    );
    let pinhole = Intrinsics::new(focal, focal, middle, middle, Projection::Pinhole).unwrap();
    let finer = Camera::new("finer", [size as u32; 2], pinhole, *camera.world_from_cam()).unwrap();
    let mut raster = Raster::default();
    assert!(raster.render(&part, &finer, pose));
    let mut image = background;
    for (u, v, pixel) in image.enumerate_pixels_mut() {
        let mut sum = [0.0; 3];
        for i in 0..FINER * FINER {
            let (row, column) = (
                v as usize * FINER + i / FINER,
                u as usize * FINER + i % FINER,
            );
            let label = raster.label(row * size + column);
            let color = match label {
                0 => pixel.0.map(f64::from),
                _ => palette[usize::from(label)],
            };
            (0..3).for_each(|c| sum[c] += color[c]);
        }
        let noise = 12.0 * (draw.number() + draw.number() + draw.number() - 1.5);
        pixel.0 = sum.map(|x| (x / (FINER * FINER) as f64 + noise).clamp(0.0, 255.0) as u8);
    }
    image
}

/// Each camera with its image.
pub(crate) fn views_of<'a>(cameras: &'a [Camera], images: &'a [Pyramid]) -> Vec<View<'a>> {
    let pairs = cameras.iter().zip(images);
    pairs
        .map(|(camera, image)| View { camera, image })
        .collect()
}
