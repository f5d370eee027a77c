//! What of a data set is evaluated, and how.

use std::path::PathBuf;

use crate::bop::Grouping;
use crate::runner::Conditions;
use crate::{Error, Result};

/// BOP's tolerance of VSD for most data sets, mm.
const VSD_DELTA_MM: f64 = 15.0;

/// What of a data set is evaluated, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The split, and how to go through it.
    pub split: Split,
    /// Files of results in BOP's format, where these are scored instead of a network.
    pub predictions: Vec<PathBuf>,
    /// Which object of the data set a class of the model is, or a name in the predictions.
    pub map: Vec<(String, u32)>,
    /// How far a surface may lie behind the measured one and still count as seen, for VSD.
    pub vsd_delta_mm: f64,
    /// Whether to begin anew where the folder holds results.
    pub force: bool,
    /// What the network is shown, and what counts as right.
    pub conditions: Conditions,
}

/// A split of a data set in BOP's layout, and how to go through it.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// Folder of the data set.
    pub dataset: PathBuf,
    /// Folder of the data set that holds the scenes.
    pub split: String,
    /// What is seen together; by default what suits the number of sensors.
    pub grouping: Option<Grouping>,
    /// Camera files whose images are references: CAM of scene_camera_CAM.json; by default the one that
    /// BOP scores, or the first.
    pub sensor: Option<String>,
    /// File of BOP's test targets, a multi-view list, or pairs.json; every image by default.
    pub targets: Option<PathBuf>,
    /// Ids of the objects to evaluate; those that the model knows by default.
    pub objects: Option<Vec<u32>>,
}

impl Options {
    /// The split `test` of a data set, and everything else by default.
    pub fn new(dataset: PathBuf) -> Self {
        Self {
            split: Split {
                dataset,
                split: "test".into(),
                grouping: None,
                sensor: None,
                targets: None,
                objects: None,
            },
            predictions: Vec::new(),
            map: Vec::new(),
            vsd_delta_mm: VSD_DELTA_MM,
            force: false,
            conditions: Conditions::default(),
        }
    }

    /// Whether its numbers are in range.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn check(&self) -> Result<()> {
        match self.vsd_delta_mm.is_finite() && self.vsd_delta_mm >= 0.0 {
            true => Ok(()),
            false => Err(Error::Input(format!(
                "vsd_delta_mm: expected a number of 0 or more, got {}",
                self.vsd_delta_mm
            ))),
        }
    }
}
