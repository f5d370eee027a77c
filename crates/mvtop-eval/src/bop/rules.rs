//! What BOP lays down for some of its data sets, which are told by the names of their folders.

/// What BOP lays down for a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// In whose images poses are scored, as `photoneo`; `None` where BOP names no sensor.
    pub sensor: Option<&'static str>,
    /// Most estimates of an image that count for average precision, the surest first.
    pub most_estimates: usize,
}

impl Rules {
    /// - `dataset`: name of the data set's folder
    ///
    /// Source: `dataset_params.py` and `eval_bop24_pose.py` of bop_toolkit.
    pub fn of(dataset: &str) -> Self {
        let sensor = match dataset {
            "ipd" => Some("photoneo"),
            "itoddmv" => Some("3dlong"),
            "xyzibd" => Some("xyz"),
            _ => None,
        };
        Self {
            sensor,
            most_estimates: if dataset == "xyzibd" { 200 } else { 100 },
        }
    }
}
