//! Smallest files of formats, of our own making; the fuzz targets change them at random.

pub const OPENMVG: &str = r#"{"sfm_data_version": "0.3", "root_path": "/images",
 "views": [
  {"key": 0, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 2147483649, "data":
   {"local_path": "/", "filename": "left.jpg", "width": 640, "height": 480, "id_view": 0,
    "id_intrinsic": 0, "id_pose": 0}}}},
  {"key": 1, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 2147483650, "data":
   {"local_path": "/", "filename": "right.jpg", "width": 640, "height": 480, "id_view": 1,
    "id_intrinsic": 1, "id_pose": 1}}}},
  {"key": 2, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 2147483651, "data":
   {"local_path": "/", "filename": "lost.jpg", "width": 640, "height": 480, "id_view": 2,
    "id_intrinsic": 1, "id_pose": 2}}}}],
 "intrinsics": [
  {"key": 0, "value": {"polymorphic_id": 2147483649, "polymorphic_name": "pinhole_brown_t2",
   "ptr_wrapper": {"id": 2147483652, "data": {"value0": {"width": 640, "height": 480,
   "focal_length": 500.0, "principal_point": [320.0, 240.0]},
   "disto_t2": [-0.2, 0.05, 0.01, 0.001, -0.002]}}}},
  {"key": 1, "value": {"polymorphic_id": 2147483650, "polymorphic_name": "fisheye",
   "ptr_wrapper": {"id": 2147483653, "data": {"width": 640, "height": 480, "focal_length": 300.0,
   "principal_point": [321.0, 241.0], "fisheye": [0.1, 0.02, 0.003, 0.0004]}}}}],
 "extrinsics": [
  {"key": 0, "value": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "center": [0, 0, 0]}},
  {"key": 1, "value": {"rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "center": [4, 2, 0]}}],
 "structure": [], "control_points": []}"#;
pub const ALICEVISION: &str = r#"{"version": ["1", "2", "6"],
 "views": [
  {"viewId": "11", "poseId": "11", "frameId": "0", "intrinsicId": "7", "path": "/a/left.jpg",
   "width": "640", "height": "480"},
  {"viewId": "12", "poseId": "12", "frameId": "1", "intrinsicId": "8", "path": "/a/right.jpg",
   "width": "640", "height": "480"}],
 "intrinsics": [
  {"intrinsicId": "7", "width": "640", "height": "480", "sensorWidth": "32", "sensorHeight": "24",
   "serialNumber": "", "type": "radial3", "initializationMode": "unknown", "focalLength": "25",
   "pixelRatio": "1", "principalPoint": ["1.5", "-2"], "distortionParams": ["-0.2", "0.05", "0.01"],
   "locked": "0"},
  {"intrinsicId": "8", "width": "640", "height": "480", "type": "brown", "pxFocalLength": "510",
   "principalPoint": ["321", "241"], "distortionParams": ["0.1", "0.02", "0.03", "0.001", "0.002"],
   "locked": "0"}],
 "poses": [
  {"poseId": "11", "pose": {"transform": {"rotation": ["1", "0", "0", "0", "1", "0", "0", "0", "1"],
   "center": ["0", "0", "0"]}, "locked": "0"}},
  {"poseId": "12", "pose": {"transform": {"rotation": ["0", "1", "0", "-1", "0", "0", "0", "0", "1"],
   "center": ["4", "2", "0"]}, "locked": "0"}}]}"#;
/// The other one stands at (4, 2, 0): by columns, t is -R C = (2, -4, 0).
pub const OPEN3D: &str = r#"{"class_name": "PinholeCameraTrajectory", "version_major": 1,
 "version_minor": 0, "parameters": [
 {"class_name": "PinholeCameraParameters", "version_major": 1, "version_minor": 0,
  "extrinsic": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  "intrinsic": {"height": 480, "width": 640,
   "intrinsic_matrix": [500, 0, 0, 0, 510, 0, 320, 240, 1]}},
 {"class_name": "PinholeCameraParameters", "version_major": 1, "version_minor": 0,
  "extrinsic": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 2, -4, 0, 1],
  "intrinsic": {"height": 480, "width": 640,
   "intrinsic_matrix": [500, 0, 0, 0, 510, 0, 320, 240, 1]}}]}"#;
pub const MULTICAL: &str = r#"{"cameras": {
 "left": {"model": "standard", "image_size": [640, 480],
  "K": [[500, 0, 320], [0, 510, 240], [0, 0, 1]], "dist": [[-0.2, 0.05, 0.001, -0.002, 0.01]]},
 "right": {"model": "standard", "image_size": [640, 480],
  "K": [[500, 0, 320], [0, 510, 240], [0, 0, 1]], "dist": [[0, 0, 0, 0, 0]]}},
 "camera_poses": {
 "left": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [0, 0, 0]},
 "right_to_left": {"R": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "T": [2, -4, 0]}},
 "image_sets": {"rgb": [{"left": "a.png", "right": "b.png"}]}}"#;
/// Transposes: K and, of the second camera, R.
pub const MATLAB: &str = r#"{"CameraParameters1": {"ImageSize": [480, 640],
  "IntrinsicMatrix": [[500, 0, 0], [0, 510, 0], [321, 241, 1]], "Skew": 0, "WorldUnits": "millimeters",
  "RadialDistortion": [-0.2, 0.05, 0.01], "TangentialDistortion": [0.001, -0.002],
  "EstimateSkew": false, "NumRadialDistortionCoefficients": 3, "ReprojectionErrors": []},
 "CameraParameters2": {"ImageSize": [480, 640],
  "K": [[500, 0, 321], [0, 510, 241], [0, 0, 1]], "WorldUnits": "millimeters",
  "RadialDistortion": [0.1, 0], "TangentialDistortion": [0, 0]},
 "RotationOfCamera2": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "TranslationOfCamera2": [200, -400, 0]}"#;
pub const METASHAPE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0">
 <chunk label="Chunk 1" enabled="true">
  <sensors next_id="2">
   <sensor id="0" label="a" type="frame">
    <resolution width="640" height="480"/>
    <calibration type="frame" class="initial"><f>400</f></calibration>
    <calibration type="frame" class="adjusted">
     <resolution width="640" height="480"/>
     <f>500</f><cx>1.5</cx><cy>-2</cy><b1>10</b1>
     <k1>-0.2</k1><k2>0.05</k2><k3>0.01</k3><p1>0.001</p1><p2>-0.002</p2>
    </calibration>
   </sensor>
   <sensor id="1" label="b" type="fisheye">
    <resolution width="640" height="480"/>
    <calibration type="fisheye" class="adjusted">
     <f>300</f><k1>0.1</k1><k2>0.02</k2><k3>0.003</k3><k4>0.0004</k4>
    </calibration>
   </sensor>
  </sensors>
  <components next_id="1" active_id="0">
   <component id="0" label="Component 1">
    <transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>5 5 5</translation><scale>0.1</scale></transform>
   </component>
  </components>
  <cameras next_id="3">
   <camera id="0" sensor_id="0" component_id="0" label="left.jpg">
    <transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>
   </camera>
   <group id="0" label="g">
    <camera id="1" sensor_id="1" component_id="0" label="right.jpg">
     <transform>0 1 0 4 -1 0 0 2 0 0 1 0 0 0 0 1</transform>
    </camera>
   </group>
   <camera id="2" sensor_id="0" label="lost.jpg"/>
  </cameras>
 </chunk>
</document>"#;

fn camera(number: usize, kind: u8, params: &str, group: u8, pose: &str) -> String {
    let count = params.split(',').count();
    format!(
        "camera_{number}:
   camera_matrix: !!opencv-matrix
      rows: 3
      cols: 3
      dt: d
      data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
   distortion_vector: !!opencv-matrix
      rows: 1
      cols: {count}
      dt: d
      data: [ {params} ]
   distortion_type: {kind}
   camera_group: {group}
   img_width: 640
   img_height: 480
   camera_pose_matrix: !!opencv-matrix
      rows: 4
      cols: 4
      dt: d
      data: [ {pose} ]
"
    )
}

const HERE: &str = "1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.";
/// A quarter turn back about z, at (4, 2, 0).
const THERE: &str = "0., 1., 0., 4., -1., 0., 0., 2., 0., 0., 1., 0., 0., 0., 0., 1.";

/// Two cameras, the other one with a lens of this kind and of this group.
pub fn mccalib(kind: u8, group: u8) -> String {
    let first = camera(0, 0, "-0.2, 0.05, 0.001, -0.002, 0.01", 0, HERE);
    let second = camera(1, kind, "0.1, 0.02, 0.003, 0.0004", group, THERE);
    format!("%YAML:1.0\n---\nnb_camera: 2\n{first}{second}")
}

pub const ZED: &str = "[LEFT_CAM_HD]
fx=700
fy=701
cx=640
cy=360
k1=-0.17
k2=0.02
p1=0.0001
p2=-0.0002
k3=0.003

[RIGHT_CAM_HD]
fx=702
fy=703
cx=641
cy=361
k1=-0.17
k2=0.02
p1=0
p2=0
k3=0

[LEFT_CAM_VGA]
fx=350
fy=350
cx=336
cy=188
k1=0
k2=0
p1=0
p2=0
k3=0

[RIGHT_CAM_VGA]
fx=350
fy=350
cx=336
cy=188
k1=0
k2=0
p1=0
p2=0
k3=0

[STEREO]
Baseline=120
TY=0
TZ=0
CV_HD=0
RX_HD=0
RZ_HD=0
CV_VGA=1.5707963267948966
RX_VGA=0
RZ_VGA=0

[MISC]
Sensor_ID=1
";

pub const DEPTHAI: &str = r#"{"batchName": "", "boardName": "OAK-D", "version": 7, "cameraData": [
 [0, {"cameraType": 0, "width": 1920, "height": 1080, "lensPosition": 135, "specHfovDeg": 68.8,
   "distortionCoeff": [0.1, -0.2, 0.0001, 0.0002, 0.3, 0.01, 0.02, 0.03, 0, 0, 0, 0, 0, 0],
   "intrinsicMatrix": [[1500, 0, 960], [0, 1501, 540], [0, 0, 1]],
   "extrinsics": {"rotationMatrix": [], "specTranslation": {"x": 0, "y": 0, "z": 0}, "toCameraSocket": -1,
     "translation": {"x": 0, "y": 0, "z": 0}}}],
 [1, {"cameraType": 0, "width": 1280, "height": 800, "lensPosition": 0, "specHfovDeg": 71.9,
   "distortionCoeff": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
   "intrinsicMatrix": [[800, 0, 640], [0, 800, 400], [0, 0, 1]],
   "extrinsics": {"rotationMatrix": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
     "specTranslation": {"x": -7.5, "y": 0, "z": 0}, "toCameraSocket": 2, "translation": {"x": -7.5, "y": 0, "z": 0}}}],
 [2, {"cameraType": 1, "width": 1280, "height": 800, "lensPosition": 0, "specHfovDeg": 71.9,
   "distortionCoeff": [0.1, 0, 0, 0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
   "intrinsicMatrix": [[800, 0, 640], [0, 800, 400], [0, 0, 1]],
   "extrinsics": {"rotationMatrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
     "specTranslation": {"x": 3.75, "y": 0, "z": 0}, "toCameraSocket": 0, "translation": {"x": 3.75, "y": 0, "z": 0}}}]],
 "imuExtrinsics": {"rotationMatrix": [], "toCameraSocket": -1}}"#;
