//! What files cannot say.

use crate::{Checked, Format};

/// What to know beyond what files say; nothing by default.
///
/// Errors ask for what is missing by these names, and by those of the command line's flags.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The format; recognised by default.
    pub format: Option<Format>,
    /// Metres per unit of the file's lengths.
    pub scale: Option<f64>,
    /// The same by name.
    pub unit: Option<Unit>,
    /// Sizes of images, px, of files that do not say them.
    pub image_sizes: Vec<ImageSize>,
    /// What the file's poses map to what, where it does not say.
    pub direction: Option<Direction>,
    /// "pinhole" or "fisheye", where the file does not name its lens.
    pub model: Option<String>,
    /// Greatest angle from the optical axis at which a lens images anything, or is to be used, degrees.
    pub max_angle: Option<f64>,
    /// Of BOP: number of the image whose cameras make the rig.
    pub image: Option<u32>,
    /// The images are rectified ones (ROS: `image_rect`), without distortion.
    pub rectified: bool,
    /// The cameras do stand as near together or as far apart as that makes them, which is refused
    /// else: it hints at a wrong unit.
    pub trust_unit: bool,
    /// Keys that state neither a lens nor a place nor a size; what is not known is refused else.
    pub ignore: Vec<String>,
}

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// m
    Metre,
    /// cm
    Centimetre,
    /// mm
    Millimetre,
}

/// What a pose of a camera maps to what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Camera coordinates to world coordinates: the pose of the camera.
    WorldFromCam,
    /// World coordinates to camera coordinates: OpenCV's R and t.
    CamFromWorld,
}

/// Size of a camera's images.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageSize {
    /// The camera's id; `None` for all cameras.
    pub camera: Option<String>,
    /// Width and height, px.
    pub size: [u32; 2],
}

impl Unit {
    /// By its name: m, cm or mm.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "m" => Some(Self::Metre),
            "cm" => Some(Self::Centimetre),
            "mm" => Some(Self::Millimetre),
            _ => None,
        }
    }

    /// By what files call it.
    pub(crate) fn of_file(text: &str) -> Option<Self> {
        match text.to_lowercase().as_str() {
            "m" | "meter" | "meters" | "metre" | "metres" => Some(Self::Metre),
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => {
                Some(Self::Centimetre)
            }
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => {
                Some(Self::Millimetre)
            }
            _ => None,
        }
    }

    /// How long it is.
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
            Self::Millimetre => 0.001,
        }
    }
}

impl Direction {
    /// By its name: `world_from_cam` or `cam_from_world`.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "world_from_cam" => Some(Self::WorldFromCam),
            "cam_from_world" => Some(Self::CamFromWorld),
            _ => None,
        }
    }
}

impl ImageSize {
    /// From `WxH`, or `ID=WxH` for one camera.
    pub fn parse(text: &str) -> Option<Self> {
        let (camera, size) = match text.rsplit_once('=') {
            Some((camera, size)) => (Some(camera.to_owned()), size),
            None => (None, text),
        };
        let (width, height) = size.split_once(['x', 'X'])?;
        let size = [width.trim().parse().ok()?, height.trim().parse().ok()?];
        Some(Self { camera, size })
    }
}

impl Options {
    pub(crate) fn check(&self) -> Checked<()> {
        match (self.scale, self.unit) {
            (Some(_), Some(_)) => Err(
                "`scale` and `unit` (--scale, --unit) say the same, so give only one of them"
                    .into(),
            ),
            (Some(scale), None) if !(scale.is_finite() && scale > 0.0) => Err(format!(
                "`scale` (--scale) must be the metres per unit of the file, above 0, got {scale}"
            )),
            _ => Ok(()),
        }
    }

    /// Whether the key at the end of a path, or one around it, is to be left out.
    pub(crate) fn ignores(&self, path: &str) -> bool {
        path.split(": ")
            .any(|key| self.ignore.iter().any(|ignored| ignored == key))
    }

    /// Metres per unit, if that was said.
    pub(crate) fn metres(&self) -> Option<f64> {
        self.scale.or(self.unit.map(Unit::metres))
    }

    /// Size of that camera's images, if it was said.
    pub(crate) fn size_of(&self, id: &str) -> Option<[u32; 2]> {
        let of = |camera: Option<&str>| {
            let mut sizes = self.image_sizes.iter();
            sizes.find(|size| size.camera.as_deref() == camera)
        };
        of(Some(id)).or(of(None)).map(|size| size.size)
    }
}
