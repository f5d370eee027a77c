//! Calibration files of any program are answered with a rig or a sentence, never with a panic: good
//! files, changed at random. `make fuzz` draws new ones for as long as one likes.

#[path = "../../mvtop-core/tests/fuzz/mutate.rs"]
mod mutate;
#[path = "import/formats/samples.rs"]
mod samples;

use mutate::{changed, edits};
use mvtop_geometry::{Result, Rig};
use mvtop_import::{Direction, Format, ImageSize, Imported, Options, import};
use proptest::prelude::*;

const OPENCV: &str = "%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 700., 0., 320., 0., 710., 240., 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ -1.0e-01, 2.0e-02, 0., 0., 0., 0., 0., 3.0e-02, 0., 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 330., 0., 610., 250., 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 1., 0., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -4., 0., 0. ]
";
const NAMED: &str = r#"{"left": {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],
 "dist": [[0.1, 0, 0, 0, 0]], "image_size": [640, 480], "rvec": [0, 0, 0], "tvec": [[0], [0], [0]]},
 "right": {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "dist": [0.1, 0, 0, 0, 0],
 "image_size": [640, 480], "rvec": [0, 1.5, 0], "tvec": [1, 0, 0]}}"#;
const KALIBR: &str = "cam0:
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [0.1, 0.02, 0.003, 0.0004]
  intrinsics: [300, 301, 320, 240]
  resolution: [640, 480]
cam1:
  camera_model: pinhole
  distortion_model: radtan
  distortion_coeffs: [0.1, 0.02, 0.003, 0.0004]
  intrinsics: [300, 301, 320, 240]
  resolution: [640, 480]
  T_cn_cnm1:
  - [1, 0, 0, -0.1]
  - [0, 1, 0, 0]
  - [0, 0, 1, 0]
  - [0, 0, 0, 1]
";
const INFO: &str = "image_width: 640
image_height: 480
camera_name: left_optical_frame
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 320, 0, 500, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, 0, 0, 0, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [480, 0, 310, 0, 0, 480, 230, 0, 0, 0, 1, 0]
";
const TF: &str = "transforms:
- header:
    frame_id: base
  child_frame_id: left_link
  transform:
    translation: {x: 1.0, y: 0.0, z: 0.0}
    rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}
- header:
    frame_id: left_link
  child_frame_id: left_optical_frame
  transform:
    translation: {x: 0.0, y: 0.5, z: 0.0}
    rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}
";
const URDF: &str = r#"<robot name="arm"><link name="base"/>
<joint name="wrist" type="revolute"><parent link="base"/><child link="hand"/></joint>
<joint name="a" type="fixed"><parent link="hand"/><child link="left_optical_frame"/>
<origin xyz="1 0.5 0" rpy="-1.57 0 -1.57"/></joint></robot>"#;
const CAMERAS: &str = "# CAMERA_ID, MODEL, ...
7 SIMPLE_RADIAL 640 480 500 320 240 0.05
8 OPENCV 640 480 500 500 320 240 0.1 0.01 0 0
";
const IMAGES: &str = "# IMAGE_ID, QW, QX, ...
1 1 0 0 0 0 0 0 7 a/left.png

2 0 1 0 0 2 0 3 8 a/top view.png
10 20 -1
";
const BOP: &str = r#"{"3": {"cam_K": [500, 0, 320, 0, 510, 240, 0, 0, 1], "depth_scale": 1.0,
 "cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1], "cam_t_w2c": [200, 0, 300]},
 "12": {"cam_K": [500, 0, 320, 0, 510, 240, 0, 0, 1], "cam_R_w2c": [1, 0, 0, 0, -1, 0, 0, 0, -1],
 "cam_t_w2c": [0, 0, 300]}}"#;
const NERF: &str = r#"{"w": 640, "h": 480, "fl_x": 500, "fl_y": 510, "cx": 320, "cy": 240, "k1": 0.1,
 "frames": [{"file_path": "./images/a.png", "transform_matrix":
 [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
 {"file_path": "./images/b.png", "fl_x": 400, "transform_matrix":
 [[0, 0, 1, 2], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]}]}"#;
const CALLAB: &str = "# made with CalLab
camera.0.version=2
camera.0.A=[500 0 320; 0 510 240; 0 0 1]
camera.0.width=640
camera.0.height=480
camera.0.k1=-0.2
camera.0.k2=0.1
camera.0.origin=corner
camera.0.R=[1 0 0; 0 -1 0; 0 0 -1]
camera.0.T=[200 0 300]
";
const HALCON: &str = "Focus:foc: 0.008;
Kappa:kappa: -1200;
Sx:sx: 1.0e-05;
Sy:sy: 1.0e-05;
Cx:cx: 320;
Cy:cy: 240;
ImageWidth:imgw: 640;
ImageHeight:imgh: 480;
";
const POSE: &str = "# 3D POSE PARAMETERS
f 4
r 90 0 90
t 0.1 0.2 0.3
";
const EUROC: &str = "sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458, 457, 367, 248]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
";

const ANIPOSE: &str = "[cam_0]
name = \"left\"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.0, 0.0, 0.0, 0.0]
rotation = [0.1, 0.2, 0.3]
translation = [1.0, 2.0, 3.0]
";
const EASYMOCAP: &str = "%YAML:1.0
---
names:
   - a
K_a: [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
dist_a: [0.1, 0, 0, 0, 0]
R_a: [0, 0.1, 0]
T_a: [1, 0, 0]
";
const CAMODOCAL: &str = "%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: left
image_width: 640
image_height: 480
projection_parameters:
   k2: 0.1
   k3: 0.02
   k4: 0.003
   k5: 0.0004
   mu: 300
   mv: 301
   u0: 320
   v0: 240
";
const XML: &str = "<?xml version=\"1.0\"?>
<opencv_storage>
<K type_id=\"opencv-matrix\"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>500. 0. 320. 0. 500. 240. 0. 0. 1.</data></K>
<xi>0.5</xi><k1>0.01</k1>
<image_width>640</image_width><image_height>480</image_height>
</opencv_storage>
";

/// The files of a rig, by name.
type Files = Vec<(&'static str, Vec<u8>)>;

/// Rigs of each format, and what to know of each beyond its files.
fn rigs() -> Vec<(Options, Files)> {
    let sized = || vec![ImageSize::parse("640x480").unwrap()];
    let named = |format| Options {
        format: Some(format),
        ..Options::default()
    };
    let scaled = |format| Options {
        scale: Some(0.1),
        ..named(format)
    };
    let text = |files: &[(&'static str, &str)]| -> Files {
        let files = files.iter();
        files
            .map(|(name, text)| (*name, text.as_bytes().to_vec()))
            .collect()
    };
    let stereo = Options {
        image_sizes: sized(),
        ..scaled(Format::OpenCv)
    };
    let bop = Options {
        image_sizes: sized(),
        ..named(Format::Bop)
    };
    let halcon = Options {
        direction: Some(Direction::WorldFromCam),
        ..named(Format::Halcon)
    };
    let [cameras, images] = colmap_binary();
    vec![
        (stereo, text(&[("stereo.yml", OPENCV)])),
        (scaled(Format::OpenCv), text(&[("rig.json", NAMED)])),
        (named(Format::Kalibr), text(&[("camchain.yaml", KALIBR)])),
        (
            named(Format::Ros),
            text(&[("left.yaml", INFO), ("tf.yaml", TF)]),
        ),
        (
            named(Format::Ros),
            text(&[("left.yaml", INFO), ("arm.urdf", URDF)]),
        ),
        (
            scaled(Format::Colmap),
            text(&[("cameras.txt", CAMERAS), ("images.txt", IMAGES)]),
        ),
        (
            scaled(Format::Colmap),
            vec![("cameras.bin", cameras), ("images.bin", images)],
        ),
        (bop, text(&[("scene_camera.json", BOP)])),
        (scaled(Format::Nerf), text(&[("transforms.json", NERF)])),
        (scaled(Format::CalLab), text(&[("a.cal", CALLAB)])),
        (halcon, text(&[("a.dat", HALCON), ("pose.dat", POSE)])),
        (
            named(Format::Euroc),
            text(&[("mav0/cam0/sensor.yaml", EUROC)]),
        ),
        (scaled(Format::Anipose), text(&[("a.toml", ANIPOSE)])),
        (
            Options {
                image_sizes: sized(),
                ..scaled(Format::EasyMocap)
            },
            text(&[("intri.yml", EASYMOCAP)]),
        ),
        (named(Format::Camodocal), text(&[("a.yaml", CAMODOCAL)])),
        (named(Format::OpenCv), text(&[("a.xml", XML)])),
        (
            scaled(Format::OpenMvg),
            text(&[("sfm_data.json", samples::OPENMVG)]),
        ),
        (
            scaled(Format::AliceVision),
            text(&[("cameras.sfm", samples::ALICEVISION)]),
        ),
        (
            scaled(Format::Open3d),
            text(&[("trajectory.json", samples::OPEN3D)]),
        ),
        (
            scaled(Format::Multical),
            text(&[("calibration.json", samples::MULTICAL)]),
        ),
        (
            scaled(Format::McCalib),
            text(&[("data.yml", &samples::mccalib(1, 0))]),
        ),
        (
            named(Format::Matlab),
            text(&[("stereo.json", samples::MATLAB)]),
        ),
        (
            named(Format::Metashape),
            text(&[("cameras.xml", samples::METASHAPE)]),
        ),
        (
            Options {
                image_sizes: vec![ImageSize::parse("1280x720").unwrap()],
                ..named(Format::Zed)
            },
            text(&[("SN123.conf", samples::ZED)]),
        ),
        (
            named(Format::DepthAi),
            text(&[("calib.json", samples::DEPTHAI)]),
        ),
    ]
}

/// One camera, and one image with a point.
fn colmap_binary() -> [Vec<u8>; 2] {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend([7u32, 2].iter().flat_map(|n| n.to_le_bytes()));
    cameras.extend([640u64, 480].iter().flat_map(|n| n.to_le_bytes()));
    let params = [500.0f64, 320.0, 240.0, 0.05];
    cameras.extend(params.iter().flat_map(|n| n.to_le_bytes()));
    let mut images = 1u64.to_le_bytes().to_vec();
    images.extend(1u32.to_le_bytes());
    let pose = [0.0f64, 1.0, 0.0, 0.0, 2.0, 0.0, 3.0];
    images.extend(pose.iter().flat_map(|n| n.to_le_bytes()));
    images.extend(7u32.to_le_bytes());
    images.extend(b"left.png\0");
    images.extend(1u64.to_le_bytes());
    images.extend([0; 24]);
    [cameras, images]
}

fn read(files: &[(&str, Vec<u8>)], options: &Options) -> Result<Imported> {
    let folder = tempfile::tempdir().unwrap();
    let written = files.iter().map(|(name, bytes)| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    });
    import(&written.collect::<Vec<_>>(), options)
}

#[test]
fn unchanged_files_are_read() {
    for (options, files) in rigs() {
        let recognised = Options {
            format: None,
            ..options.clone()
        };
        assert_eq!(
            Some(read(&files, &recognised).unwrap().format),
            options.format
        );
    }
}

proptest! {
    #[test]
    fn calibrations(edits in edits(), rig in 0..23usize, which in 0..2usize, named in any::<bool>()) {
        let (mut options, mut files) = rigs().swap_remove(rig);
        options.format = options.format.filter(|_| named);
        let which = which % files.len();
        files[which].1 = changed(&files[which].1, &edits);
        match read(&files, &options) {
            // What is read is written so that it is read again.
            Ok(imported) => {
                let again = Rig::from_json(&imported.rig.to_json());
                prop_assert!(again.is_ok(), "{:?}", again);
            }
            Err(error) => prop_assert!(error.to_string().len() > 10, "{}", error),
        }
    }
}
