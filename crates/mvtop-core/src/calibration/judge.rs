//! What is said of a rig by what its images show, and where its cameras are moved to.

use nalgebra::{Isometry3, Vector6};

use super::adjust::{Adjusted, Sighting, adjusted};
use super::{Expected, Observed, cams_from_world};
use crate::{Error, Result, Rig};

/// A camera is off where it is so by more than this many standard deviations, turn and shift together:
/// six numbers exceed it by chance as rarely as one number exceeds 3.
const OFF: f64 = 4.5;
/// A camera is told where its standard deviation is below this share of what was expected, in the
/// direction that is told least.
const TOLD: f64 = 0.8;
/// How far edges may be off where cameras stand wrong, px.
const FROM_PX: f64 = 100.0;
/// How many times as far a camera that is off may be moved than is expected of one.
const WIDER: f64 = 5.0;
/// Of a camera that stays.
const FIXED: Expected = Expected {
    turn_deg: 1e-6,
    shift_m: 1e-8,
};

/// How a camera is to be moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Index of the camera.
    pub camera: usize,
    /// From where it stands to where the images show it, in its own axes, metres.
    pub cam_from_shown: Isometry3<f64>,
    /// Standard deviations of that, in the direction that is known least.
    pub sigma: Expected,
    /// How many standard deviations it is, turn and shift together.
    pub deviation: f64,
    /// On how many objects the camera agrees with others once it is moved.
    pub objects: usize,
    /// Share of what was expected beforehand that is left of the standard deviation, in the direction
    /// that is known least.
    pub left: f64,
}

/// How well two cameras agree on what both show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairResidual {
    /// Indices of the cameras.
    pub cameras: [usize; 2],
    /// Objects that both show, over all sets.
    pub objects: usize,
    /// How far edges are from where each image shows them, at the pose of each object on which both
    /// agree best: mean, px of close-ups.
    pub px: f64,
}

/// Which cameras do not stand as the others do.
#[derive(Debug, Clone, PartialEq)]
pub struct Off {
    /// The fewest that explain the images, each compared with a camera that is not among them.
    pub cameras: Vec<Correction>,
    /// Whether no other cameras would explain them: of two cameras, either may be the wrong one.
    pub is_told: bool,
}

/// A rig some of whose cameras were moved.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The others stand where they stood.
    pub rig: Rig,
    /// How the cameras were moved, with the others standing still.
    pub moved: Vec<Correction>,
    /// Of each set of images, how far edges are off by the rig as given, and by the same cameras as all
    /// other sets show them: mean, px of close-ups. Empty of one set.
    pub held_out: Vec<[f64; 2]>,
}

impl Correction {
    /// Whether the camera does not stand where the rig says. One object alone does not tell: it may be
    /// taken for another, or for itself the other way round.
    pub fn is_off(&self) -> bool {
        self.would_be_off() && self.objects > 1
    }

    /// Whether it is off if what was found is what it seems, be it one object alone.
    pub fn would_be_off(&self) -> bool {
        self.deviation > OFF
    }

    /// Whether the images tell where it stands.
    pub fn is_told(&self) -> bool {
        self.left < TOLD
    }
}

impl Refined {
    /// Means over the sets that were held out; `None` of one set.
    pub fn held_out_px(&self) -> Option<[f64; 2]> {
        let mean = |i: usize| {
            let all = self.held_out.iter().map(|set| set[i]);
            all.sum::<f64>() / self.held_out.len() as f64
        };
        (!self.held_out.is_empty()).then(|| [mean(0), mean(1)])
    }

    /// The rig, where the images tell it.
    ///
    /// # Errors
    /// [`Error::Input`] where no camera was moved, where too little is told of where one stands, and
    /// where sets that were held out fit no better.
    pub fn accepted(&self) -> Result<&Rig> {
        if self.moved.is_empty() {
            return Err(Error::Input(
                "the images do not contradict the rig, and cameras that are not off are left alone"
                    .into(),
            ));
        }
        if let Some(camera) = self.moved.iter().find(|camera| !camera.is_told()) {
            return Err(Error::Input(format!(
                "the images tell that `{}` is off, but too little of where it stands; give more sets of \
                 images, with more objects in more places",
                self.rig.cameras()[camera.camera].id()
            )));
        }
        match self.held_out_px() {
            Some([before, after]) if after >= before => Err(Error::Input(
                "sets that were held out fit no better; are the images of this rig, and did its cameras \
                 stand still?"
                    .into(),
            )),
            _ => Ok(&self.rig),
        }
    }
}

impl Observed {
    /// How many objects were seen by two cameras or more, over all sets.
    pub fn objects(&self) -> usize {
        self.set_of.len()
    }

    /// How many of these two views or more agree on.
    pub fn agreeing(&self) -> usize {
        let agreed = agreed(&self.adjusted, &self.sightings);
        agreed.iter().filter(|cameras| cameras.len() > 1).count()
    }

    /// In how many sets of images these are.
    pub fn sets(&self) -> usize {
        let mut sets = self.set_of.clone();
        sets.dedup();
        sets.len()
    }

    /// What edges of one object in one view are found to err by together, px of close-ups in each
    /// direction of a pose.
    pub fn noise_px(&self) -> f64 {
        self.adjusted.noise_px
    }

    /// How all cameras but `base` are to be moved, with `base` standing still.
    pub fn corrections(&self, base: usize) -> Vec<Correction> {
        let others = (0..self.given.cameras().len()).filter(|camera| *camera != base);
        others
            .map(|camera| self.correction(&self.adjusted, camera, base))
            .collect()
    }

    /// Which cameras do not stand as the others do; none of a rig that the images do not contradict.
    pub fn off(&self) -> Off {
        let count = self.given.cameras().len();
        let off = |base: usize| {
            let all = self.corrections(base).into_iter();
            all.filter(Correction::is_off).collect::<Vec<_>>()
        };
        let reference = self.given.reference();
        // The reference camera is not above suspicion, but of several explanations it is right.
        let bases = std::iter::once(reference).chain((0..count).filter(|base| *base != reference));
        let all: Vec<Vec<Correction>> = bases.map(off).collect();
        let fewest = all.iter().map(Vec::len).min().unwrap_or(0);
        let mut best = all.into_iter().filter(|off| off.len() == fewest);
        let cameras = best.next().unwrap_or_default();
        let same = |other: &[Correction]| {
            let pairs = other.iter().zip(&cameras);
            pairs.into_iter().all(|(a, b)| a.camera == b.camera)
        };
        Off {
            is_told: best.all(|other| same(&other)),
            cameras,
        }
    }

    /// What is wrong with the rig, in one sentence; `None` of one that the images do not contradict.
    pub fn problem(&self) -> Option<String> {
        let off = self.off();
        let id = |off: &Correction| self.given.cameras()[off.camera].id();
        let ids = off.cameras.iter().map(id).collect::<Vec<_>>().join("`, `");
        match (off.cameras.is_empty(), off.is_told) {
            (true, _) => None,
            (false, true) => Some(format!(
                "`{ids}` does not stand to the other cameras as the images show it"
            )),
            (false, false) => Some(format!(
                "cameras do not stand to each other as the images show it; which are wrong cannot be \
                 told, `{ids}` would explain it as well as others"
            )),
        }
    }

    /// The rig with some cameras where the images show them, the others standing still. Whether that
    /// is better than what was known says [`Refined::accepted`].
    ///
    /// # Errors
    /// Those of [`crate::Camera::moved_to`].
    pub fn refined(&self, cameras: &[usize]) -> Result<Refined> {
        let base = (0..self.given.cameras().len()).find(|camera| !cameras.contains(camera));
        let base = base.unwrap_or(self.given.reference());
        let moved = |sightings: &[Sighting]| -> Result<Option<(Rig, Adjusted)>> {
            let Some(found) = self.moved(cameras, sightings) else {
                return Ok(None);
            };
            let place = |index: usize| found.scene.cams_from_world[index].inverse();
            let rig = self
                .given
                .moved(|index, camera| match cameras.contains(&index) {
                    true => place(index),
                    false => *camera.world_from_cam(),
                })?;
            Ok(Some((rig, found)))
        };
        let (mut rig, mut corrections) = (self.given.clone(), Vec::new());
        if let Some((better, found)) = moved(&self.sightings)? {
            let one = |&camera: &usize| self.correction(&found, camera, base);
            corrections = cameras.iter().map(one).collect();
            rig = better;
        }
        let mut sets = self.set_of.clone();
        sets.dedup();
        let mut held_out = Vec::new();
        for set in sets.iter().filter(|_| sets.len() > 1) {
            let of_set = |s: &Sighting| self.set_of[s.object] == *set;
            let (held, others): (Vec<_>, Vec<_>) = self.sightings.iter().cloned().partition(of_set);
            let Some((by_others, _)) = moved(&others)? else {
                continue;
            };
            let [before, after] = [&self.given, &by_others].map(|rig| px(self, rig, &held));
            held_out.extend(before.zip(after).map(|(before, after)| [before, after]));
        }
        Ok(Refined {
            rig,
            moved: corrections,
            held_out,
        })
    }

    /// How well each two cameras agree, by a rig of the same cameras.
    pub fn pairs(&self, rig: &Rig) -> Vec<PairResidual> {
        let count = rig.cameras().len();
        let pairs = (1..count).flat_map(|b| (0..b).map(move |a| [a, b]));
        let of_pair = |cameras: [usize; 2]| {
            let by_both = |s: &&Sighting| cameras.contains(&s.camera);
            let two: Vec<Sighting> = self.sightings.iter().filter(by_both).cloned().collect();
            Some(PairResidual {
                cameras,
                objects: two.iter().filter(|s| shared(&two, s)).count() / 2,
                px: px(self, rig, &two)?,
            })
        };
        pairs.filter_map(of_pair).collect()
    }

    /// Everything where it fits best, with some cameras moved and the others standing still.
    fn moved(&self, cameras: &[usize], sightings: &[Sighting]) -> Option<Adjusted> {
        let given = cams_from_world(&self.given);
        let wider = Expected {
            turn_deg: WIDER * self.expected.turn_deg,
            shift_m: WIDER * self.expected.shift_m,
        };
        let expected = |camera| {
            if cameras.contains(&camera) {
                wider
            } else {
                FIXED
            }
        };
        let expected: Vec<Expected> = (0..given.len()).map(expected).collect();
        let mut start = self.adjusted.scene.clone();
        start.cams_from_world.clone_from(&given);
        adjusted(&given, &expected, start, sightings, FROM_PX)
    }

    fn correction(&self, adjusted: &Adjusted, camera: usize, base: usize) -> Correction {
        let agreed = agreed(adjusted, &self.sightings);
        let given = cams_from_world(&self.given);
        let relative = adjusted.relative(&given, &self.expected, camera, base);
        let (cam_from_shown, covariance, before) = relative;
        let turn = cam_from_shown.rotation.scaled_axis();
        let shift = cam_from_shown.translation.vector;
        let motion = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        let square = covariance.cholesky().map(|c| motion.dot(&c.solve(&motion)));
        // In axes in which what was expected is a unit in each direction.
        let left = before.cholesky().and_then(|before| {
            let inverse = before.l().try_inverse()?;
            let left = inverse * covariance * inverse.transpose();
            Some(left.symmetric_eigenvalues().max().sqrt())
        });
        Correction {
            camera,
            cam_from_shown,
            sigma: Expected::of(&covariance),
            deviation: square.map_or(f64::INFINITY, f64::sqrt),
            objects: agreed
                .iter()
                .filter(|cameras| cameras.len() > 1 && cameras.contains(&camera))
                .count(),
            left: left.unwrap_or(f64::INFINITY),
        }
    }
}

/// Of each object the cameras whose sightings keep their weight.
fn agreed(adjusted: &Adjusted, sightings: &[Sighting]) -> Vec<Vec<usize>> {
    let mut cameras = vec![Vec::new(); adjusted.scene.objects.len()];
    for (sighting, px) in sightings.iter().zip(&adjusted.px) {
        if *px < adjusted.keeps_weight_px() {
            cameras[sighting.object].push(sighting.camera);
        }
    }
    cameras
}

/// Whether another camera shows the same object.
fn shared(all: &[Sighting], one: &Sighting) -> bool {
    let mut others = all.iter().filter(|other| other.camera != one.camera);
    others.any(|other| other.object == one.object)
}

/// How far edges of what two cameras or more show are off where cameras stand still.
fn px(observed: &Observed, rig: &Rig, sightings: &[Sighting]) -> Option<f64> {
    let compared: Vec<Sighting> = sightings
        .iter()
        .filter(|one| shared(sightings, one))
        .cloned()
        .collect();
    let given = cams_from_world(rig);
    let mut start = observed.adjusted.scene.clone();
    start.cams_from_world.clone_from(&given);
    let expected = vec![FIXED; given.len()];
    let found = adjusted(&given, &expected, start, &compared, FROM_PX)?;
    let count = found.px.len() as f64;
    (count > 0.0).then(|| found.px.iter().sum::<f64>() / count)
}
