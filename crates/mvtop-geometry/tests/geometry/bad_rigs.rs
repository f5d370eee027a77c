//! Rig files that must be refused.

/// A good rig, as text; the bad ones differ from it in one place.
pub const GOOD: &str = r#"{
  "format": "mvtop-rig",
  "version": 1,
  "unit": "m",
  "reference": "wide",
  "cameras": [
    {
      "id": "left", "width": 1280, "height": 720, "model": "pinhole",
      "fx": 863.73, "fy": 863.22, "cx": 637.52, "cy": 385.53,
      "distortion": {"model": "brown_conrady", "params": [0.0885, -0.226, -0.00015, 0.00057, 0]},
      "T_world_cam": {"t": [0.1, 0, 0.8], "q_wxyz": [0.6, 0, 0.8, 0]}
    },
    {
      "id": "wide", "width": 640, "height": 480, "model": "fisheye",
      "fx": 278, "fy": 278, "cx": 315.5, "cy": 244.5,
      "distortion": {"model": "kannala_brandt", "params": [-0.006, 0.016, -0.024, 0.0155]},
      "T_cam_world": [[0, -1, 0, 0.25], [1, 0, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]
    }
  ]
}"#;

/// What is replaced in [`GOOD`], by what, and the facts that the error must state.
#[rustfmt::skip] // a table
pub const BAD: &[(&str, &str, &[&str])] = &[
    // The file.
    (GOOD, "", &["not valid JSON", "line 1 column 0"]),
    (GOOD, "[]", &["top level must be a JSON object", "[]"]),
    ("\"unit\": \"m\",", "\"unit\": \"m\"", &["not valid JSON", "line 5 column 3"]),
    ("1280", "NaN", &["not valid JSON", "line 8 column", "NaN and Infinity are not allowed"]),
    ("863.73", "1e999", &["not valid JSON", "number out of range", "line 9"]),
    ("\"mvtop-rig\"", "\"bop\"", &["`format` must be \"mvtop-rig\"", "got \"bop\""]),
    ("\"format\": \"mvtop-rig\",", "", &["`format` is missing", "\"format\": \"mvtop-rig\""]),
    ("\"version\": 1", "\"version\": 2", &["`version` must be 1", "got 2"]),
    ("\"version\"", "\"Version\"", &["unknown key `Version`", "it is spelled `version`"]),
    // The unit.
    ("\"unit\": \"m\",", "", &["`unit` is missing", "\"m\", \"cm\" or \"mm\""]),
    ("\"unit\": \"m\"", "\"unit\": \"metres\"", &["`unit` must be", "\"mm\"", "got \"metres\""]),
    ("\"unit\": \"m\"", "\"unit\": null", &["`unit` must be a string", "got null"]),
    ("\"unit\"", "\"units\"", &["unknown key `units`", "`unit`: m, cm or mm"]),
    ("[0.1, 0, 0.8]", "[250, 0, 800]", &["`left` and `wide`", "m apart", "set `unit` to \"mm\""]),
    ("\"unit\": \"m\"", "\"unit\": \"mm\"", &["`left` and `wide`", "set `unit` to \"m\""]),
    ("[0.1, 0, 0.8]", "[0, 0.25, -0.5]", &["0.0000 m apart", "check the translations"]),
    ("[0.1, 0, 0.8]", "[1e30, 0, 0]", &["camera `left`", "1.0e30 m", "not credible"]),
    // The cameras.
    ("\"reference\": \"wide\"", "\"reference\": \"up\"", &["`reference` is `up`", "left, wide"]),
    ("\"reference\": \"wide\"", "\"reference\": 1", &["`reference` must be a string", "got 1"]),
    ("\"id\": \"wide\"", "\"id\": \"left\"", &["two cameras have the id `left`"]),
    ("\"id\": \"wide\"", "\"id\": \"\"", &["camera number 2", "is empty"]),
    ("\"id\": \"wide\"", "\"id\": \"a/b\"", &["camera number 2", "a/b", "file name"]),
    ("\"id\": \"wide\"", "\"id\": \"a=b\"", &["camera number 2", "a=b", "file name"]),
    ("\"id\": \"wide\"", "\"id\": \"..\"", &["camera number 2", "\"..\"", "file name"]),
    ("\"id\": \"wide\"", "\"id\": 7", &["camera number 2", "`id` must be a string", "got 7"]),
    ("\"id\": \"wide\",", "", &["camera number 2", "`id` is missing"]),
    ("\"id\": \"wide\"", "\"name\": \"wide\"", &["unknown key `name`", "as `id`"]),
    // Size, focal length, principal point, what the lens reaches.
    ("\"fx\": 278", "\"max_angle_deg\": 0, \"fx\": 278", &["camera `wide`", "`max_angle_deg`", "above 0", "got 0"]),
    ("\"fx\": 278", "\"max_angle_deg\": \"90\", \"fx\": 278", &["camera `wide`", "`max_angle_deg` must be", "\"90\""]),
    ("\"fx\": 278", "\"skew\": 315.5, \"fx\": 278", &["camera `wide`", "`skew`", "tenth of `fx`", "got 315.5"]),
    ("\"fx\": 278", "\"skew\": null, \"fx\": 278", &["camera `wide`", "`skew` must be", "null"]),
    ("\"width\": 1280", "\"width\": 0", &["camera `left`", "`width`", "from 1 to", "got 0"]),
    ("\"width\": 1280", "\"width\": 12.5", &["camera `left`", "`width`", "whole", "got 12.5"]),
    ("\"height\": 480", "\"height\": 1e9", &["camera `wide`", "`height`", "20000"]),
    ("\"height\": 480,", "", &["camera `wide`", "`height` is missing"]),
    ("\"fx\": 278", "\"fx\": 0", &["camera `wide`", "`fx`", "above 0", "got 0"]),
    ("\"fy\": 278", "\"fy\": -278", &["camera `wide`", "`fy`", "above 0", "got -278"]),
    ("\"fx\": 863.73", "\"fx\": 0.67", &["camera `left`", "`fx`", "0.67 px", "in pixels"]),
    ("\"fy\": 863.22", "\"fy\": 86322", &["camera `left`", "`fy`", "86322 px", "too long", "720 px"]),
    ("[0.0885, -0.226, ", "[-5000, -0.226, ", &["camera `left`", "middle of the image", "distortion"]),
    ("\"fx\": 278", "\"fx\": \"278\"", &["`fx` must be a finite number", "got \"278\""]),
    ("\"cx\": 315.5", "\"cx\": -700", &["camera `wide`", "`cx`", "-700 px", "`width` 640 px"]),
    ("\"cy\": 385.53", "\"cy\": 1500", &["camera `left`", "`cy`", "1500 px", "`height` 720 px"]),
    ("\"fx\": 278, \"fy\"", "\"K\": [], \"fy\"", &["unknown key `K`", "`fx`, `fy`, `cx`"]),
    // Model and distortion.
    ("\"fisheye\"", "\"omni\"", &["`model` must be \"pinhole\" or \"fisheye\"", "got \"omni\""]),
    ("\"fisheye\"", "\"pinhole\"", &["camera `wide`", "kannala_brandt needs `model` \"fisheye\""]),
    ("\"pinhole\"", "\"fisheye\"", &["camera `left`", "brown_conrady needs `model` \"pinhole\""]),
    ("\"brown_conrady\"", "\"radtan\"", &["camera `left`", "brown_conrady", "got \"radtan\""]),
    (", 0.00057, 0]", "]", &["camera `left`", "0, 4, 5, 8, 12 or 14 coefficients", "got 3"]),
    (", 0.0155]", "]", &["camera `wide`", "4 coefficients", "got 3"]),
    ("0.0155", "null", &["camera `wide`, `distortion`", "`params` must be a list of finite"]),
    ("\"params\": [0.", "\"coeffs\": [0.", &["unknown key `coeffs`", "as `params`"]),
    // Direction and rotation.
    ("T_cam_world", "extrinsics", &["`wide`", "`extrinsics`", "`T_world_cam`", "`T_cam_world`"]),
    ("T_cam_world", "pose", &["camera `wide`", "`pose`", "`T_world_cam`", "`T_cam_world`"]),
    ("T_cam_world", "R", &["camera `wide`", "`R`", "`T_world_cam`", "`T_cam_world`"]),
    ("\"fisheye\",", "\"fisheye\", \"T_world_cam\": [],", &["camera `wide`", "only one of"]),
    ("\"q_wxyz\"", "\"q\"", &["`left`, `T_world_cam`", "unknown key `q`", "`q_wxyz` or `q_xyzw`"]),
    (", \"q_wxyz\": [0.6, 0, 0.8, 0]", "", &["`left`", "rotation is missing"]),
    ("\"q_wxyz\": [0.6, 0, 0.8, 0]", "\"t\": [0, 0, 0]", &["the key `t` comes twice"]),
    ("\"t\": [0.1, 0, 0.8], ", "", &["camera `left`, `T_world_cam`", "`t` is missing"]),
    ("[0.6, 0, 0.8, 0]", "[0.6, 0, 0.9, 0]", &["`q_wxyz` must have the norm 1", "got 1.0817"]),
    ("[0.6, 0, 0.8, 0]", "[0, 0, 0, 0]", &["`q_wxyz` must have the norm 1", "got 0.0000"]),
    ("[0.6, 0, 0.8, 0]", "[0.6, 0, 0.8]", &["`q_wxyz` must be 4 numbers", "got 3"]),
    ("[0.1, 0, 0.8]", "[0.1, 0]", &["`t` must be 3 numbers", "got 2"]),
    ("{\"t\": [0.1, 0, 0.8], \"q_wxyz\": [0.6, 0, 0.8, 0]}", "5", &["4x4 matrix", "got 5"]),
    ("[0, 0, 0, 1]]", "[0, 0, 0, 2]]", &["camera `wide`", "last row", "[0.0, 0.0, 0.0, 2.0]"]),
    (
        "[[0, -1, 0, 0.25], [1, 0, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]",
        "[[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0.25, 0, 0.5, 1]]",
        &["camera `wide`", "last row", "in columns, so transpose it"],
    ),
    (", [0, 0, 0, 1]]", "]", &["camera `wide`, `T_cam_world`", "4 rows of 4 finite numbers"]),
    ("[1, 0, 0, 0]", "[1, 0, 0, null]", &["`T_cam_world`", "4 rows of 4 finite numbers"]),
    ("[1, 0, 0, 0]", "[-1, 0, 0, 0]", &["camera `wide`", "reflection", "right-handed"]),
    ("[1, 0, 0, 0]", "[1.01, 0, 0, 0]", &["not a rotation", "determinant 1.0100", "2.0e-2"]),
    ("[1, 0, 0, 0]", "[1e200, 1e200, 0, 0]", &["camera `wide`", "not a rotation"]),
];
