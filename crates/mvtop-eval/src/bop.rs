//! Data sets in BOP's layout: scenes, models, targets, and how views are put together.
//!
//! All lengths are metres here and millimetres in the files. `docs/bop.md` says what is read.
//!
//! Source: <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>.

mod annotation;
mod depth;
mod group;
mod json;
mod models;
mod ply;
mod scene;
mod targets;

pub(crate) use annotation::load_annotations;
pub use depth::load_depth;
pub use group::{Group, Grouping, groups};
pub(crate) use json::read as read_json;
pub use models::{Model, load_models};
pub use ply::load_ply;
pub use scene::{Instance, Scene, View, ViewId, scene_ids};
pub use targets::{Target, load_targets};
