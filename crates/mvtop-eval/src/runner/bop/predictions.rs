//! Results in BOP's format, of any program, in the place of a network's answers.

use std::collections::BTreeMap;
use std::path::Path;

use crate::bop::{Group, ResultRow, doubt_of_unit, load_results};
use mvtop_core::Prediction;
use mvtop_core::prediction::{ObjectPose, Timings};

use super::Options;
use super::plan::Plan;
use crate::runner::sample::Sample;
use crate::{Error, Result};

/// What a file says, by scene and image.
pub struct Predictions {
    rows: BTreeMap<(u32, u32), Vec<ResultRow>>,
    /// What makes scores doubtful, a sentence each.
    pub warnings: Vec<String>,
}

impl Predictions {
    pub fn load(path: &Path, options: &Options, plan: &Plan) -> Result<Self> {
        let (all, inexact) = load_results(path, &plan.names(options))?;
        let of = all.len();
        let unit = doubt_of_unit(&all).map(|doubt| format!("{}: {doubt}", path.display()));
        let mut rows: BTreeMap<(u32, u32), Vec<ResultRow>> = BTreeMap::new();
        for row in all {
            rows.entry((row.scene_id, row.im_id)).or_default().push(row);
        }
        let mut counted = 0;
        for group in &plan.groups {
            let of_image = rows.get(&(group.scene, group.views[0].image));
            let wanted = |row: &&ResultRow| plan.wanted(group, row.estimate.obj_id);
            counted += of_image.into_iter().flatten().filter(wanted).count();
        }
        if counted == 0 {
            return Err(Error::Input(format!(
                "{}: expected poses of the images and objects that are evaluated, got none in {of} \
                 lines; choose another --split, --targets or --objects, or say which object a name is \
                 with --map NAME=ID",
                path.display()
            )));
        }
        let rest = (counted < of).then(|| {
            format!(
                "{} of {of} poses in {} are of images or objects that are not evaluated",
                of - counted,
                path.display()
            )
        });
        let inexact = inexact.sentence(&path.display().to_string());
        Ok(Self {
            rows,
            warnings: inexact.into_iter().chain(unit).chain(rest).collect(),
        })
    }

    /// What the file says of a group's image, as if a network had, and the seconds it took, where the
    /// file says so.
    ///
    /// - `sample`: of the group
    pub fn of(
        &self,
        plan: &Plan,
        group: &Group,
        sample: &Sample,
    ) -> Result<(Prediction, Option<f64>)> {
        let camera = sample.rig.reference();
        let world_from_ref = sample.rig.reference_camera().world_from_cam();
        let rows = self.rows.get(&(group.scene, group.views[0].image));
        let mut objects = Vec::new();
        for row in rows.into_iter().flatten() {
            let Some(class) = plan.classes.get(&row.estimate.obj_id) else {
                continue;
            };
            let ref_from_obj = row.estimate.cam_from_obj()?;
            // Its expected error is not known, see `Source::expects`.
            objects.push(ObjectPose::new(
                class,
                row.estimate.obj_id.into(),
                row.estimate.score,
                ref_from_obj,
                world_from_ref * ref_from_obj,
            ));
        }
        let time_s = rows.and_then(|rows| rows.first()?.time_s);
        let prediction = Prediction {
            reference: camera,
            objects,
            rig_consistency: None,
            timings: Timings {
                total: 1e3 * time_s.unwrap_or(0.0),
                ..Timings::default()
            },
            model: String::new(),
            provider: String::new(),
            warnings: Vec::new(),
            near_misses: Vec::new(),
        };
        Ok((prediction, time_s))
    }
}
