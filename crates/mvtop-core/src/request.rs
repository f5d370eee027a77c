//! What a caller asks of the images: which objects, where, how sure, and in which frame.
//!
//! A robot's program does not want all that is seen. It says which parts it needs and where they may
//! lie, and wants their poses in a frame that it knows. One type says so, for the command line, the
//! service and its line protocol alike.
//!
//! Classes, priors and planes go to the estimator, which looks for nothing else. The rest is chosen from
//! what was found: it saves no time, and changes no pose.

mod choice;
mod frame;
mod grasps;
mod plane;
mod prior;
mod text;

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

pub use self::choice::{LeftOut, WorldBox};
pub use self::grasps::{FILE as GRASPS_FILE, Grasp, Grasps, Sphere};
pub use self::plane::Plane;
pub use self::prior::Prior;
pub use self::text::SETTINGS;

use crate::annotations::GivenBoxes;
use crate::bundle::Bundle;
use crate::estimator::Tracks;
use crate::image::ViewImage;
use crate::prediction::Prediction;
use crate::report::{self, Report};
use crate::scorer::Verdict;
use crate::transform::from_matrix;
use crate::{Error, Estimator, PredictOptions, Result, Rig};

/// Most points of a polygon, to bound the work.
const MOST_POINTS: usize = 1000;

/// Most priors, and most planes: each prior may be looked for by itself.
const MOST_PRIORS: usize = 100;
/// Largest distance of the base or a prior from the nearest camera, metres.
const FARTHEST_M: f64 = 100.0;

/// What is asked of a set of images; asks for everything by default.
///
/// As JSON all keys may be left out, and others are refused.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Request {
    /// Id of the camera in whose frame `T_ref_obj` is; the rig's by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// Boxes to use instead of detecting.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boxes: Option<Vec<GivenBoxes>>,
    /// Fewest images in which an object must be detected; 0 and 1 keep all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_views: Option<usize>,
    /// Whether poses are refined on the images; by default those of classes with a mesh are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// Only objects of these classes, by name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub classes: Option<Vec<String>>,
    /// At most as many objects, the most probable ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub most: Option<usize>,
    /// Only objects whose middle is in this box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub region: Option<WorldBox>,
    /// Only objects whose middle is in the polygon of each of these cameras, by id: corners `[u, v]`, px.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub polygons: BTreeMap<String, Vec<[f64; 2]>>,
    /// Rough poses: objects of their classes are looked for there, and given only near one of them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub priors: Vec<Prior>,
    /// Planes: objects of their classes are given only where they stand upright on one of them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub planes: Vec<Plane>,
    /// Frame in which poses are given as well: `world`, `base` or a camera's id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// World frame to the robot's base frame: rows of the homogeneous matrix, metres.
    #[serde(rename = "T_base_world", skip_serializing_if = "Option::is_none")]
    pub base_from_world: Option<[[f64; 4]; 4]>,
    /// Least confidence of a pose that is accepted, 0 to 1; each pose then has a verdict.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_confidence: Option<f64>,
    /// Whether the bundle's grasps are given with each object.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub grasps: bool,
    /// Whether what came nearest is reported of each class without an object; of [`Request::classes`] it
    /// always is.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub why: bool,
}

/// What was found of what was asked for.
#[derive(Debug, Clone)]
pub struct Answer {
    /// With the objects that were asked for alone.
    pub prediction: Prediction,
    /// The same as a document.
    pub report: Report,
    /// Objects that were found but not asked for.
    pub left_out: LeftOut,
}

impl Answer {
    /// Whether there are objects, and the verdict on each is `accept`; without
    /// [`Request::min_confidence`] there is no verdict, and this is `true`.
    pub fn is_accepted(&self, request: &Request) -> bool {
        request.min_confidence.is_none_or(|least| {
            let objects = &self.prediction.objects;
            let accept = |object| Verdict::of(object, least) == Verdict::Accept;
            !objects.is_empty() && objects.iter().all(accept)
        })
    }
}

impl Request {
    /// Reads a request from JSON.
    ///
    /// # Errors
    /// [`Error::Input`] where it is no request: one sentence.
    ///
    /// ```
    /// use mvtop_core::request::Request;
    ///
    /// let request = Request::from_json(r#"{"classes": ["nut"], "most": 1, "frame": "world"}"#)?;
    /// assert_eq!(request.most, Some(1));
    /// assert!(Request::from_json(r#"{"class": "nut"}"#).is_err());
    /// # Ok::<(), mvtop_core::Error>(())
    /// ```
    pub fn from_json(text: &str) -> Result<Self> {
        let refuse = |got: String| {
            refuse(&format!(
                "request: expected JSON with keys as in docs/how-to/serve.md, got: {got}"
            ))
        };
        // A list would be taken for values without their keys.
        if text.trim_start().starts_with('[') {
            return Err(refuse("a list".into()));
        }
        crate::json::from_str(text).map_err(|cause| refuse(cause.to_string()))
    }

    /// The part that the estimator needs.
    pub fn options(&self) -> PredictOptions {
        PredictOptions {
            reference: self.reference.clone(),
            boxes: self.boxes.clone(),
            min_views: self.min_views.unwrap_or(1),
            refine: self.refine,
            classes: self.classes.clone(),
            priors: self.priors.clone(),
            planes: self.planes.clone(),
            why: self.says_why(),
        }
    }

    /// Whether near misses are reported.
    pub fn says_why(&self) -> bool {
        self.why || self.classes.is_some()
    }

    /// Refuses what does not fit the model or the rig, before any work is done.
    ///
    /// - `has_grasps`: whether there are grasps for the model
    ///
    /// # Errors
    /// [`Error::Geometry`], [`Error::UnknownClass`], and [`Error::Input`] for numbers that cannot
    /// be meant, or for what the model does not have.
    pub fn check(&self, bundle: &Bundle, rig: &Rig, has_grasps: bool) -> Result<()> {
        if let Some(id) = &self.reference {
            rig.find("reference", id)?;
        }
        let named = self
            .classes
            .iter()
            .flatten()
            .map(|class| ("classes", class.as_str()));
        let priors = self.priors.iter().map(|prior| ("priors", prior.class()));
        let planes = self
            .planes
            .iter()
            .filter_map(|plane| Some(("planes", plane.class()?)));
        for (role, class) in named.chain(priors).chain(planes) {
            if bundle.class_index(class).is_none() {
                return Err(Error::UnknownClass {
                    role: role.into(),
                    class: class.to_owned(),
                    known: bundle.classes.iter().map(|one| one.name.clone()).collect(),
                });
            }
        }
        for (role, count) in [("priors", self.priors.len()), ("planes", self.planes.len())] {
            if count > MOST_PRIORS {
                return Err(refuse(&format!(
                    "{role}: expected {MOST_PRIORS} at most, got {count}; ask for fewer objects at once"
                )));
            }
        }
        if self.classes.as_ref().is_some_and(Vec::is_empty) {
            return Err(refuse("classes: expected one name or more, got none"));
        }
        if self.most == Some(0) {
            return Err(refuse("most: expected 1 or more objects, got 0"));
        }
        if let Some(region) = &self.region {
            region.check()?;
        }
        for (id, polygon) in &self.polygons {
            rig.find("polygons", id)?;
            let finite = polygon.as_flattened().iter().all(|x| x.is_finite());
            if !(3..=MOST_POINTS).contains(&polygon.len()) || !finite {
                return Err(refuse(&format!(
                    "polygons, camera `{id}`: expected 3 to {MOST_POINTS} corners [u, v] in pixels, got {}",
                    polygon.len()
                )));
            }
        }
        self.frame_from_world(rig)?;
        self.check_unit(rig)?;
        match self.min_confidence {
            Some(least) if !(0.0..=1.0).contains(&least) => {
                return Err(refuse(&format!(
                    "min_confidence: expected a probability from 0 to 1, got {least}"
                )));
            }
            Some(_) if bundle.scorer.is_none() => {
                return Err(refuse(&format!(
                    "min_confidence: expected a model bundle that says how sure it is, got {} without; \
                     add it with `mvtop-train calibrate`",
                    bundle.dir.display()
                )));
            }
            _ => {}
        }
        if self.grasps && !has_grasps {
            return Err(refuse(&format!(
                "grasps: expected a model bundle with {GRASPS_FILE}, got {} without; write one as in \
                 docs/how-to/serve.md",
                bundle.dir.display()
            )));
        }
        Ok(())
    }

    /// Finds what is asked for.
    ///
    /// - `grasps`: of the bundle, where it has any
    ///
    /// # Errors
    /// Those of [`Request::check`] and [`Estimator::predict`].
    pub fn answer(
        &self,
        estimator: &Estimator,
        grasps: Option<&Grasps>,
        rig: &Rig,
        images: &[ViewImage],
    ) -> Result<Answer> {
        self.answer_tracked(estimator, grasps, rig, images, None)
    }

    /// As [`Request::answer`]; objects have the numbers by which `tracks` knows them over time.
    ///
    /// Objects that are left out have numbers too, and keep them.
    ///
    /// # Errors
    /// Those of [`Request::answer`]; nothing is then followed.
    pub fn answer_tracked(
        &self,
        estimator: &Estimator,
        grasps: Option<&Grasps>,
        rig: &Rig,
        images: &[ViewImage],
        tracks: Option<&mut Tracks>,
    ) -> Result<Answer> {
        let found = self.find_all(estimator, grasps, rig, images, tracks)?;
        self.choose(found, estimator.bundle(), grasps, rig)
    }

    /// All objects that [`Request::choose`] chooses from, to choose from them again later.
    ///
    /// # Errors
    /// Those of [`Request::answer`].
    pub fn find_all(
        &self,
        estimator: &Estimator,
        grasps: Option<&Grasps>,
        rig: &Rig,
        images: &[ViewImage],
        tracks: Option<&mut Tracks>,
    ) -> Result<Prediction> {
        let bundle = estimator.bundle();
        self.check(bundle, rig, grasps.is_some())?;
        let mut found = estimator.predict(rig, images, &self.options())?;
        if let Some(tracks) = tracks {
            tracks.follow(&mut found, bundle);
        }
        Ok(found)
    }

    /// Chooses from what was found; [`Request::options`] do not count.
    ///
    /// # Errors
    /// [`Error::Geometry`] and [`Error::Input`] where the frame is none.
    pub fn choose(
        &self,
        found: Prediction,
        bundle: &Bundle,
        grasps: Option<&Grasps>,
        rig: &Rig,
    ) -> Result<Answer> {
        let all = match self.grasps {
            true => found.objects.clone(),
            false => Vec::new(),
        };
        let (prediction, given, left_out) = choice::choose(self, found, bundle, rig);
        let mut report = Report::new(&prediction, rig);
        if let Some(least) = self.min_confidence {
            for (reported, object) in report.objects.iter_mut().zip(&prediction.objects) {
                reported.verdict = Some(Verdict::of(object, least));
            }
        }
        let misses = report::near_misses(&prediction, rig);
        report.why = (self.why || (self.classes.is_some() && !misses.is_empty())).then_some(misses);
        report.left_out = self.chooses().then_some(left_out);
        let frame = match (&self.frame, self.grasps) {
            (Some(frame), _) => Some(frame.as_str()),
            (None, true) => Some(frame::WORLD),
            (None, false) => None,
        };
        if let Some(frame) = frame {
            let frame_from_world = self.frame_from_world(rig)?;
            report.frame = Some(frame.to_owned());
            for (reported, object) in report.objects.iter_mut().zip(&prediction.objects) {
                let pose = frame_from_world * object.world_from_obj;
                reported.t_frame_obj = Some(report::rows(&pose));
            }
            if let (true, Some(grasps)) = (self.grasps, grasps) {
                let of_given = grasps.of_all(&all, &given, bundle, &frame_from_world)?;
                for (reported, grasps) in report.objects.iter_mut().zip(of_given) {
                    reported.grasps = Some(grasps);
                }
            }
        }
        Ok(Answer {
            prediction,
            report,
            left_out,
        })
    }

    /// Refuses a base and priors so far from all cameras that their unit is probably another one than the metre.
    fn check_unit(&self, rig: &Rig) -> Result<()> {
        let cameras = || {
            let places = rig.cameras().iter();
            places.map(|camera| Point3::from(camera.world_from_cam().translation.vector))
        };
        let check = |role: &str, distances: &mut dyn Iterator<Item = f64>| {
            let nearest = distances.fold(f64::INFINITY, f64::min);
            match nearest > FARTHEST_M {
                false => Ok(()),
                true => Err(refuse(&format!(
                    "{role}: expected a camera within {FARTHEST_M} m of it, got {nearest:.0} m; give translations in metres"
                ))),
            }
        };
        if let Some(Ok(base_from_world)) = self.base_from_world.as_ref().map(from_matrix) {
            let mut distances = cameras().map(|at| (base_from_world * at).coords.norm());
            check("T_base_world", &mut distances)?;
        }
        for prior in &self.priors {
            let place = prior.world_from_obj().translation.vector;
            let mut distances = cameras().map(|at| (at.coords - place).norm());
            check(&format!("prior of `{}`", prior.class()), &mut distances)?;
        }
        Ok(())
    }

    /// World frame to the frame that is asked for; the world's by default.
    ///
    /// # Errors
    /// [`Error::Geometry`] for another name, and [`Error::Input`] where the base's transform is
    /// missing or none.
    pub fn frame_from_world(&self, rig: &Rig) -> Result<Isometry3<f64>> {
        let base = self.base_from_world.as_ref().map(from_matrix).transpose();
        let base = base.map_err(|problem| refuse(&format!("T_base_world: {problem}")))?;
        frame::from_world(self.frame.as_deref(), base, rig)
    }

    /// Whether anything that is found may be left out.
    fn chooses(&self) -> bool {
        let by_place = self.region.is_some() || !self.polygons.is_empty();
        by_place || self.classes.is_some() || self.most.is_some()
    }
}

fn refuse(sentence: &str) -> Error {
    Error::Input(sentence.to_owned())
}

#[cfg(test)]
pub(crate) mod tests;
