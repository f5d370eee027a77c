//! What is read of a data set although it makes results doubtful: said in sentences, never silently.

use std::path::PathBuf;

use super::json::ROUNDED;

/// What was noticed in any number of files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Doubts {
    /// Rotations of the ground truth that were made exact.
    pub inexact: Inexact,
    /// Images that are named in a scene's list of cameras, and not there.
    pub missing: Missing,
    /// Scenes whose cameras' translations look like metres.
    pub in_metres: Vec<PathBuf>,
}

/// Rotations of few digits, which were made exact.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Inexact {
    /// All rotations that were read.
    pub of: usize,
    /// Those off by more than 0.001, in any entry of RᵀR.
    pub count: usize,
    /// How far the worst of them is off, in the same measure.
    pub greatest: f64,
    /// Where that one stands: file, image and row.
    pub place: String,
}

/// Files that are not there.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Missing {
    /// How many.
    pub count: usize,
    /// One of them, without its ending.
    pub first: PathBuf,
}

impl Inexact {
    /// Notes a rotation.
    ///
    /// - `off`: largest entry of RᵀR - 1 before it was made exact
    /// - `place`: file, image and row; asked for the worst only
    pub fn note(&mut self, off: f64, place: impl FnOnce() -> String) {
        self.of += 1;
        if off > ROUNDED {
            self.count += 1;
            if off > self.greatest {
                (self.greatest, self.place) = (off, place());
            }
        }
    }

    /// Puts what was noted elsewhere with it.
    pub fn extend(&mut self, other: Self) {
        self.of += other.of;
        self.count += other.count;
        if other.greatest > self.greatest {
            (self.greatest, self.place) = (other.greatest, other.place);
        }
    }

    /// What to tell people; `None` where all are exact.
    ///
    /// - `whose`: what the rotations are of, `the ground truth`
    pub fn sentence(&self, whose: &str) -> Option<String> {
        let Self {
            of,
            count,
            greatest,
            place,
        } = self;
        (*count > 0).then(|| {
            format!(
                "{count} of {of} rotations of {whose} are off from a rotation by more than \
                 {ROUNDED}, at most {greatest:.1e} ({place}); they were made exact"
            )
        })
    }
}

impl Doubts {
    /// Puts what was noticed elsewhere with it.
    pub fn extend(&mut self, other: Self) {
        self.inexact.extend(other.inexact);
        if self.missing.count == 0 {
            self.missing.first = other.missing.first;
        }
        self.missing.count += other.missing.count;
        self.in_metres.extend(other.in_metres);
    }

    /// What to tell people, a sentence each.
    pub fn sentences(&self) -> Vec<String> {
        let missing = &self.missing;
        let missing = (missing.count > 0).then(|| {
            format!(
                "{} images that scene_camera.json names are not there and left out, the first \
                 is {}; unpack all of the data set's images to use them",
                missing.count,
                missing.first.display()
            )
        });
        let in_metres = self.in_metres.first().map(|first| {
            format!(
                "cam_t_w2c looks like metres in {} scenes, the first is {}: all cameras would stand \
                 within a hundredth of the objects' distance; BOP's unit is the millimetre, so multiply \
                 by 1000 if so",
                self.in_metres.len(),
                first.display()
            )
        });
        self.inexact
            .sentence("the ground truth")
            .into_iter()
            .chain(missing)
            .chain(in_metres)
            .collect()
    }
}
