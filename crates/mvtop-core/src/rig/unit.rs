//! The unit of length of a rig file, and whether it can be true.

use super::fields::Checked;
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

    /// Refuses cameras too far apart or too close together for this to be their unit.
    pub fn check(self, cameras: &[Camera]) -> Checked<()> {
        let center = |camera: &Camera| camera.world_from_cam.translation.vector;
        let pairs = cameras.iter().enumerate().flat_map(|(i, a)| {
            cameras[i + 1..]
                .iter()
                .map(move |b| (a, b, (center(a) - center(b)).norm()))
        });
        let Some((a, b, apart)) = pairs.max_by(|x, y| x.2.total_cmp(&y.2)) else {
            return Ok(());
        };
        if CREDIBLE.contains(&apart) {
            return Ok(());
        }
        let name = self.name();
        let fix = Self::ALL
            .into_iter()
            .find(|unit| CREDIBLE.contains(&(apart / self.metres() * unit.metres())))
            .map_or("check the translations".to_owned(), |unit| {
                format!(
                    "the numbers look like {0}, so set `unit` to \"{0}\"",
                    unit.name()
                )
            });
        Err(format!(
            "with `unit` \"{name}\" the cameras farthest apart, `{}` and `{}`, are {apart:.4} \
             m apart, expected {} to {} m; {fix}",
            a.id,
            b.id,
            CREDIBLE.start(),
            CREDIBLE.end()
        ))
    }
}
