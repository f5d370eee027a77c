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

/// Large images shown to the detector in tiles, as an object may shrink below what it finds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TilingConfig {
    /// Images scaled by less than this to the detector's input are tiled. Not measured.
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
    /// How far a box may be off, in place and in size, as a share of its half side. So the rays of two
    /// boxes pass each other at twice this share of the apparent radius at most, and an apparent
    /// radius is off by one plus this share, as a factor, at most. Not measured.
    pub box_tolerance: f64,
}

/// Generalised PnP on object coordinates: a search from many rotations, then Gauss-Newton.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PnpConfig {
    /// Rotations that the search starts from; 64 are about 50 degrees apart.
    pub starts: usize,
    /// Correspondences that the search uses; the final steps use all.
    pub search_correspondences: usize,
    /// Robust scales of the search's alignment steps, in diameters.
    pub align_scales: Vec<f64>,
    /// Robust scales of the Gauss-Newton steps, in diameters; the last one defines an inlier.
    pub newton_scales: Vec<f64>,
    /// Temperature of their probabilities: p ~ exp(inlier share / temperature).
    pub temperature: f64,
    /// Fewest correspondences of a pose.
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
    /// Candidates whose log-odds before refinement are lower are not refined; fitted so that one in 200
    /// right poses is lost. All are refined where there is none.
    pub min_initial_log_odds: Option<f64>,
    /// Instances that are not settled and whose confidence is lower get no further proposals.
    pub hopeless: f64,
    /// Instances that a proposer works on, at most, the most confident first, and those looked for in
    /// tiles: bounds the time.
    pub max_instances: usize,
    /// Poses that differ by less, but for symmetries, are one candidate, degrees.
    pub merge_deg: f64,
    /// Candidates of an instance, at most.
    pub max_candidates: usize,
    /// Views whose crop is the decoder's anchor in turn, at most.
    pub max_anchors: usize,
    /// Turns of the augmented crops about their axes, degrees: as far as most are in training.
    pub rolls_deg: Vec<f64>,
    /// Turn of the perturbed poses, degrees.
    pub perturbation_deg: f64,
    /// Share of an object's projection inside the image from which a view is expected to show it.
    pub min_in_image: f64,
    /// Two instances are duplicates when their distance is below this share of their radii's sum.
    pub duplicate_distance: f64,
    /// Overlap (IoU) of a detected box with a projected object from which they are the same.
    pub same_box_iou: f64,
    /// Overlap (IoU) of two boxes from which their crops are the same. Not measured.
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
    /// Standard deviation of a detected box: of its center and of the logarithm of its size, as shares
    /// of its side. Fitted on pairs of the ball.
    pub box_sigma: [f64; 2],
    /// Prior of a single view's own pose about the joint one: degrees, and a share of the distance.
    pub view_prior: [f64; 2],
    /// Contour inlier share from which a view's own pose counts instead of its box.
    pub min_contour_inliers: f64,
    /// Factor on the covariance of a single view's pose: its contour points err together.
    pub covariance_factor: f64,
    /// Least standard deviations of a single view's pose by contours: across its ray in diameters,
    /// along it as a share of the distance, and of its rotation in radians.
    pub contour_floor: [f64; 3],
    /// The same of a pose by its box alone, which ends where something hides the object. Chosen on
    /// held-out scenes of `models/ycbv4`, with true rigs.
    pub box_floor: [f64; 3],
    /// How far a camera of a wrong rig may be off, one standard deviation: degrees and metres.
    pub camera_prior: [f64; 2],
    /// Standard deviation of a mesh's scale against the real object, as a share.
    pub mesh_scale_sigma: f64,
    /// Share of objects that one of two cameras of a true rig shows and the other does not, although
    /// it should. Fitted.
    pub unconfirmed_true: f64,
    /// The same share of a wrong rig. Not measured.
    pub unconfirmed_wrong: f64,
    /// Negative correlation of the objects' colors (red against blue) with the images from which red
    /// and blue are taken to be exchanged. Not measured.
    pub exchanged_correlation: f64,
    /// Where no pose is probable: what the detector's best score gains, at least, if they are. Not
    /// measured.
    pub exchanged_gain: f64,
    /// Limits of a true rig, each exceeded by one in a hundred groups of held-out scenes: of what
    /// corrections of the cameras gain,
    pub max_camera_deviation: f64,
    /// of what a scale gains,
    pub max_scale_deviation: f64,
    /// and of an object's boxes against each other, standard deviations (objects without a mesh).
    pub max_box_deviation: f64,
    /// Log-likelihood ratio by which two cameras do not show the same objects from which the rig is
    /// doubted: ten to one.
    pub max_contradiction: f64,
}

impl Default for TilingConfig {
    fn default() -> Self {
        Self {
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
