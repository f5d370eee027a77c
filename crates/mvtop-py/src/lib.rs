//! The compiled part of the Python package `mvtop`; what users see is in `python/mvtop`.

mod bop;
mod calibration;
mod camera;
mod cli;
mod convert;
mod error;
mod estimator;
mod metrics;
mod prediction;
mod process;
mod rays;
mod request;
mod rig;
mod rotations;
mod sampling;
mod statistics;
mod tracks;

use pyo3::prelude::*;

#[pymodule]
mod _mvtop {
    #[pymodule_init]
    fn init() {
        super::process::note_first();
    }

    #[pymodule_export]
    #[expect(non_upper_case_globals)] // as Python spells it
    const __version__: &str = env!("CARGO_PKG_VERSION");
    #[pymodule_export]
    const BOP_RESULTS_HEADER: &str = mvtop_eval::bop::RESULTS_HEADER;
    #[pymodule_export]
    use super::bop::{
        Image, Instance, ModelInfo, bop_results_line, read_models_info, read_scene, score_results,
    };
    #[pymodule_export]
    use super::calibration::{RefinedRig, RigCheck, RigCorrection};
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::cli::run_cli;
    #[pymodule_export]
    const PIPELINE_VERSION: u32 = mvtop_core::config::PIPELINE_VERSION;
    #[pymodule_export]
    use super::estimator::{NativeEstimator, NativeTracker, default_inference};
    #[pymodule_export]
    use super::metrics::{
        Mesh, Surface, Symmetries, auc_exact, auc_poet, auc_posecnn, average_recall, recall,
        rotation_error_deg, translation_error, vsd,
    };
    #[pymodule_export]
    use super::prediction::NativePrediction;
    #[pymodule_export]
    const REPORT_SCHEMA_VERSION: u32 = mvtop_core::report::SCHEMA_VERSION;
    #[pymodule_export]
    use super::process::set_num_threads;
    #[pymodule_export]
    use super::rays::{box_rays, camera_rays, encode_rays};
    #[pymodule_export]
    use super::request::check_request;
    #[pymodule_export]
    use super::rig::Rig;
    #[pymodule_export]
    use super::rotations::rotation_from_6d;
    #[pymodule_export]
    use super::sampling::{
        deformable_sampling, deformable_sampling_backward, deformable_sampling_forward,
    };
    #[pymodule_export]
    use super::statistics::{auroc, calibration, correlation, roc_curve};
    #[pymodule_export]
    use super::tracks::Tracks;
}
