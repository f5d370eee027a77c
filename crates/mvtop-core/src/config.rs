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
#[serde(default, deny_unknown_fields)]
pub struct TilingConfig {
    /// Scale at which images are shown, if `max_input` allows it; smaller ones are scaled to the
    /// bundle's input. Objects are then as large as in training.
    pub full_scale: f64,
    /// Pixels of an image that the detector is shown, at most, as a multiple of the bundle's input.
    pub max_input: f64,
    /// Images shown at a smaller scale than this are also shown in tiles. Not measured.
    pub min_scale: f64,
    /// Magnification of a tile where another view expects an object. Not measured.
    pub guided_zoom: f64,
    /// Magnification of the tiles that cover an image when no view has found anything. Not measured.
    pub full_zoom: f64,
}

/// Boxes of different views matched to one object by their rays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssociationConfig {
    /// Tolerance of a box in center and size, as a share of its half side: two rays may pass each other
    /// at twice this share of the apparent radius, and radii may differ by the factor of one plus this
    /// share. Not measured.
    pub box_tolerance: f64,
}

/// Generalised PnP on object coordinates: a search from many rotations, then Gauss-Newton.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PnpConfig {
    /// Initial rotations of the search; 64 are about 50 degrees apart.
    pub starts: usize,
    /// Correspondences that the search uses; the final steps use all.
    pub search_correspondences: usize,
    /// Robust scales of the search's alignment steps, in diameters.
    pub align_scales: Vec<f64>,
    /// Robust scales of the Gauss-Newton steps, in diameters; the last one defines an inlier.
    pub newton_scales: Vec<f64>,
    /// Temperature of the poses' probabilities: p ~ exp(inlier share / temperature).
    pub temperature: f64,
    /// Least number of correspondences of a pose.
    pub min_correspondences: usize,
    /// Least trust of a correspondence, 0 to 1.
    pub min_trust: f64,
    /// Neighbouring correspondences that count as one when the error is estimated. 50 was chosen
    /// against 150 on held-out scenes.
    pub correlated: f64,
    /// Standard deviation of the start's position across and along a view's ray: in diameters, and as
    /// a share of the distance.
    pub start_sigma: [f64; 2],
    /// Ratio of a pose's distance to that of its start, at most.
    pub max_distance_ratio: f64,
}

/// Who proposes candidate poses of an instance, and when the search ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchConfig {
    /// Proposers after the network's first poses, in this order; each works on instances that are not
    /// settled.
    pub schedule: Vec<Proposer>,
    /// An instance is settled when its confidence is this high.
    pub settled: f64,
    /// Candidates with lower log-odds before refinement are not refined. Calibration loses one in 200
    /// correct poses by it. Without a value all are refined.
    pub min_initial_log_odds: Option<f64>,
    /// Unsettled instances of lower confidence get no further proposals.
    pub hopeless: f64,
    /// Largest number of instances that a proposer or the tiling works on, the most confident first:
    /// bounds the time.
    pub max_instances: usize,
    /// Poses that differ by less, up to symmetry, are one candidate, degrees.
    pub merge_deg: f64,
    /// Largest number of candidates of an instance.
    pub max_candidates: usize,
    /// Largest number of anchor views of the decoder.
    pub max_anchors: usize,
    /// Roll angles of the augmented crops, degrees: the range of most training crops.
    pub rolls_deg: Vec<f64>,
    /// Rotation angle of the perturbed poses, degrees.
    pub perturbation_deg: f64,
    /// A view should show an object if at least this share of its projection is inside the image.
    pub min_in_image: f64,
    /// Two instances are duplicates when their distance is below this share of the sum of their radii.
    pub duplicate_distance: f64,
    /// Least overlap (IoU) of a detected box and a projected object that are the same.
    pub same_box_iou: f64,
    /// Least overlap (IoU) of two boxes with the same crop. Not measured.
    pub same_crop_iou: f64,
    /// Instances of lower confidence are rejected.
    pub min_confidence: f64,
}

/// Who proposes candidate poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
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
#[serde(default, deny_unknown_fields)]
pub struct RigConfig {
    /// Standard deviation of a detected box: center and log size, as shares of its side. Fitted on pairs
    /// of the ball.
    pub box_sigma: [f64; 2],
    /// Prior of a single view's own pose about the joint one: degrees, and a share of the distance.
    pub view_prior: [f64; 2],
    /// Contour inlier share from which a view's own pose counts instead of its box.
    pub min_contour_inliers: f64,
    /// Factor on the covariance of a single view's pose: its contour points err together.
    pub covariance_factor: f64,
    /// Least standard deviations of a single view's pose by contours: across its ray (diameters),
    /// along it (share of the distance), rotation (radians).
    pub contour_floor: [f64; 3],
    /// The same three of a single view's pose by its box. Chosen on held-out scenes of `models/ycbv4`.
    pub box_floor: [f64; 3],
    /// Standard deviation of a camera's error in a wrong rig: degrees and metres.
    pub camera_prior: [f64; 2],
    /// Standard deviation of a mesh's scale against the real object, as a share.
    pub mesh_scale_sigma: f64,
    /// True rig: share of objects that one camera of a pair shows and the other should show, but does
    /// not. Fitted.
    pub unconfirmed_true: f64,
    /// The same share for a wrong rig. Not measured.
    pub unconfirmed_wrong: f64,
    /// Red and blue count as exchanged if the colors of objects and images correlate below minus this.
    /// Not measured.
    pub exchanged_correlation: f64,
    /// Without a probable pose: least gain of the best detector score when red and blue are exchanged
    /// back. Not measured.
    pub exchanged_gain: f64,
    /// Limit of the gain by corrections of the cameras, standard deviations. One in a hundred held-out
    /// groups with a true rig exceeds this limit, and each of the next two.
    pub max_camera_deviation: f64,
    /// Limit of the gain by a scale of the rig or of its focal lengths, standard deviations.
    pub max_scale_deviation: f64,
    /// Limit of the disagreement of an object's boxes, standard deviations (objects without a mesh).
    pub max_box_deviation: f64,
    /// Limit of the log-likelihood ratio by which two cameras do not show the same objects: ten to one.
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
            covariance_factor: 3.0,
            contour_floor: [0.004, 0.006, 0.02],
            box_floor: [0.1, 0.3, 1.0],
            camera_prior: [3.0, 0.03],
            mesh_scale_sigma: 0.005,
            unconfirmed_true: 0.1,
            unconfirmed_wrong: 0.7,
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
