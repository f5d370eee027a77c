//! Every number that steers inference, in one place.
//!
//! A bundle's `model.json` may set any of them under `inference`; a caller may override them when the
//! bundle is loaded. Numbers that training fixes (crop padding, strides, input size) are not here:
//! they belong to the network.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::refine::RefineConfig;
use crate::{Error, Result};

/// Raised when evidence or scores change their meaning: what a bundle was fitted for another version
/// does not hold.
pub const PIPELINE_VERSION: u32 = 2;

/// All numbers that steer inference.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct InferenceConfig {
    /// Large images shown to the detector in tiles.
    pub tiling: TilingConfig,
    /// Boxes of different views matched to one object.
    pub association: AssociationConfig,
    /// Poses from object coordinates.
    pub pnp: PnpConfig,
    /// Candidate poses of an instance: who proposes them, and when that ends.
    pub search: SearchConfig,
    /// Poses refined on the images.
    pub refine: RefineConfig,
    /// Views compared with each other, to judge the rig.
    pub rig: RigConfig,
}

/// How large images are shown to the detector: an object may shrink below what it finds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TilingConfig {
    /// Scale of the detector's images, if `max_input` allows it; smaller ones are scaled to the
    /// bundle's input.
    pub full_scale: f64,
    /// Most pixels of the detector's image, as a multiple of the bundle's input.
    pub max_input: f64,
    /// Images at a smaller scale are also tiled. Not measured.
    pub min_scale: f64,
    /// Magnification of a tile where another view expects an object. Not measured.
    pub guided_zoom: f64,
    /// Magnification of tiles when no view has found anything. Not measured.
    pub full_zoom: f64,
}

/// Boxes of different views matched to one object by their rays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct AssociationConfig {
    /// Tolerance of a box in center and size, as a share of its half side: rays may pass at twice
    /// this share of the apparent radius, radii may differ by one plus this share. Not measured.
    pub box_tolerance: f64,
}

/// Generalised PnP on object coordinates: a search from many rotations, then Gauss-Newton.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PnpConfig {
    /// Initial rotations of the search; 64 are about 50 degrees apart.
    pub starts: usize,
    /// Correspondences that the search uses; the final steps use all.
    pub search_correspondences: usize,
    /// Robust scales of the search's alignment steps, in diameters.
    pub align_scales: Vec<f64>,
    /// Robust scales of the Gauss-Newton steps, in diameters; the last one defines inliers.
    pub newton_scales: Vec<f64>,
    /// Temperature of the poses' probabilities: p ~ exp(inlier share / temperature).
    pub temperature: f64,
    /// Least number of correspondences of a pose.
    pub min_correspondences: usize,
    /// Least trust of a correspondence, 0 to 1.
    pub min_trust: f64,
    /// Neighbouring correspondences that count as one in the estimated error; chosen against 150 on
    /// held-out scenes.
    pub correlated: f64,
    /// Standard deviation of the start's position: across a view's ray in diameters, along it as a
    /// share of the distance.
    pub start_sigma: [f64; 2],
    /// Largest ratio of a pose's distance to its start's.
    pub max_distance_ratio: f64,
}

/// Who proposes candidate poses of an instance, and when the search ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SearchConfig {
    /// Proposers after the network's first poses, in order, for unsettled instances.
    pub schedule: Vec<Proposer>,
    /// Confidence of a settled instance.
    pub settled: f64,
    /// Least log-odds of a candidate to be refined; calibration loses one in 200 correct poses by
    /// it.
    pub min_initial_log_odds: Option<f64>,
    /// Least confidence of an instance with further proposals.
    pub hopeless: f64,
    /// Confidence below which other matches of an instance's boxes are tried.
    pub doubtful: f64,
    /// Most instances per proposer and tiling, the most confident first; most other matches.
    pub max_instances: usize,
    /// Poses closer than this, up to symmetry, are one candidate, degrees.
    pub merge_deg: f64,
    /// Most candidates of an instance.
    pub max_candidates: usize,
    /// Most anchor views of the decoder.
    pub max_anchors: usize,
    /// Roll angles of augmented crops, degrees.
    pub rolls_deg: Vec<f64>,
    /// Rotation angle of the perturbed poses, degrees.
    pub perturbation_deg: f64,
    /// Least share of the projection inside the image of a view that should show the object.
    pub min_in_image: f64,
    /// Largest distance of duplicates, as a share of the sum of their radii.
    pub duplicate_distance: f64,
    /// Least IoU of a detected box and the same object's projection.
    pub same_box_iou: f64,
    /// Least IoU of two boxes with the same crop. Not measured.
    pub same_crop_iou: f64,
    /// Least confidence of an instance that is not rejected.
    pub min_confidence: f64,
}

/// Who proposes candidate poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Proposer {
    /// The network on crops where the best pose projects the object, in all views.
    Reprojected,
    /// The network on crops that are rolled about their axes.
    Augmented,
    /// Small turns of the best pose.
    Perturbed,
}

/// Views compared with each other, to judge the rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RigConfig {
    /// Standard deviation of a box's center and log size, as shares of its side. Fitted on pairs of
    /// the ball.
    pub box_sigma: [f64; 2],
    /// Prior of a single view's pose about the joint one: degrees, share of the distance.
    pub view_prior: [f64; 2],
    /// Least contour inlier share of a view's pose; below, its box counts.
    pub min_contour_inliers: f64,
    /// Contour inlier share of a view's pose from which no other start is tried.
    pub enough_contour_inliers: f64,
    /// Factor on the covariance of a single view's pose, as its contour points are correlated.
    pub covariance_factor: f64,
    /// Least standard deviations of a single view's pose by contours: across the ray (diameters),
    /// along it (share of the distance), rotation (radians).
    pub contour_floor: [f64; 3],
    /// The same by its box. Chosen on held-out scenes of `models/ycbv4`.
    pub box_floor: [f64; 3],
    /// Standard deviation of a camera's error in a wrong rig: degrees, metres.
    pub camera_prior: [f64; 2],
    /// Standard deviation of a mesh's scale error.
    pub mesh_scale_sigma: f64,
    /// True rig: share of objects that one camera of a pair misses. Fitted.
    pub unconfirmed_true: f64,
    /// Wrong rig: the same. `make lies` measures 0.94 to 0.97 of gross errors.
    pub unconfirmed_wrong: f64,
    /// Red and blue are exchanged if colors of objects and images correlate below minus this. Not
    /// measured.
    pub exchanged_correlation: f64,
    /// The same without a probable pose: least gain of the detector score by exchanging them back.
    /// Not measured.
    pub exchanged_gain: f64,
    /// Limit of the gain by correcting cameras, standard deviations: 1 % of held-out groups with
    /// true rigs exceed it, and each of the next two.
    pub max_camera_deviation: f64,
    /// Limit of the gain by one scale of baselines or focal lengths, standard deviations.
    pub max_scale_deviation: f64,
    /// Limit of the disagreement of boxes of objects without a mesh, standard deviations.
    pub max_box_deviation: f64,
    /// Limit of the log-likelihood ratio of two cameras not showing the same objects (ten to one).
    pub max_contradiction: f64,
}

impl Default for TilingConfig {
    fn default() -> Self {
        Self {
            full_scale: 0.8,
            max_input: 1.75,
            min_scale: 0.5,
            guided_zoom: 2.0,
            full_zoom: 1.6,
        }
    }
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            box_tolerance: 0.25,
        }
    }
}

impl Default for PnpConfig {
    fn default() -> Self {
        Self {
            starts: 64,
            search_correspondences: 192,
            align_scales: vec![0.3, 0.25, 0.2, 0.15, 0.12, 0.1],
            newton_scales: vec![0.1, 0.08, 0.08, 0.07, 0.06, 0.06, 0.05, 0.05, 0.05, 0.05],
            temperature: 0.1,
            min_correspondences: 12,
            min_trust: 0.05,
            correlated: 50.0,
            start_sigma: [0.1, 0.3],
            max_distance_ratio: 3.0,
        }
    }
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self {
            schedule: vec![
                Proposer::Reprojected,
                Proposer::Augmented,
                Proposer::Perturbed,
            ],
            settled: 0.9,
            min_initial_log_odds: None,
            hopeless: 0.02,
            doubtful: 0.5,
            max_instances: 8,
            merge_deg: 25.0,
            max_candidates: 6,
            max_anchors: 4,
            rolls_deg: vec![20.0, -20.0, 40.0, -40.0],
            perturbation_deg: 10.0,
            min_in_image: 0.6,
            duplicate_distance: 0.5,
            same_box_iou: 0.4,
            same_crop_iou: 0.9,
            min_confidence: 0.02,
        }
    }
}

impl Default for RigConfig {
    fn default() -> Self {
        Self {
            box_sigma: [0.006, 0.022],
            view_prior: [10.0, 0.03],
            min_contour_inliers: 0.5,
            enough_contour_inliers: 0.6,
            covariance_factor: 3.0,
            contour_floor: [0.004, 0.006, 0.02],
            box_floor: [0.1, 0.3, 1.0],
            camera_prior: [3.0, 0.03],
            mesh_scale_sigma: 0.005,
            unconfirmed_true: 0.1,
            unconfirmed_wrong: 0.95,
            exchanged_correlation: 0.3,
            exchanged_gain: 0.15,
            max_camera_deviation: 7.0,
            max_scale_deviation: 4.0,
            max_box_deviation: 4.1,
            max_contradiction: 2.3,
        }
    }
}

impl InferenceConfig {
    /// The configuration with some fields replaced.
    ///
    /// - `overrides`: by dotted path, as in `search.settled`
    ///
    /// # Errors
    /// [`Error::Input`] for a path that names no field, or a value of another kind.
    pub fn with(&self, overrides: &[(String, Value)]) -> Result<Self> {
        let mut config = self.clone();
        for (path, value) in overrides {
            let refused = |what: String| {
                let text = format!(
                    "inference setting `{path}`: {what}; docs/reference/inference.md lists them"
                );
                Error::Input(text)
            };
            let mut tree = serde_json::to_value(&config).map_err(|e| refused(e.to_string()))?;
            let mut at = &mut tree;
            for key in path.split('.') {
                at = at.get_mut(key).ok_or_else(|| {
                    refused(
                        "expected the name of a setting, as in search.settled, got an unknown one"
                            .into(),
                    )
                })?;
            }
            *at = value.clone();
            config = serde_json::from_value(tree).map_err(|e| refused(e.to_string()))?;
        }
        config.check().map_err(Error::Input)?;
        Ok(config)
    }

    /// Refuses numbers that no pipeline can run with; the text is the problem.
    pub(crate) fn check(&self) -> std::result::Result<(), String> {
        self.refine.check()?;
        let (pnp, search) = (&self.pnp, &self.search);
        let positive = |name: &str, x: f64| match x.is_finite() && x > 0.0 {
            true => Ok(()),
            false => Err(format!(
                "inference setting `{name}`: expected a number above 0, got {x}"
            )),
        };
        let share = |name: &str, x: f64| match (0.0..=1.0).contains(&x) {
            true => Ok(()),
            false => Err(format!(
                "inference setting `{name}`: expected 0 to 1, got {x}"
            )),
        };
        let counted = |name: &str, n: usize, most: usize| match (1..=most).contains(&n) {
            true => Ok(()),
            false => Err(format!(
                "inference setting `{name}`: expected 1 to {most}, got {n}"
            )),
        };
        for (name, scales) in [
            ("pnp.align_scales", &pnp.align_scales),
            ("pnp.newton_scales", &pnp.newton_scales),
        ] {
            counted(name, scales.len(), 100)?;
            scales.iter().try_for_each(|x| positive(name, *x))?;
        }
        counted("pnp.starts", pnp.starts, 10_000)?;
        counted(
            "pnp.search_correspondences",
            pnp.search_correspondences,
            1_000_000,
        )?;
        counted(
            "pnp.min_correspondences",
            pnp.min_correspondences,
            1_000_000,
        )?;
        positive("pnp.temperature", pnp.temperature)?;
        positive("pnp.correlated", pnp.correlated)?;
        positive("pnp.max_distance_ratio", pnp.max_distance_ratio)?;
        counted("search.max_candidates", search.max_candidates, 1000)?;
        counted("search.max_anchors", search.max_anchors, 64)?;
        counted("search.schedule", search.schedule.len().max(1), 16)?;
        counted("search.rolls_deg", search.rolls_deg.len().max(1), 64)?;
        positive("search.merge_deg", search.merge_deg)?;
        share("search.settled", search.settled)?;
        share("search.hopeless", search.hopeless)?;
        share("search.doubtful", search.doubtful)?;
        share("search.min_confidence", search.min_confidence)?;
        share("search.min_in_image", search.min_in_image)?;
        share("search.same_box_iou", search.same_box_iou)?;
        share("search.same_crop_iou", search.same_crop_iou)?;
        let shares = [self.rig.unconfirmed_true, self.rig.unconfirmed_wrong];
        if !(0.0 < shares[0] && shares[0] < shares[1] && shares[1] < 1.0) {
            return Err(format!(
                "inference settings `rig.unconfirmed_true` and `rig.unconfirmed_wrong`: expected \
                 shares above 0 and below 1, the second one greater, got {shares:?}"
            ));
        }
        let rig = &self.rig;
        let floors = [rig.contour_floor, rig.box_floor].concat();
        let rig = [&rig.box_sigma[..], &rig.view_prior, &floors].concat();
        rig.iter().try_for_each(|x| positive("rig", *x))
    }
}
