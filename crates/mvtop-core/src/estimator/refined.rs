//! The poses of all objects, refined on the images.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::hypotheses;
use super::pose::DecodedPose;
use super::sightings::Sighting;
use super::view::View;
use crate::Result;
use crate::bundle::{Bundle, Class};
use crate::consistency::Sight;
use crate::consistency::alone::{Alone, Difference, differences};
use crate::prediction::{Hypothesis, Refinement, Sigma};
use crate::refine::{self, Refined, Refiner};

/// Share of its edges that the images show of an object that is seen well, and how well colors tell it
/// from what is next to it.
const SEEN_WELL: [f64; 2] = [0.9, 0.85];
/// The most probable hypothesis is settled if it is this probable.
const SETTLED: f64 = 0.9;
/// Starts that are nearer to each other are refined once, degrees.
const START_DEG: f64 = 3.0;
/// Refined poses that are nearer to each other are one, degrees.
const SAME_DEG: f64 = 5.0;
/// How far the poses are turned that are looked at around one that is not, degrees.
const AROUND_DEG: f64 = 10.0;
/// So many of these are refined, at most.
const MOST_AROUND: usize = 3;
/// How probable each is beside the hypothesis that it is found around, before the images tell.
const BESIDE: f64 = 0.5;
/// How far they are expected to be off before they are refined, degrees; metres at least.
const OFF_DEG: f64 = 5.0;
const OFF_M: f64 = 0.002;

/// What the network says of objects when it looks at them again, several times: the poses of each look
/// at each object, which seems to be at a place in the world.
pub type Looks<'a> = dyn Fn(&[(&Sighting, Isometry3<f64>)]) -> Result<Vec<Vec<DecodedPose>>> + 'a;

/// A hypothesis and where the images have led it.
struct Led {
    /// As probable as the network says.
    start: Hypothesis,
    /// As probable as network and images say.
    end: Hypothesis,
    refinement: Refinement,
}

/// Refines each pose on the views that have a box of the object; `None` where its class has no mesh
/// or its edges are nowhere to be seen.
///
/// Of an object's hypotheses each is refined, and the images tell which is right. Where several
/// views show even that one badly or leave it open, and no object coordinates have told poses from all
/// around, the network looks again, and others around it are looked at.
///
/// - `refiners`: of each class
///
/// # Errors
/// Those of `looks`.
pub fn on_images(
    refiners: &[Option<Refiner>],
    views: &[View],
    bundle: &Bundle,
    found: &mut [(Sighting, DecodedPose)],
    looks: Option<&Looks>,
) -> Result<Vec<Option<Refinement>>> {
    let seen = found
        .iter()
        .map(|one| Seen::new(refiners, views, bundle, one));
    let seen: Vec<Option<Seen>> = seen.collect();
    let each = seen.par_iter().zip(&*found);
    let led = each.map(|(seen, (_, pose))| {
        let seen = seen.as_ref();
        seen.map_or_else(Vec::new, |seen| seen.led(&pose.hypotheses, Refiner::refine))
    });
    let mut led: Vec<Vec<Led>> = led.collect();

    look_further(&seen, found, &mut led, looks)?;

    let each = found.iter_mut().zip(led).zip(&seen);
    let taken = each.map(|(((_, pose), led), seen)| {
        let (class, refinement) = (seen.as_ref()?.class, best(&led)?.refinement);
        let ends = led.into_iter().map(|led| led.end).collect();
        *pose = DecodedPose {
            support: pose.support,
            ..hypotheses::likeliest(ends, &class.symmetry, class.diameter_m)
        };
        Some(refinement)
    });
    Ok(taken.collect())
}

/// An object whose most probable hypothesis several views show badly, or leave open.
struct Doubtful<'a> {
    seen: &'a Seen<'a>,
    object: &'a Sighting,
    /// Of that hypothesis.
    world_from_obj: Isometry3<f64>,
    led: &'a mut Vec<Led>,
}

/// Adds to the hypotheses of doubtful objects those of more looks, and those around the most probable one.
fn look_further(
    seen: &[Option<Seen>],
    found: &[(Sighting, DecodedPose)],
    led: &mut [Vec<Led>],
    looks: Option<&Looks>,
) -> Result<()> {
    let each = seen.iter().zip(found).zip(led);
    let doubtful = each.filter_map(|((seen, (object, pose)), led)| {
        // One view alone leaves too much open for images to choose by.
        let several = pose.support.is_none() && object.views() > 1;
        let seen = seen.as_ref().filter(|_| several)?;
        let best = best(led).filter(|best| best.is_doubtful(led))?;
        Some(Doubtful {
            seen,
            object,
            world_from_obj: best.end.world_from_obj,
            led,
        })
    });
    let mut doubtful: Vec<Doubtful> = doubtful.collect();
    if let Some(looks) = looks.filter(|_| !doubtful.is_empty()) {
        let places = doubtful.iter().map(|one| (one.object, one.world_from_obj));
        let looked = looks(&places.collect::<Vec<_>>())?;
        let each = doubtful.par_iter_mut().zip(&looked);
        each.for_each(|(one, poses)| one.seen.pool(one.led, poses));
    }
    let each = doubtful.par_iter_mut();
    each.for_each(|one| one.seen.add_around(one.led));
    Ok(())
}

impl Led {
    /// Whether the images show this one of some hypotheses badly, or leave it open.
    fn is_doubtful(&self, all: &[Self]) -> bool {
        let total: f64 = all.iter().map(|led| led.end.probability).sum();
        let [edges, colors] = SEEN_WELL;
        let Refinement {
            supported, overlap, ..
        } = self.refinement;
        supported < edges || overlap < colors || self.end.probability < SETTLED * total
    }
}

impl Refinement {
    /// As [`refine::Quality::score`].
    pub(super) fn score(&self) -> f64 {
        refine::score(self.explained, self.print, self.supported, self.overlap)
    }
}

/// [`Refiner::refine`], or what is like it.
type Refine = fn(&Refiner, &[refine::View], &Isometry3<f64>, Sigma) -> Option<Refined>;

/// An object, and the views that have a box of it.
struct Seen<'a> {
    refiner: &'a Refiner,
    class: &'a Class,
    views: Vec<refine::View<'a>>,
    /// Of the network's pose.
    sigma_before: Sigma,
}

impl<'a> Seen<'a> {
    /// `None` where its class has no mesh.
    fn new(
        refiners: &'a [Option<Refiner>],
        views: &'a [View],
        bundle: &'a Bundle,
        (object, pose): &(Sighting, DecodedPose),
    ) -> Option<Self> {
        let with_box = views.iter().zip(&object.boxes);
        let with_box = with_box.filter(|(_, bbox)| bbox.is_some());
        let views = with_box.map(|(view, _)| refine::View {
            camera: view.camera,
            image: view.image,
        });
        Some(Self {
            refiner: refiners[object.class].as_ref()?,
            class: &bundle.classes[object.class],
            views: views.collect(),
            sigma_before: pose.sigma,
        })
    }

    /// Each hypothesis as the images show it best, and as probable as they tell.
    fn led(&self, hypotheses: &[Hypothesis], by: Refine) -> Vec<Led> {
        let class = self.class;
        let one = |start: &Hypothesis| {
            let refined = by(
                self.refiner,
                &self.views,
                &start.world_from_obj,
                start.sigma,
            )?;
            let quality = &refined.quality;
            let end = Hypothesis {
                world_from_obj: match class.symmetry.is_none() {
                    true => refined.world_from_obj,
                    false => class.symmetry.canonical(&refined.world_from_obj),
                },
                sigma: refined.sigma,
                probability: start.probability * quality.score().exp(),
            };
            let refinement = Refinement {
                accepted: refined.accepted,
                supported: refined.supported,
                residual_px: refined.residual_px,
                overlap: quality.overlap(),
                explained: quality.explained(),
                explained_least: quality.worst().map_or(0.0, |view| view.explained),
                print: quality.print(),
                sigma_before: self.sigma_before,
            };
            let start = *start;
            Some(Led {
                start,
                end,
                refinement,
            })
        };
        hypotheses.par_iter().filter_map(one).collect()
    }

    /// Adds the hypotheses of more looks: each is as probable as all looks together say, and as the
    /// images tell. Those that lead to the same pose are one.
    fn pool(&self, led: &mut Vec<Led>, looks: &[DecodedPose]) {
        let mut new: Vec<Hypothesis> = Vec::new();
        for one in looks.iter().flat_map(|look| &look.hypotheses) {
            let mut starts = led.iter_mut().map(|led| &mut led.start).chain(&mut new);
            match starts.find(|start| self.apart_deg(start, one) < START_DEG) {
                Some(start) => start.probability += one.probability,
                None => new.push(*one),
            }
        }
        led.extend(self.led(&new, Refiner::refine));
        for Led {
            start,
            end,
            refinement,
        } in &mut *led
        {
            end.probability = start.probability * refinement.score().exp();
        }
        led.sort_by(|a, b| b.end.probability.total_cmp(&a.end.probability));
        let mut apart: Vec<Led> = Vec::new();
        for one in led.drain(..) {
            let same = |other: &&mut Led| self.apart_deg(&other.end, &one.end) < SAME_DEG;
            match apart.iter_mut().find(same) {
                Some(other) => {
                    other.start.probability += one.start.probability;
                    other.end.probability += one.end.probability;
                }
                None => apart.push(one),
            }
        }
        *led = apart;
    }

    /// Adds those around the most probable one that the images show best.
    fn add_around(&self, led: &mut Vec<Led>) {
        let Some(first) = best(led) else {
            return;
        };
        let sigma = Sigma {
            rot_deg: OFF_DEG,
            t_m: first.end.sigma.t_m.max(OFF_M),
        };
        let probability = BESIDE * first.start.probability;
        let center = &first.end.world_from_obj;
        let poses = self.refiner.around(&self.views, center, sigma, AROUND_DEG);
        let one = |world_from_obj| Hypothesis {
            world_from_obj,
            sigma,
            probability,
        };
        let around: Vec<Hypothesis> = poses.into_iter().take(MOST_AROUND).map(one).collect();
        led.extend(self.led(&around, Refiner::refine_finely));
    }

    /// Angle between two poses, but for symmetries.
    fn apart_deg(&self, a: &Hypothesis, b: &Hypothesis) -> f64 {
        let (a, b) = (&a.world_from_obj, &b.world_from_obj);
        (self.class.symmetry).apart_deg(a, b, self.class.diameter_m)
    }
}

/// The most probable.
fn best(led: &[Led]) -> Option<&Led> {
    led.iter()
        .max_by(|a, b| a.end.probability.total_cmp(&b.end.probability))
}

/// How far the pose that each view tells by itself is from the one on which all agree best, by index
/// of the camera; empty for objects without a mesh, or with a box in fewer than two views.
pub fn by_view(
    refiners: &[Option<Refiner>],
    views: &[View],
    bundle: &Bundle,
    found: &[(Sighting, DecodedPose)],
) -> Vec<Vec<(usize, Difference)>> {
    let one = |(object, pose): &(Sighting, DecodedPose)| {
        let refiner = refiners[object.class].as_ref()?;
        let points = &bundle.classes[object.class].points;
        if object.views() < 2 {
            return None;
        }
        let seen = views.par_iter().zip(&object.boxes);
        let alone = seen.filter_map(|(view, bbox)| {
            let (camera, image) = (view.camera, view.image);
            let sight = Sight {
                camera,
                bbox: (*bbox)?,
            };
            let view = (view.index, refine::View { camera, image });
            let alone = Alone::of(refiner, &view.1, &sight, points, &pose.world_from_obj)?;
            Some((view.0, alone))
        });
        let alone: Vec<(usize, Alone)> = alone.collect();
        let (cameras, alone): (Vec<usize>, Vec<Alone>) = alone.into_iter().unzip();
        let differences = differences(refiner, &alone, &pose.world_from_obj)?;
        Some(cameras.into_iter().zip(differences).collect())
    };
    let all = found.par_iter().map(|found| one(found).unwrap_or_default());
    all.collect()
}
