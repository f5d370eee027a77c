//! Reading JSON objects key by key, with errors that name the place and the fix: serde names the
//! place, but knows neither other formats' keys nor what to write for a missing one.

use serde_json::{Map, Value};

use crate::camera::projection::{distortions, families};

/// A sentence about what is wrong.
pub(crate) type Checked<T> = Result<T, String>;

/// A JSON object and how to name it in an error.
pub(crate) struct Fields<'a> {
    pub place: String,
    map: &'a Map<String, Value>,
}

impl<'a> Fields<'a> {
    /// Refuses a value that is no object, or one with a key that is neither in `required` nor in
    /// `optional`.
    pub fn new(
        place: String,
        value: &'a Value,
        required: &[&str],
        optional: &[&str],
    ) -> Checked<Self> {
        let Value::Object(map) = value else {
            let got = show(value);
            return Err(format!("{place} must be a JSON object, got {got}"));
        };
        let known: Vec<&str> = required.iter().chain(optional).copied().collect();
        if let Some(key) = map.keys().find(|key| !known.contains(&key.as_str())) {
            let (key, fix) = (shorten(key), fix(key, &known));
            return Err(format!("{place}: unknown key `{key}`; {fix}"));
        }
        if let Some(key) = required.iter().find(|key| !map.contains_key(**key)) {
            let example = example(key);
            return Err(format!("{place}: the key `{key}` is missing{example}"));
        }
        Ok(Self { place, map })
    }

    pub fn optional(&self, key: &str) -> Option<&'a Value> {
        self.map.get(key)
    }

    pub fn value(&self, key: &str) -> &'a Value {
        self.map.get(key).unwrap_or(&Value::Null)
    }

    pub fn text(&self, key: &str) -> Checked<&'a str> {
        let text = self.value(key).as_str();
        text.ok_or_else(|| self.wrong(key, "a string"))
    }

    pub fn number(&self, key: &str) -> Checked<f64> {
        number(self.value(key)).ok_or_else(|| self.wrong(key, "a finite number"))
    }

    /// False where the key is left out.
    pub fn flag(&self, key: &str) -> Checked<bool> {
        match self.optional(key) {
            None => Ok(false),
            Some(Value::Bool(flag)) => Ok(*flag),
            Some(_) => Err(self.wrong(key, "true or false")),
        }
    }

    pub fn list(&self, key: &str) -> Checked<&'a [Value]> {
        let list = self.value(key).as_array().map(Vec::as_slice);
        list.ok_or_else(|| self.wrong(key, "a list"))
    }

    pub fn numbers(&self, key: &str) -> Checked<Vec<f64>> {
        numbers(self.value(key)).ok_or_else(|| self.wrong(key, "a list of finite numbers"))
    }

    pub fn wrong(&self, key: &str, expected: &str) -> String {
        let (place, got) = (&self.place, show(self.value(key)));
        format!("{place}: `{key}` must be {expected}, got {got}")
    }
}

/// A finite number.
fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|x| x.is_finite())
}

/// A list of finite numbers.
pub(crate) fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(number).collect()
}

/// The value as JSON, shortened for a sentence.
pub(crate) fn show(value: &Value) -> String {
    shorten(&value.to_string())
}

pub(crate) fn shorten(text: &str) -> String {
    const LONGEST: usize = 60;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// What to write for a missing key, where its name does not say it.
fn example(key: &str) -> &'static str {
    match key {
        "format" => "; write \"format\": \"mvtop-rig\"",
        "version" => "; write \"version\": 1",
        "unit" => "; write \"unit\": \"m\", \"cm\" or \"mm\", the unit of all translations",
        _ => "",
    }
}

/// What to do about an unknown key.
fn fix(key: &str, known: &[&str]) -> String {
    let spelling = known.iter().find(|other| other.eq_ignore_ascii_case(key));
    match (spelling, instead_of(key, known)) {
        (Some(other), _) => format!("it is spelled `{other}`"),
        (_, Some(fix)) => fix,
        _ => format!("the keys are {}", known.join(", ")),
    }
}

/// What to write in place of a key that other formats use.
fn instead_of(key: &str, known: &[&str]) -> Option<String> {
    let fix = match key.to_lowercase().as_str() {
        "q" | "quat" | "quaternion" | "r" | "rotation" | "orientation" | "rotvec" | "rvec"
            if known.contains(&"q_wxyz") =>
        {
            "give the rotation as `q_wxyz` or `q_xyzw`, so that the order is stated"
        }
        "translation" | "position" | "tvec" if known.contains(&"t") => {
            "give the translation as `t`"
        }
        "extrinsics" | "extrinsic" | "pose" | "transform" | "transform_matrix" | "matrix" | "r"
        | "t" | "q" | "rt" | "rvec" | "tvec" | "rotation" | "translation" | "position"
        | "quaternion" | "t_world_camera" | "t_camera_world" | "world_from_cam"
        | "cam_from_world" | "cam_r_w2c" | "cam_t_w2c" | "q_wxyz" | "q_xyzw" => {
            "give the camera's place as `T_world_cam` (camera to world) or as `T_cam_world` \
             (world to camera), a 4x4 matrix or an object with `t` and `q_wxyz` or `q_xyzw`"
        }
        "k" | "cam_k" | "intrinsics" | "camera_matrix" | "focal" | "focal_length" | "f" => {
            "give `fx`, `fy`, `cx` and `cy` in pixels"
        }
        "d" | "dist" | "dist_coeffs" | "distortion_coefficients" | "distortion_model" | "k1" => {
            return Some(format!(
                "give `distortion` as {{\"model\": {:?}, \"params\": [...]}}",
                distortions().join("\" or \"")
            ));
        }
        "coeffs" | "coefficients" | "parameters" => "give the coefficients as `params`",
        "units" | "length_unit" | "scale" => "give the unit of length as `unit`: m, cm or mm",
        "name" | "camera_id" | "serial" => "give the camera's name as `id`",
        "size" | "resolution" | "image_size" | "w" | "h" => "give `width` and `height` in pixels",
        "ref" | "reference_camera" | "anchor" => "give the reference camera's id as `reference`",
        "camera" | "views" | "sensors" => "give the cameras as the list `cameras`",
        "type" | "camera_model" | "projection" => {
            let families = families().join(" or ");
            return Some(format!("give the projection as `model`: {families}"));
        }
        "camera_frame" | "pixel_origin" => {
            "leave it out: frames are OpenCV's (x right, y down, z forward) and pixel (0, 0) is \
             the center of the top-left pixel"
        }
        _ => return None,
    };
    Some(fix.to_owned())
}
