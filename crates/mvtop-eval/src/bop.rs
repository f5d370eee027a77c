//! Data sets in BOP's layout: scenes, models, targets, results, and how views are put together.
//!
//! All lengths are metres here and millimetres in the files. `docs/how-to/evaluate-on-bop.md` says
//! what is read.
//!
//! Source: <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>.

mod annotation;
mod depth;
mod doubts;
mod group;
mod json;
mod matching;
mod models;
mod obj;
mod results;
mod rules;
mod scene;
mod targets;

pub(crate) use annotation::load_annotations;
pub use depth::load_depth;
pub use doubts::{Doubts, Inexact, Missing};
pub use group::{Group, Grouping, groups};
pub use json::{ROUNDED, rotation as exact_rotation};
pub use matching::{count_right, match_targets};
pub use models::{Model, ModelInfo, load_infos, load_models};
pub use results::{Estimate, RESULTS_HEADER, ResultRow, doubt_of_unit, load_results};
pub use rules::Rules;
pub use scene::{Frame, FrameId, Instance, Scene, load_frames, scene_ids};
pub(crate) use scene::{of_sensor, sensors};
pub use targets::{Target, load_targets};
