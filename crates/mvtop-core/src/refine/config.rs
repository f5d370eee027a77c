//! Every number that steers the refinement.
//!
//! "SRT3D" is Stoiber et al., "SRT3D: A Sparse Region-Based 3D Object Tracking Approach for the Real
//! World", 2022; M3T is its successor. "Not measured" marks values that no experiment supports.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::closeup::FILL;

/// One stage of the refinement: the size of its crops, and its iterations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Px of the crop per px of the image, if `side_px` allows it.
    pub scale: f64,
    /// Least and greatest side of the crop, px.
    pub side_px: [f64; 2],
    /// Share of the crop's side that the object's box takes.
    pub fill: f64,
    /// Sampling distance on correspondence lines, per iteration, px of the crop (M3T: `scales`).
    pub steps_px: Vec<f64>,
}

/// How the texture of a part is compared with the images; all of it is not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TextureConfig {
    /// Least standard deviations of log brightness and shares of R and G.
    pub contrast: [f32; 3],
    /// Blur radius in the first and last pass of the search, shares of the diameter.
    pub blur: [f64; 2],
    /// Reach and step of the first and last search about a round part's axis, degrees.
    pub search_deg: [[f64; 2]; 2],
    /// Least normalised cross-correlation of an accepted angle.
    pub min_correlation: f64,
    /// Largest standard deviation of a round part's radius, share of the diameter.
    pub max_unevenness: f64,
    /// Displacement for the texture gain, share of the projected diameter.
    pub displacement: f64,
}

/// Every number that steers the refinement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RefineConfig {
    /// First stage, at the image's resolution; 224 px was compared with 128 px on pairs of images of a
    /// synthetic ball, the rest is not measured.
    pub coarse: Stage,
    /// Second stage, at a higher resolution, as regions are sampled by whole pixels; docs/decisions/0013.
    pub fine: Stage,
    /// Least angle between normals at a crease, degrees; not measured.
    pub crease_deg: f64,
    /// Most segments; a mesh of more colors is textured and has one.
    pub max_segments: usize,
    /// Line steps of a refinement in one view alone, on a coarse crop, px; not measured.
    pub one_view_steps_px: Vec<f64>,
    /// Mean motion of the edges below which only the last line step is left, px of the crop.
    pub converged_px: f64,
    /// Number of contour points per view (M3T uses 200 lines); not measured.
    pub contour_points: f64,
    /// Least distance of contour points, and of samples from an edge, px of the crop; not measured.
    pub contour_margin_px: f64,
    /// Depth tolerance of visibility at silhouettes, other edges and texture, diameters; not
    /// measured.
    pub occlusion_tolerance: [f64; 3],
    /// Amplitude of the smoothed step function (M3T: `function_amplitude`).
    pub function_amplitude: f64,
    /// Width of the background band, px of the crop (M3T uses 20 px); not measured.
    pub background_band_px: usize,
    /// Added to the squared color gradient, on short and on long lines; not measured.
    pub gradient_floor: [f64; 2],
    /// Chromaticity difference of equal odds, and largest log-odds; not measured.
    pub chromaticity: [f64; 2],
    /// Largest displacement and standard deviation of inliers, px of the crop; not measured.
    pub inlier_px: [f64; 2],
    /// Neighbouring lines that count as one; not measured.
    pub correlated_lines: f64,
    /// Share of the information that the covariance uses; not measured.
    pub information_deflation: f64,
    /// Least eigenvalue of an observable direction, share of the largest; not measured.
    pub observability_floor: f64,
    /// Tolerated loss of separation at an accepted pose, bits per pixel; not measured.
    pub accept_margin_bits: f64,
    /// Comparison of the texture with the images.
    pub texture: TextureConfig,
}

impl Default for TextureConfig {
    fn default() -> Self {
        Self {
            contrast: [0.15, 0.02, 0.02],
            blur: [0.04, 0.008],
            search_deg: [[24.0, 2.0], [5.0, 0.5]],
            min_correlation: 0.35,
            max_unevenness: 0.0125,
            displacement: 0.1,
        }
    }
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            coarse: Stage {
                scale: 1.0,
                side_px: [96.0, 224.0],
                fill: FILL,
                steps_px: vec![4.0, 3.0, 2.0],
            },
            fine: Stage {
                scale: 1.5,
                side_px: [96.0, 320.0],
                fill: 0.8,
                steps_px: vec![2.0, 1.5, 1.0, 1.0, 1.0],
            },
            crease_deg: 30.0,
            max_segments: 4,
            one_view_steps_px: vec![4.0, 2.0, 1.0, 1.0],
            converged_px: 0.05,
            contour_points: 220.0,
            contour_margin_px: 1.5,
            occlusion_tolerance: [0.1, 0.03, 0.02],
            function_amplitude: 0.43,
            background_band_px: 24,
            gradient_floor: [1e-4, 1e-3],
            chromaticity: [0.06, 2.0],
            inlier_px: [1.5, 2.0],
            correlated_lines: 4.0,
            information_deflation: 0.25,
            observability_floor: 0.002,
            accept_margin_bits: 0.05,
            texture: TextureConfig::default(),
        }
    }
}

impl RefineConfig {
    /// Refuses numbers with which no pose can be refined; the text is the problem.
    ///
    /// # Errors
    /// A number that is not above 0, or beyond its bound.
    pub fn check(&self) -> Result<(), String> {
        let all = serde_json::to_value(self).map_err(|error| error.to_string())?;
        let stage = |stage: &Stage| {
            let [least, most] = stage.side_px;
            least >= 16.0 && least <= most && most <= 2048.0 && stage.fill < 1.0
        };
        let steps = [&self.coarse, &self.fine].map(|stage| &stage.steps_px);
        let has_steps = |steps: &Vec<f64>| (1..=50).contains(&steps.len());
        let angles = &self.texture.search_deg;
        let is_usable = is_positive(&all)
            && stage(&self.coarse)
            && stage(&self.fine)
            && self.max_segments <= usize::from(u8::MAX)
            && steps
                .into_iter()
                .chain([&self.one_view_steps_px])
                .all(has_steps)
            && self.contour_points <= 1e4
            && self.background_band_px <= 1000
            && self.function_amplitude < 0.5
            && angles
                .iter()
                .all(|[reach, step]| reach <= &180.0 && reach / step <= 1e3);
        is_usable.then_some(()).ok_or_else(|| {
            format!(
                "refinement has {all}, expected numbers above 0, sides of 16 to 2048 px in order, a \
                 fill below 1, an amplitude below 0.5, and 1 to 50 steps"
            )
        })
    }

    /// Line step at which poses are evaluated: the last one of the fine stage.
    pub(super) fn final_step_px(&self) -> f64 {
        self.fine.steps_px.last().copied().unwrap_or(1.0)
    }

    /// Whether a line's step is longer than the first one of the fine stage.
    pub(super) fn is_long(&self, step_px: f64) -> bool {
        self.fine.steps_px.first().is_some_and(|px| step_px > *px)
    }
}

/// Whether all numbers in a value are finite and above 0.
fn is_positive(value: &Value) -> bool {
    match value {
        Value::Number(number) => number.as_f64().is_some_and(|x| x > 0.0),
        Value::Array(all) => all.iter().all(is_positive),
        Value::Object(all) => all.values().all(is_positive),
        // Numbers that are not finite become null.
        _ => false,
    }
}
