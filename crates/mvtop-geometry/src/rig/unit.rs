//! The unit of length of a rig file, and whether it can be true.

use std::fmt;

use crate::camera::Camera;

/// Spread of a rig's cameras that is believed, metres: from the two lenses of a small stereo head
/// to the far corners of a hall.
const CREDIBLE: std::ops::RangeInclusive<f64> = 0.002..=100.0;

#[derive(Clone, Copy)]
pub(super) struct Unit {
    pub name: &'static str,
    pub metres: f64,
}

/// The likeliest first, for guessing.
const UNITS: [Unit; 3] = [unit("mm", 0.001), METRE, unit("cm", 0.01)];
pub(super) const METRE: Unit = unit("m", 1.0);

const fn unit(name: &'static str, metres: f64) -> Unit {
    Unit { name, metres }
}

impl Unit {
    pub fn named(name: &str) -> Option<Self> {
        UNITS.into_iter().find(|unit| unit.name == name)
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
        let fix = match self.likely(unit) {
            Some(Unit { name, .. }) => {
                format!("the numbers look like {name}, so set `unit` to \"{name}\"")
            }
            None => "check the translations".to_owned(),
        };
        format!(
            "with `unit` \"{}\" {self}; {fix}, or set `trust_unit` to true",
            unit.name
        )
    }

    /// What to say of numbers in metres.
    pub fn in_metres(&self) -> String {
        let fix = match self.likely(METRE) {
            Some(unit) => format!("the unit looks like {}, so convert it to m", unit.name),
            None => "check the translations".to_owned(),
        };
        format!("{self}; {fix}, or set `trust_unit` to true")
    }

    /// The unit in which the numbers would be believed.
    fn likely(&self, unit: Unit) -> Option<Unit> {
        let numbers = self.metres / unit.metres;
        let mut units = UNITS.into_iter();
        units.find(|unit| CREDIBLE.contains(&(numbers * unit.metres)))
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
