//! The unit of length of a rig file, and whether it can be true.

use std::fmt;

use crate::camera::Camera;

/// Spread of a rig's cameras that is believed, metres: from the two lenses of a small stereo head
/// to the far corners of a hall.
const CREDIBLE: std::ops::RangeInclusive<f64> = 0.002..=100.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    Millimetre,
    Metre,
    Centimetre,
}

impl Unit {
    /// The likeliest first, for guessing.
    const ALL: [Self; 3] = [Self::Millimetre, Self::Metre, Self::Centimetre];

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| unit.name() == name)
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Metre => "m",
            Self::Centimetre => "cm",
        }
    }

    /// Metres per unit.
    pub fn metres(self) -> f64 {
        match self {
            Self::Millimetre => 0.001,
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
        }
    }
}

/// Cameras too far apart or too close together to be believed: how far, and which.
pub(super) struct Spread<'a> {
    metres: f64,
    a: &'a str,
    b: &'a str,
}

/// What is wrong with where cameras stand, if anything.
pub(super) fn implausible(cameras: &[Camera]) -> Option<Spread<'_>> {
    let center = |camera: &Camera| camera.world_from_cam().translation.vector;
    let pairs = cameras.iter().enumerate().flat_map(|(i, a)| {
        cameras[i + 1..].iter().map(move |b| Spread {
            metres: (center(a) - center(b)).norm(),
            a: a.id(),
            b: b.id(),
        })
    });
    pairs
        .max_by(|x, y| x.metres.total_cmp(&y.metres))
        .filter(|spread| !CREDIBLE.contains(&spread.metres))
}

impl Spread<'_> {
    /// What to say of a file in this unit.
    pub fn in_unit(&self, unit: Unit) -> String {
        let fix = self.likely(unit).map_or(
            "check the translations, or set `trust_unit` to true".to_owned(),
            |unit| {
                let name = unit.name();
                format!("the numbers look like {name}, so set `unit` to \"{name}\"")
            },
        );
        format!("with `unit` \"{}\" {self}; {fix}", unit.name())
    }

    /// What to say of numbers in metres.
    pub fn in_metres(&self) -> String {
        let fix = self
            .likely(Unit::Metre)
            .map_or("check the translations".to_owned(), |unit| {
                format!("the unit looks like {}, so convert it to m", unit.name())
            });
        format!("{self}; {fix}")
    }

    /// The unit in which the numbers would be believed.
    fn likely(&self, unit: Unit) -> Option<Unit> {
        let numbers = self.metres / unit.metres();
        let mut units = Unit::ALL.into_iter();
        units.find(|unit| CREDIBLE.contains(&(numbers * unit.metres())))
    }
}

impl fmt::Display for Spread<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { metres, a, b } = self;
        let (least, most) = (CREDIBLE.start(), CREDIBLE.end());
        write!(
            f,
            "the cameras farthest apart, `{a}` and `{b}`, are {metres:.4} m apart, expected {least} \
             to {most} m"
        )
    }
}
