//! Rigs that are written in each format and read again: the same poses and the same lens.

use mvtop_geometry::{Camera, Rig};
use mvtop_import::{Direction, ImageSize, Options, Unit};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};
use proptest::prelude::*;

use crate::read;

const SIZE: [u32; 2] = [640, 480];

/// What is written: world_from_cam, metres, fx fy cx cy and k1 k2 p1 p2 k3.
#[derive(Debug, Clone)]
struct Written {
    pose: Isometry3<f64>,
    plane: [f64; 4],
    params: [f64; 5],
}

fn written() -> impl Strategy<Value = Written> {
    let part = || -1.0..1.0f64;
    (
        [part(), part(), part()],
        [part(), part(), part()],
        [400.0..800.0, 400.0..800.0, 300.0..340.0, 220.0..260.0],
    )
        .prop_flat_map(|(turn, at, plane)| {
            let params = [
                -0.1..0.1,
                -0.05..0.05,
                -1e-3..1e-3,
                -1e-3..1e-3,
                -0.01..0.01f64,
            ];
            params.prop_map(move |params| Written {
                pose: Isometry3::new(Vector3::from(at), Vector3::from(turn)),
                plane,
                params,
            })
        })
}

fn rows(pose: &Isometry3<f64>) -> Vec<Vec<f64>> {
    let matrix: Matrix4<f64> = pose.to_homogeneous();
    (0..4)
        .map(|i| (0..4).map(|j| matrix[(i, j)]).collect())
        .collect()
}

/// Numbers one after the other, of the first rows and columns.
fn part(pose: &Isometry3<f64>, columns: std::ops::Range<usize>) -> Vec<f64> {
    rows(pose)[..3]
        .iter()
        .flat_map(|row| row[columns.clone()].to_vec())
        .collect()
}

fn k([fx, fy, cx, cy]: [f64; 4]) -> Vec<f64> {
    vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
}

/// Files of a format, and what they do not say.
type Files = (Vec<(String, String)>, Options);
type Writer = fn(&[Written]) -> Files;

fn kalibr(cameras: &[Written]) -> Files {
    let mut text = String::new();
    for (i, camera) in cameras.iter().enumerate() {
        let [_, _, _, _, k3] = camera.params;
        assert_eq!(k3, 0.0);
        text += &format!(
            "cam{i}:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: {:?}\n  \
             intrinsics: {:?}\n  resolution: [640, 480]\n",
            &camera.params[..4],
            camera.plane
        );
        if i > 0 {
            text += &format!(
                "  T_cn_cnm1: {:?}\n",
                rows(&(camera.pose.inverse() * cameras[i - 1].pose))
            );
        }
    }
    (vec![("chain.yaml".into(), text)], Options::default())
}

fn opencv(cameras: &[Written]) -> Files {
    let camera = |(i, camera): (usize, &Written)| {
        let cam_from_world = camera.pose.inverse();
        format!(
            "\"c{i}\": {{\"camera_matrix\": {:?}, \"dist_coeffs\": [{:?}], \"image_size\": {SIZE:?}, \"rvec\": {:?}, \
             \"tvec\": {:?}}}",
            k(camera.plane),
            camera.params,
            cam_from_world.rotation.scaled_axis().as_slice(),
            (cam_from_world.translation.vector * 40.0).as_slice()
        )
    };
    let text: Vec<_> = cameras.iter().enumerate().map(camera).collect();
    let options = Options {
        scale: Some(0.025),
        ..Options::default()
    };
    (
        vec![("rig.json".into(), format!("{{{}}}", text.join(", ")))],
        options,
    )
}

fn colmap(cameras: &[Written]) -> Files {
    let (mut of_cameras, mut of_images) = (String::new(), String::new());
    for (i, camera) in cameras.iter().enumerate() {
        let [fx, fy, cx, cy] = camera.plane;
        let [k1, k2, p1, p2, k3] = camera.params;
        let (cx, cy) = (cx + 0.5, cy + 0.5);
        of_cameras += &format!(
            "{i} FULL_OPENCV 640 480 {fx} {fy} {cx} {cy} {k1} {k2} {p1} {p2} {k3} 0 0 0\n"
        );
        let cam_from_world = camera.pose.inverse();
        let (q, t) = (
            cam_from_world.rotation,
            cam_from_world.translation.vector * 5.0,
        );
        of_images += &format!(
            "{i} {} {} {} {} {} {} {} {i} c{i}.png\n1 2 3\n",
            q.w, q.i, q.j, q.k, t.x, t.y, t.z
        );
    }
    let options = Options {
        scale: Some(0.2),
        ..Options::default()
    };
    (
        vec![
            ("cameras.txt".into(), of_cameras),
            ("images.txt".into(), of_images),
        ],
        options,
    )
}

fn bop(cameras: &[Written]) -> Files {
    let camera = |(i, camera): (usize, &Written)| {
        let cam_from_world = camera.pose.inverse();
        let t_mm: Vec<f64> = part(&cam_from_world, 3..4)
            .iter()
            .map(|x| x * 1000.0)
            .collect();
        let text = format!(
            "{{\"0\": {{\"cam_K\": {:?}, \"cam_dist\": {:?}, \"cam_R_w2c\": {:?}, \"cam_t_w2c\": {t_mm:?}}}}}",
            k(camera.plane),
            camera.params,
            part(&cam_from_world, 0..3),
        );
        (format!("scene_camera_c{i}.json"), text)
    };
    let image_sizes = vec![ImageSize {
        camera: None,
        size: SIZE,
    }];
    let options = Options {
        image_sizes,
        ..Options::default()
    };
    (cameras.iter().enumerate().map(camera).collect(), options)
}

fn nerf(cameras: &[Written]) -> Files {
    let frame = |(i, camera): (usize, &Written)| {
        let [fx, fy, cx, cy] = camera.plane;
        let [k1, k2, p1, p2, k3] = camera.params;
        let (cx, cy) = (cx + 0.5, cy + 0.5);
        let mut rows = rows(&camera.pose);
        for row in &mut rows {
            (row[1], row[2]) = (-row[1], -row[2]);
        }
        format!(
            "{{\"file_path\": \"images/c{i}.png\", \"w\": 640, \"h\": 480, \"fl_x\": {fx}, \"fl_y\": {fy}, \"cx\": {cx}, \
             \"cy\": {cy}, \"k1\": {k1}, \"k2\": {k2}, \"p1\": {p1}, \"p2\": {p2}, \"k3\": {k3}, \
             \"transform_matrix\": {rows:?}}}"
        )
    };
    let frames: Vec<_> = cameras.iter().enumerate().map(frame).collect();
    let options = Options {
        unit: Some(Unit::Metre),
        ..Options::default()
    };
    (
        vec![(
            "transforms.json".into(),
            format!("{{\"frames\": [{}]}}", frames.join(", ")),
        )],
        options,
    )
}

fn ros(cameras: &[Written]) -> Files {
    let mut files = Vec::new();
    let mut transforms = "transforms:\n".to_owned();
    for (i, camera) in cameras.iter().enumerate() {
        let text = format!(
            "header:\n  frame_id: c{i}_optical_frame\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\nd: \
             {:?}\nk: {:?}\nr: [1, 0, 0, 0, 1, 0, 0, 0, 1]\np: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]\n---\n",
            camera.params,
            k(camera.plane)
        );
        files.push((format!("c{i}.yaml"), text));
        let (t, q) = (camera.pose.translation.vector, camera.pose.rotation);
        transforms += &format!(
            "- header: {{frame_id: base}}\n  child_frame_id: c{i}_optical_frame\n  transform:\n    translation: {{x: \
             {}, y: {}, z: {}}}\n    rotation: {{x: {}, y: {}, z: {}, w: {}}}\n",
            t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
    }
    files.push(("tf.yaml".into(), transforms));
    (files, Options::default())
}

fn euroc(cameras: &[Written]) -> Files {
    let camera = |(i, camera): (usize, &Written)| {
        let data: Vec<f64> = rows(&camera.pose).concat();
        let text = format!(
            "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {data:?}\nresolution: [640, 480]\ncamera_model: \
             pinhole\nintrinsics: {:?}\ndistortion_model: radial-tangential\ndistortion_coefficients: {:?}\n",
            camera.plane, camera.params
        );
        (format!("cam{i}/sensor.yaml"), text)
    };
    (
        cameras.iter().enumerate().map(camera).collect(),
        Options::default(),
    )
}

fn callab(cameras: &[Written]) -> Files {
    let mut text = String::new();
    for (i, camera) in cameras.iter().enumerate() {
        let list = |numbers: &[f64]| {
            numbers
                .iter()
                .map(f64::to_string)
                .collect::<Vec<_>>()
                .join(" ")
        };
        let [k1, k2, p1, p2, k3] = camera.params;
        assert_eq!([p1, p2], [0.0; 2]);
        text += &format!(
            "camera.{i}.A=[{}]\ncamera.{i}.width=640\ncamera.{i}.height=480\ncamera.{i}.k1={k1}\ncamera.{i}.k2={k2}\n\
             camera.{i}.k3={k3}\ncamera.{i}.R=[{}]\ncamera.{i}.T=[{}]\n",
            list(&k(camera.plane)),
            list(&part(&camera.pose, 0..3)),
            list(&part(&camera.pose, 3..4))
        );
    }
    let options = Options {
        unit: Some(Unit::Metre),
        ..Options::default()
    };
    (vec![("a.cal".into(), text)], options)
}

/// HALCON has another lens, so these have none.
fn halcon(cameras: &[Written]) -> Files {
    let mut files = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        assert_eq!(camera.params, [0.0; 5]);
        let [fx, fy, cx, cy] = camera.plane;
        let (focus, sx, sy) = (0.01, 0.01 / fx, 0.01 / fy);
        files.push((
            format!("c{i}.dat"),
            format!(
                "Focus:foc: {focus};\nKappa:kappa: 0;\nSx:sx: {sx};\nSy:sy: {sy};\nCx:cx: {cx};\nCy:cy: {cy};\n\
                 ImageWidth:imgw: 640;\nImageHeight:imgh: 480;\n"
            ),
        ));
    }
    for (i, camera) in cameras.iter().enumerate() {
        // abg: Rz Ry Rx, as nalgebra's roll, pitch and yaw.
        let (a, b, c) = camera.pose.rotation.euler_angles();
        let [a, b, c] = [a, b, c].map(f64::to_degrees);
        let t = camera.pose.translation.vector;
        files.push((
            format!("p{i}.dat"),
            format!("f 2\nr {a} {b} {c}\nt {} {} {}\n", t.x, t.y, t.z),
        ));
    }
    let direction = Some(Direction::WorldFromCam);
    (
        files,
        Options {
            direction,
            ..Options::default()
        },
    )
}

fn same(written: &[Written], rig: &Rig) {
    assert_eq!(rig.cameras().len(), written.len());
    assert_eq!(Rig::from_json(&rig.to_json()).unwrap(), *rig);
    // The world may be another one: everything is seen from the first camera.
    let first =
        |camera: &Camera| rig.cameras()[0].world_from_cam().inverse() * camera.world_from_cam();
    for (camera, truth) in rig.cameras().iter().zip(written) {
        let (got, expected) = (first(camera), written[0].pose.inverse() * truth.pose);
        let off = (got.to_homogeneous() - expected.to_homogeneous()).amax();
        assert!(off < 1e-9, "{}: off by {off}", camera.id());
        for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.35, 0.25)] {
            let [fx, fy, cx, cy] = truth.plane;
            let [k1, k2, p1, p2, k3] = truth.params;
            let r2: f64 = x * x + y * y;
            let g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
            let u = fx * (g * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx;
            let v = fy * (g * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy;
            let pixel = camera
                .intrinsics()
                .project(&Point3::new(2.0 * x, 2.0 * y, 2.0))
                .unwrap();
            assert!(
                (pixel.x - u).hypot(pixel.y - v) < 1e-8,
                "{}: {pixel}",
                camera.id()
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn rigs_come_back_from_every_format(cameras in prop::collection::vec(written(), 2..4)) {
        let with = |change: fn(&mut [f64; 5])| {
            let mut cameras = cameras.clone();
            cameras.iter_mut().for_each(|camera| change(&mut camera.params));
            cameras
        };
        // What a format has no coefficients for is left out.
        let (four, radial, none) = (
            with(|params| params[4] = 0.0),
            with(|params| (params[2], params[3]) = (0.0, 0.0)),
            with(|params| *params = [0.0; 5]),
        );
        let formats: [(&[Written], Writer); 9] = [
            (&four, kalibr),
            (&cameras, opencv),
            (&cameras, colmap),
            (&cameras, bop),
            (&cameras, nerf),
            (&cameras, ros),
            (&cameras, euroc),
            (&radial, callab),
            (&none, halcon),
        ];
        for (cameras, write) in formats {
            let (files, options) = write(cameras);
            let files: Vec<_> = files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
            same(cameras, &read(&files, &options).unwrap().rig);
        }
    }
}
