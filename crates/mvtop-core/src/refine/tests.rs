//! Scenes that are drawn with known poses, and poses that were disturbed and are to come back.

use image::{Rgb, RgbImage};
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

use super::raster::Raster;
use super::*;
use crate::Projection;
use crate::camera::Intrinsics;
use crate::closeup::CloseUp;
use crate::pose::{rotation_error_deg, translation_error};
use crate::symmetry::Axis;

const SIDE: u32 = 480;
/// Pixels of the drawing along each side of one of the image.
const FINER: usize = 3;

/// Numbers from 0 to 1 that are the same in every run.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    fn number(&mut self) -> f64 {
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
fn surface(
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

fn united(parts: &[Mesh]) -> Mesh {
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
fn can() -> Mesh {
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
fn ball() -> Mesh {
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
fn background(draw: &mut Draw) -> RgbImage {
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

/// What a camera sees of a mesh that is lit from the side, before a background, with noise.
pub(crate) fn seen(
    mesh: &Mesh,
    camera: &Camera,
    pose: &Isometry3<f64>,
    draw: &mut Draw,
) -> RgbImage {
    let mut part = Part::new(mesh);
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
    let cam_from_obj = camera.world_from_cam().inv_mul(pose);
    let mut raster = Raster::default();
    assert!(raster.draw(&part, &cam_from_obj, &pinhole, size));
    let mut image = background(draw);
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

/// Any rotation at which some camera sees x and one sees y, where the ball's knobs are.
fn rotation(draw: &mut Draw, cameras: &[Camera]) -> UnitQuaternion<f64> {
    loop {
        let rotation = draw.rotation(3.0);
        let towards = |axis: Vector3<f64>| {
            let cameras = cameras
                .iter()
                .map(|c| c.world_from_cam().translation.vector);
            cameras
                .map(|at| at.normalize().dot(&(rotation * axis)))
                .fold(-1.0, f64::max)
        };
        if towards(Vector3::x()).min(towards(Vector3::y())) > 0.5 {
            return rotation;
        }
    }
}

/// Errors, degrees and metres, of poses that were up to 15 degrees and 15 mm off.
fn errors(mesh: &Mesh, axis: Option<Axis>, draws: usize) -> Vec<[f64; 2]> {
    let refiner = Refiner::new(mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(1);
    let sigma = Sigma {
        rot_deg: 15.0,
        t_m: 0.015,
    };
    let one = |_| {
        let truth = Isometry3::from_parts(Translation3::identity(), rotation(&mut draw, &cameras));
        let images: Vec<RgbImage> = cameras
            .iter()
            .map(|camera| seen(mesh, camera, &truth, &mut draw))
            .collect();
        let views: Vec<View> = cameras
            .iter()
            .zip(&images)
            .map(|(camera, image)| View { camera, image })
            .collect();
        let turn = draw.rotation(15_f64.to_radians()) * truth.rotation;
        let shift = truth.translation.vector + draw.direction() * 0.015;
        let start = Isometry3::from_parts(shift.into(), turn);
        let found = refiner
            .refine(&views, &start, sigma)
            .unwrap()
            .world_from_obj;
        let symmetry = crate::symmetry::Symmetry {
            axis,
            discrete: vec![],
        };
        let found = symmetry.nearest(&found, &truth, 0.13);
        [
            rotation_error_deg(&found.rotation, &truth.rotation),
            translation_error(&found, &truth),
        ]
    };
    (0..draws).map(one).collect()
}

#[test]
fn boxes_cans_and_balls_with_knobs_come_back() {
    let about_z = Axis {
        direction: Vector3::z_axis(),
        point: Point3::origin(),
    };
    for (name, mesh, axis, bound) in [
        ("box", cuboid(), None, [0.2, 0.0002]),
        ("can", can(), Some(about_z), [0.2, 0.0002]),
        ("ball", ball(), None, [0.2, 0.0002]),
    ] {
        let errors = errors(&mesh, axis, 40);
        let near = errors
            .iter()
            .filter(|[turn, shift]| *turn < bound[0] && *shift < bound[1]);
        let share = near.count() as f64 / errors.len() as f64;
        assert!(
            share >= 0.95,
            "{name}: {share} within {bound:?}: {errors:?}"
        );
    }
}

#[test]
fn change_of_a_line_is_that_of_its_point_through_every_lens() {
    let lens = |family: &str, distortion, params: &[f64]| {
        let projection = Projection::from_params(family, distortion, params).unwrap();
        Intrinsics::new(500.0, 510.0, 320.0, 240.0, projection).unwrap()
    };
    for intrinsics in [
        lens("pinhole", None, &[]),
        lens(
            "pinhole",
            Some("brown_conrady"),
            &[-0.2, 0.08, 0.001, -0.002, 0.01],
        ),
        lens("fisheye", None, &[-0.006, 0.016, -0.024, 0.0155]),
    ] {
        let pose = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.2, 0.3, -0.1));
        let camera = Camera::new("a", [640, 480], intrinsics, pose).unwrap();
        let closeup = CloseUp::new(&camera, [400.0, 100.0, 500.0, 220.0].into(), 160).unwrap();
        // Where the real camera sees the point, in the close-up.
        let close = &closeup.camera;
        let close_from_cam = close.world_from_cam().inv_mul(camera.world_from_cam());
        let pixel = |point: &Point3<f64>| {
            let real = camera.world_from_cam().inverse_transform_point(point);
            let real = camera.intrinsics().project(&real).unwrap();
            let ray = camera.intrinsics().unproject(&real).unwrap();
            close
                .intrinsics()
                .project(&Point3::from(close_from_cam * ray.into_inner()))
                .unwrap()
        };
        let ray = camera
            .intrinsics()
            .unproject(&Point2::new(450.0, 150.0))
            .unwrap();
        let point = camera.world_from_cam() * Point3::from(ray.into_inner() * 0.7);
        let center = point + Vector3::new(0.02, -0.03, 0.05);
        let normal = Vector2::new(0.6, -0.8);
        let in_close = close.world_from_cam().inverse_transform_point(&point);
        let (world_from_close, focal) = (close.world_from_cam(), close.intrinsics().fx());
        let change = solve::by_pose(world_from_close, focal, &in_close, &normal, &center);
        let world_from_obj =
            Isometry3::from_parts(center.coords.into(), UnitQuaternion::identity());
        let place = world_from_obj.inverse_transform_point(&point);
        for i in 0..6 {
            let along = |by: f64| {
                let motion = Vector6::from_fn(|row, _| if row == i { by } else { 0.0 });
                let pose = solve::moved(&world_from_obj, &Point3::origin(), &motion);
                pixel(&(pose * place)).coords.dot(&normal)
            };
            let numeric = (along(1e-6) - along(-1e-6)) / 2e-6;
            assert!(
                (change[i] - numeric).abs() < 1e-4 * change.norm(),
                "{i}: {} instead of {numeric}",
                change[i]
            );
        }
    }
}

#[test]
fn turn_that_no_image_tells_stays_as_it_was() {
    let mesh = can();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0].map(camera);
    let mut draw = Draw(5);
    for _ in 0..5 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let images: Vec<RgbImage> = cameras
            .iter()
            .map(|camera| seen(&mesh, camera, &truth, &mut draw))
            .collect();
        let views: Vec<View> = cameras
            .iter()
            .zip(&images)
            .map(|(camera, image)| View { camera, image })
            .collect();
        // Off by a tilt, which is seen, and by a turn about the axis, which is not.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.2);
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.1);
        let start = truth * turn * tilt;
        let sigma = Sigma {
            rot_deg: 10.0,
            t_m: 0.01,
        };
        let found = refiner.refine(&views, &start, sigma).unwrap();
        let left = truth.inv_mul(&found.world_from_obj).rotation;
        let about_axis = 2.0 * left.k.atan2(left.w);
        assert!((about_axis - 0.2).abs() < 0.02, "{about_axis}");
        let tilted = (left * Vector3::z()).angle(&Vector3::z()).to_degrees();
        assert!(found.accepted && tilted < 2.0, "{tilted}");
        // It is known to be open: as open as it was.
        assert!(found.sigma.rot_deg > 4.0, "{:?}", found.sigma);
    }
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(9);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
    let views: Vec<View> = cameras
        .iter()
        .zip(&images)
        .map(|(camera, image)| View { camera, image })
        .collect();
    let start = Isometry3::new(Vector3::new(0.003, 0.0, 0.002), Vector3::zeros()) * truth;
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.005,
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            refiner
                .refine(&views, &start, sigma)
                .unwrap()
                .world_from_obj
        })
    };
    assert_eq!(with(1), with(4));
}

#[test]
fn pose_that_the_images_do_not_show_is_left_alone() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0].map(camera);
    let image = RgbImage::from_pixel(SIDE, SIDE, Rgb([90, 90, 90]));
    let views: Vec<View> = cameras
        .iter()
        .map(|camera| View {
            camera,
            image: &image,
        })
        .collect();
    let start = Isometry3::identity();
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.005,
    };
    let found = refiner.refine(&views, &start, sigma).unwrap();
    assert_eq!((found.accepted, found.world_from_obj), (false, start));
    assert_eq!(found.sigma, sigma);
    // And where it is in no image, there is nothing to refine.
    let away = Isometry3::translation(0.0, 5.0, 0.0);
    assert!(refiner.refine(&views, &away, sigma).is_none());
}

mod alone;
mod around;
mod print;

#[test]
fn images_are_explained_best_by_the_right_one_of_several_poses() {
    let cameras = [0.0, 70.0].map(camera);
    let mut draw = Draw(7);
    for mesh in [ball(), cuboid()] {
        let refiner = Refiner::new(&mesh, 0.13);
        for _ in 0..8 {
            let pose = rotation(&mut draw, &cameras);
            let truth = Isometry3::from_parts(Translation3::identity(), pose);
            let images = cameras
                .each_ref()
                .map(|camera| seen(&mesh, camera, &truth, &mut draw));
            let views: Vec<View> = (cameras.iter().zip(&images))
                .map(|(camera, image)| View { camera, image })
                .collect();
            let right = refiner.quality(&views, &truth).unwrap().explained();
            // Of the ball, the turn that puts the red knob where the green one is; of the box, none
            // that makes it look the same.
            let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 90_f64.to_radians());
            for turn in [
                draw.rotation(0.5),
                draw.rotation(0.8),
                quarter,
                quarter.inverse(),
            ] {
                let wrong = Isometry3::from_parts(truth.translation, pose * turn);
                let wrong = refiner.quality(&views, &wrong).unwrap().explained();
                assert!(wrong < right - 0.02, "{wrong} against {right} by {turn}");
            }
        }
    }
}

#[test]
fn right_pose_explains_most_also_where_a_view_is_half_hidden() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(3);
    for _ in 0..2 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let mut images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
        // No axis of the box, as turns about those by 180 degrees look the same.
        let axis = UnitQuaternion::from_scaled_axis(truth.rotation * Vector3::new(0.7, 0.7, 0.2));
        let axis = axis.axis().unwrap();
        for half_hidden in [false, true] {
            if half_hidden {
                for v in 0..SIDE {
                    for u in SIDE / 2..SIDE {
                        images[1].put_pixel(u, v, Rgb([60, 140, 70]));
                    }
                }
            }
            let views: Vec<View> = cameras
                .iter()
                .zip(&images)
                .map(|(camera, image)| View { camera, image })
                .collect();
            let explained = |degrees: f64| {
                let turn = UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
                let pose = Isometry3::from_parts(truth.translation, turn * truth.rotation);
                refiner.quality(&views, &pose).unwrap().explained()
            };
            let right = explained(0.0);
            for off in [5.0, -5.0, 20.0, -20.0, 90.0, 180.0] {
                let wrong = explained(off);
                assert!(
                    right > wrong,
                    "{right} at the pose, {wrong} {off} degrees off"
                );
            }
        }
    }
}

#[test]
fn edges_are_seen_at_the_true_pose_where_the_image_has_them() {
    let (mesh, camera, mut draw) = (cuboid(), camera(70.0), Draw(4));
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
    let image = seen(&mesh, &camera, &truth, &mut draw);
    let (refiner, view) = (
        Refiner::new(&mesh, 0.13),
        View {
            camera: &camera,
            image: &image,
        },
    );
    let share = |pose: &Isometry3<f64>| {
        let edges = refiner.edges(&view, pose);
        assert!(edges.len() > 100, "{}", edges.len());
        // On the surface's edges: each lies on two faces of the box.
        for edge in &edges {
            let at = pose.inverse_transform_point(&edge.point);
            let half = [0.03, 0.04, 0.055];
            let near = (0..3).filter(|&i| (at[i].abs() - half[i]).abs() < 1e-6);
            assert!(near.count() >= 2, "{at}");
        }
        edges.iter().filter(|edge| edge.supported).count() as f64 / edges.len() as f64
    };
    let turned = truth * Isometry3::rotation(Vector3::new(0.0, 0.2, 0.0));
    // But for those next to background of the box's own color.
    let (here, there) = (share(&truth), share(&turned));
    assert!(here > 0.8 && there < here - 0.3, "{here}, {there}");
    // Beside what the camera sees.
    let beside = Isometry3::translation(0.0, 50.0, 0.0);
    assert!(refiner.edges(&view, &beside).is_empty());
}

#[test]
fn quality_says_which_view_does_not_show_the_object() {
    let mesh = cuboid();
    let refiner = Refiner::new(&mesh, 0.13);
    let cameras = [0.0, 70.0, 140.0].map(camera);
    let mut draw = Draw(4);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let mut images = [0, 1, 2].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
    images[2] = background(&mut draw);
    let views: Vec<View> = cameras
        .iter()
        .zip(&images)
        .map(|(camera, image)| View { camera, image })
        .collect();
    let quality = refiner.quality(&views, &truth).unwrap();
    let [first, second, hidden] = quality.views[..] else {
        panic!("{quality:?}")
    };
    assert_eq!(quality.worst().unwrap().view, 2);
    for shown in [first, second] {
        // Not all of it: some creases lie between faces of like brightness.
        assert!(shown.supported > 0.5 && shown.supported > hidden.supported + 0.3);
        assert!(shown.residual_px < 0.7 && shown.residual_px < hidden.residual_px / 2.0);
        assert!(shown.overlap > 0.7 && shown.overlap > hidden.overlap + 0.2);
    }
    let mean = (first.supported + second.supported + hidden.supported) / 3.0;
    assert!((quality.supported() - mean).abs() < 1e-12);
    assert_eq!(Quality::default().explained(), 0.0);
}

#[test]
fn a_camera_that_sees_the_knobs_tells_turns_apart_and_one_that_sees_nothing_does_not() {
    let refiner = Refiner::new(&ball(), 0.1);
    let pose = Isometry3::identity();
    let turned = |angle: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle.to_radians());
        Isometry3::from_parts(Translation3::identity(), turn)
    };
    let camera = camera(0.0);
    let differ = |degrees: f64| refiner.difference(&camera, &pose, &turned(degrees));
    assert_eq!(differ(0.0), 0.0);
    assert!(
        differ(20.0) > differ(5.0) && differ(5.0) > 0.0,
        "{}",
        differ(5.0)
    );
    assert!(differ(20.0) <= 1.0);
    let away = camera.world_from_cam() * Isometry3::rotation(Vector3::y() * 2.0);
    let size = [camera.width(), camera.height()];
    let away = Camera::new("away", size, camera.intrinsics().clone(), away).unwrap();
    assert_eq!(refiner.difference(&away, &pose, &turned(20.0)), 0.0);
}
