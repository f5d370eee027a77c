//! Which images are used together.

use std::fmt;
use std::str::FromStr;

use super::scene::{FrameId, Scene};
use super::targets::Target;
use crate::{Error, Result};

/// What a set of views consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// Frames of one scene, taken by one camera that moves: YCB-V, T-LESS, MV-ball.
    Scene,
    /// Cameras that took an image at one time, each with its own files: IPD, XYZ-IBD, ITODD-MV.
    Frame,
}

impl FromStr for Grouping {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "scene" => Ok(Self::Scene),
            "frame" => Ok(Self::Frame),
            _ => Err("expected `scene` (frames of a scene) or `frame` (cameras of a frame)".into()),
        }
    }
}

impl fmt::Display for Grouping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scene => "scene",
            Self::Frame => "frame",
        })
    }
}

impl Grouping {
    /// What suits a scene: frames of one with a single camera, else the cameras of a frame.
    pub fn of(scene: &Scene) -> Self {
        let mut sensors = scene.frames.keys().map(|id| &id.sensor);
        let first = sensors.next();
        match sensors.all(|sensor| Some(sensor) == first) {
            true => Self::Scene,
            false => Self::Frame,
        }
    }
}

/// Views to predict from together, and the objects asked for.
pub type Group = Target;

/// The groups of one scene.
///
/// - `views`: images per group at most, the reference included; all there are without it
/// - `sensor`: of the reference image, also of listed views if it is among them; by default the
///   first in the list, or the first there is
/// - `targets`: of this scene; every image is a reference without them
///
/// With [`Grouping::Scene`] the others are spread evenly over the frames of the same sensor that
/// follow the reference, from the first again after the last. With [`Grouping::Frame`] they are the
/// other sensors' images of the same number, in the order of the sensors' names.
///
/// # Errors
/// [`Error::Input`] where the scene lacks an image that a target names.
pub fn groups(
    scene: &Scene,
    grouping: Grouping,
    views: Option<usize>,
    sensor: Option<&str>,
    targets: Option<Vec<Target>>,
) -> Result<Vec<Group>> {
    let asked = sensor;
    let first = scene.frames.keys().next().map_or("", |id| &id.sensor);
    let sensor = sensor.unwrap_or(first);
    let alone = |id: &FrameId| Group {
        scene: scene.id,
        views: vec![id.clone()],
        listed: false,
        objects: None,
    };
    let of_sensor = scene.frames.keys().filter(|id| id.sensor == sensor);
    let mut groups = targets.unwrap_or_else(|| of_sensor.map(alone).collect());
    if groups.is_empty() {
        return Err(Error::Input(format!(
            "{}: expected images of sensor `{sensor}`, got none",
            scene.folder.display()
        )));
    }
    for group in &mut groups {
        for id in &mut group.views {
            // Targets of one sensor's data sets do not name it, whatever its files end in.
            if id.sensor.is_empty() && !scene.frames.contains_key(id) {
                id.sensor = sensor.to_owned();
            }
            if !scene.frames.contains_key(id) {
                return Err(Error::Input(format!(
                    "{}: expected image {id}, which is a target, got none; unpack the data set's \
                     images there or give other targets",
                    scene.folder.display()
                )));
            }
        }
        let of_asked = |id: &FrameId| asked.is_some_and(|asked| id.sensor == asked);
        if let Some(reference) = group.views.iter().position(of_asked) {
            group.views[..=reference].rotate_right(1);
        }
        if let (false, [reference]) = (group.listed, &group.views[..]) {
            let others = candidates(scene, grouping, reference);
            group.views.extend(spread(&others, grouping, views));
        }
        group.views.truncate(views.unwrap_or(usize::MAX));
    }
    Ok(groups)
}

/// What can go with a reference, in order.
fn candidates(scene: &Scene, grouping: Grouping, reference: &FrameId) -> Vec<FrameId> {
    let alike = |id: &&FrameId| {
        *id != reference
            && match grouping {
                Grouping::Scene => id.sensor == reference.sensor,
                Grouping::Frame => id.image == reference.image,
            }
    };
    let mut others: Vec<FrameId> = scene.frames.keys().filter(alike).cloned().collect();
    if grouping == Grouping::Scene {
        let after = others.partition_point(|id| id.image < reference.image);
        others.rotate_left(after);
    }
    others
}

fn spread(others: &[FrameId], grouping: Grouping, views: Option<usize>) -> Vec<FrameId> {
    let count = views.map_or(others.len(), |views| (views - 1).min(others.len()));
    let place = |k: usize| match grouping {
        // The reference has place 0 among one more than there are others.
        Grouping::Scene => (k + 1) * (others.len() + 1) / (count + 1) - 1,
        Grouping::Frame => k,
    };
    (0..count).map(|k| others[place(k)].clone()).collect()
}
