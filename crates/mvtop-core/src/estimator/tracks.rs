//! Which objects of successive predictions are the same.

use derive_setters::Setters;
use nalgebra::Point3;

use crate::Prediction;
use crate::bundle::Bundle;
use crate::prediction::ObjectPose;

/// How objects are followed over time.
#[derive(Debug, Clone, Copy, PartialEq, Setters)]
#[setters(prefix = "with_", strip_option)]
#[non_exhaustive]
pub struct TrackOptions {
    /// Farthest that an object moves between two predictions, metres; `None`: half its diameter, by
    /// which objects that lie still are distinguished.
    pub max_motion_m: Option<f64>,
    /// Predictions after which an object that is not found any more is forgotten.
    pub patience: usize,
}

impl Default for TrackOptions {
    fn default() -> Self {
        Self {
            max_motion_m: None,
            patience: 30,
        }
    }
}

/// Gives objects numbers that stay theirs over time.
///
/// An object is the same as the nearest one of its class in earlier predictions, if it is within the
/// bound of motion; pairs are made nearest first. Numbers start at 1, and none is given twice.
#[derive(Debug, Clone, Default)]
pub struct Tracks {
    options: TrackOptions,
    /// Numbers that were given.
    given: u64,
    known: Vec<Track>,
}

/// An object that was seen before.
#[derive(Debug, Clone)]
struct Track {
    id: u64,
    class: String,
    /// Where its middle was seen last, world frame, metres.
    middle: Point3<f64>,
    /// Predictions since then.
    unseen: usize,
}

impl Tracks {
    /// Without any objects yet.
    pub fn new(options: TrackOptions) -> Self {
        Self {
            options,
            ..Self::default()
        }
    }

    /// Gives each object of the next prediction its number.
    ///
    /// - `bundle`: that of the prediction
    pub fn follow(&mut self, prediction: &mut Prediction, bundle: &Bundle) {
        let of = |object: &ObjectPose| {
            let reach = self.options.max_motion_m.or_else(|| {
                let class = bundle.class_index(&object.class)?;
                Some(bundle.classes[class].diameter_m / 2.0)
            });
            (object.middle(bundle), reach.unwrap_or(0.0))
        };
        let seen: Vec<(Point3<f64>, f64)> = prediction.objects.iter().map(of).collect();
        let mut pairs = Vec::new();
        for (known, track) in self.known.iter().enumerate() {
            for (new, object) in prediction.objects.iter().enumerate() {
                let (middle, reach) = seen[new];
                let moved = (middle - track.middle).norm();
                if object.class == track.class && moved <= reach {
                    pairs.push((moved, known, new));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.known.iter_mut().for_each(|track| track.unseen += 1);
        prediction
            .objects
            .iter_mut()
            .for_each(|object| object.track_id = None);
        for (_, known, new) in pairs {
            let (track, object) = (&mut self.known[known], &mut prediction.objects[new]);
            if track.unseen > 0 && object.track_id.is_none() {
                object.track_id = Some(track.id);
                track.unseen = 0;
                track.middle = seen[new].0;
            }
        }
        self.known
            .retain(|track| track.unseen <= self.options.patience);
        for (object, (middle, _)) in prediction.objects.iter_mut().zip(seen) {
            if object.track_id.is_none() {
                self.given += 1;
                object.track_id = Some(self.given);
                self.known.push(Track {
                    id: self.given,
                    class: object.class.clone(),
                    middle,
                    unseen: 0,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::request::tests::{bundle, found};
    use nalgebra::Isometry3;

    /// A can, a box and another can at 1, 1 and 2 m; as [`found`], moved along x.
    fn moved(by: f64) -> Prediction {
        let mut prediction = found();
        for object in &mut prediction.objects {
            object.world_from_obj = Isometry3::translation(by, 0.0, 0.0) * object.world_from_obj;
        }
        prediction
    }

    fn ids(tracks: &mut Tracks, mut prediction: Prediction) -> Vec<u64> {
        tracks.follow(&mut prediction, &bundle());
        let ids = prediction.objects.iter().map(|one| one.track_id.unwrap());
        ids.collect()
    }

    #[test]
    fn objects_keep_their_numbers_whatever_their_order() {
        let mut tracks = Tracks::default();
        assert_eq!(ids(&mut tracks, found()), [1, 2, 3]);
        let mut turned = moved(0.01);
        turned.objects.reverse();
        assert_eq!(ids(&mut tracks, turned), [3, 2, 1]);
    }

    #[test]
    fn objects_beyond_the_bound_are_new_and_no_number_comes_again() {
        let mut tracks = Tracks::new(TrackOptions {
            max_motion_m: Some(0.1),
            patience: 1,
        });
        assert_eq!(ids(&mut tracks, found()), [1, 2, 3]);
        assert_eq!(ids(&mut tracks, moved(0.09)), [1, 2, 3]);
        assert_eq!(ids(&mut tracks, moved(0.2)), [4, 5, 6]);
        // Seen again one prediction later, and forgotten after two without.
        assert_eq!(ids(&mut tracks, moved(0.09)), [1, 2, 3]);
        let nothing = Prediction {
            objects: Vec::new(),
            ..found()
        };
        assert!(ids(&mut tracks, nothing.clone()).is_empty());
        assert!(ids(&mut tracks, nothing).is_empty());
        assert_eq!(ids(&mut tracks, moved(0.09)), [7, 8, 9]);
    }

    #[test]
    fn of_two_objects_in_reach_the_nearer_one_is_the_same() {
        let mut tracks = Tracks::new(TrackOptions {
            max_motion_m: Some(2.0),
            ..TrackOptions::default()
        });
        assert_eq!(ids(&mut tracks, found()), [1, 2, 3]);
        // The first can went 0.7 m towards the second one, which stayed; a box is no can.
        let mut later = found();
        later.objects[0].world_from_obj = Isometry3::translation(0.0, 0.0, 1.7);
        later.objects.remove(1);
        assert_eq!(ids(&mut tracks, later), [1, 3]);
    }
}
