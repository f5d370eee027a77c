//! A rig: calibrated cameras in one world frame. `docs/reference/rig-file.md` describes its file
//! format.

mod document;
pub(crate) mod fields;
mod parse;
mod unit;

use std::collections::HashSet;
use std::path::Path;

use self::document::Document;
use crate::camera::Camera;
use crate::{Error, Result, file};
use nalgebra::{Isometry3, Point2};

const FORMAT: &str = "mvtop-rig";
const VERSION: u64 = 1;
/// Largest rig file that is read.
const MAX_FILE_BYTES: u64 = 1 << 24;
/// Far above real rigs, low enough to bound memory.
const MOST_CAMERAS: usize = 1000;
/// Pixels of all cameras together, as an exposure is held in memory.
const MOST_PIXELS: u64 = 1 << 30;
/// Longest focal length that is believed, in sides of the image.
const MOST_FOCAL: f64 = 100.0;

/// Largest share of the image that a pinhole may have no line of sight for.
const MOST_BLIND: f64 = 0.25;
/// Share of the image without a line of sight that is warned of.
const BLIND: f64 = 0.005;

/// JSON Schema of a rig file.
#[cfg(feature = "schema")]
pub fn schema(generator: schemars::SchemaGenerator) -> schemars::Schema {
    generator.into_root_schema_for::<Document>()
}

/// The cameras that look at a scene together, in one world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    cameras: Vec<Camera>,
    reference: usize,
}

impl Rig {
    /// A rig of these cameras.
    ///
    /// - `reference`: index of the camera in whose frame poses are given
    ///
    /// How far apart the cameras stand is not checked here but by [`Rig::check_spread`], as one
    /// camera's images of a still scene are a rig, too.
    ///
    /// # Errors
    /// [`Error::Rig`] without cameras, for more than 1000 or 1,073 million pixels, for two of the same id, for a reference
    /// that is none of them, for a focal length above a hundred times the image's side, for a lens that
    /// has no ray for the middle of the image, and for a pinhole without a line of sight for more than a
    /// quarter of it, unless its greatest angle is given.
    ///
    /// ```
    /// use mvtop_geometry::{Camera, Intrinsics, Projection, Rig};
    /// use nalgebra::Isometry3;
    ///
    /// let intrinsics = Intrinsics::new(500.0, 500.0, 320.0, 240.0, Projection::Pinhole)?;
    /// let camera = |id, x| {
    ///     Camera::new(id, [640, 480], intrinsics.clone(), Isometry3::translation(x, 0.0, 0.0))
    /// };
    /// let rig = Rig::new(vec![camera("left", 0.0)?, camera("right", 0.4)?], 0)?;
    /// assert_eq!(rig.index_of("right"), Some(1));
    /// assert_eq!(Rig::from_json(&rig.to_json())?, rig);
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn new(cameras: Vec<Camera>, reference: usize) -> Result<Self> {
        Self::checked(cameras, reference).map_err(Error::rig)
    }

    /// The same; the error is one sentence without the rig's name.
    fn checked(cameras: Vec<Camera>, reference: usize) -> Result<Self, String> {
        let count = cameras.len();
        if !(1..=MOST_CAMERAS).contains(&count) {
            return Err(format!(
                "`cameras` must list 1 to {MOST_CAMERAS} cameras, got {count}"
            ));
        }
        let pixels = |camera: &Camera| u64::from(camera.width()) * u64::from(camera.height());
        let all: u64 = cameras.iter().map(pixels).sum();
        if all > MOST_PIXELS {
            return Err(format!(
                "`cameras` must have {} million pixels together at most, got {}; calibrate at a smaller \
                 size",
                MOST_PIXELS / 1_000_000,
                all / 1_000_000
            ));
        }
        let mut ids = HashSet::new();
        if let Some(twice) = cameras.iter().find(|camera| !ids.insert(camera.id())) {
            let id = twice.id();
            return Err(format!("two cameras have the id `{id}`; ids must differ"));
        }
        if reference >= count {
            return Err(format!(
                "the reference must be the index of one of the {count} cameras, got {reference}"
            ));
        }
        cameras.iter().try_for_each(sees)?;
        Ok(Self { cameras, reference })
    }

    /// Reads a rig file.
    ///
    /// # Errors
    /// [`Error::Read`] where the file cannot be read, [`Error::Rig`] where it is refused.
    ///
    /// ```no_run
    /// # use std::path::Path;
    /// let rig = mvtop_geometry::Rig::load(Path::new("rig.json"))?;
    /// println!("{} cameras, {} first", rig.cameras().len(), rig.reference_camera().id());
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn load(path: &Path) -> Result<Self> {
        let text = file::read_text(path, MAX_FILE_BYTES)?;
        parse::rig(&path.display().to_string(), &text)
    }

    /// Reads the text of a rig file.
    ///
    /// # Errors
    /// [`Error::Rig`] for anything that is no rig, or that hints at a mistake: every value is
    /// checked, and nothing is guessed.
    pub fn from_json(text: &str) -> Result<Self> {
        parse::rig("rig", text)
    }

    /// The text of a rig file, in metres; [`Rig::from_json`] reads the same rig from it.
    pub fn to_json(&self) -> String {
        let text = serde_json::to_string_pretty(&Document::of(self));
        text.expect("numbers and texts can be written") + "\n"
    }

    /// Sentences about cameras that may be wrong: those whose lens leaves a part of their image without a line
    /// of sight, though no `max_angle_deg` says so.
    pub fn warnings(&self) -> Vec<String> {
        let unlimited = |camera: &&Camera| camera.intrinsics().max_angle_deg().is_none();
        let cameras = self.cameras.iter().filter(unlimited);
        let shares = cameras.map(|camera| (camera.id(), camera.blind_share()));
        let blind = shares.filter(|(_, share)| *share > BLIND);
        let sentence = |(id, share): (&str, f64)| {
            format!(
                "camera `{id}`: {:.1} % of its image has no line of sight, as its lens folds there; check its \
                 coefficients, or give `max_angle_deg` (`rig import --max-angle`) if it images no more",
                100.0 * share
            )
        };
        blind.map(sentence).collect()
    }

    /// Refuses cameras that all stand within 2 mm of each other, or up to more than 100 m apart: in
    /// numbers that a person wrote, this hints at another unit than metres.
    ///
    /// # Errors
    /// [`Error::Rig`], which names the cameras farthest apart, the likely unit, and `trust_unit`, by
    /// which rig files, Python and the command line say that it is meant so.
    pub fn check_spread(&self) -> Result<()> {
        match unit::implausible(&self.cameras) {
            None => Ok(()),
            Some(spread) => Err(Error::rig(spread.in_metres())),
        }
    }

    /// The same cameras at other places.
    ///
    /// - `world_from_cam`: new pose of the camera of that index, metres
    ///
    /// # Errors
    /// [`Error::Camera`] for a pose that [`Camera::new`] refuses.
    pub fn moved(&self, world_from_cam: impl Fn(usize, &Camera) -> Isometry3<f64>) -> Result<Self> {
        let cameras = self.cameras.iter().enumerate();
        let moved = cameras.map(|(index, camera)| camera.moved_to(world_from_cam(index, camera)));
        Ok(Self {
            cameras: moved.collect::<Result<_>>()?,
            reference: self.reference,
        })
    }

    /// The same rig with the camera of that id as its reference.
    ///
    /// # Errors
    /// [`Error::UnknownCamera`].
    pub fn referring_to(mut self, id: &str) -> Result<Self> {
        self.reference = self.find("reference", id)?;
        Ok(self)
    }

    /// At least one; ids are unique.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Index of the reference camera, in whose frame poses are given.
    pub fn reference(&self) -> usize {
        self.reference
    }

    /// The camera in whose frame poses are given.
    pub fn reference_camera(&self) -> &Camera {
        &self.cameras[self.reference]
    }

    /// As [`Rig::index_of`], refusing an id that the rig does not have.
    ///
    /// - `role`: what the camera is named for, for the error
    ///
    /// # Errors
    /// [`Error::UnknownCamera`].
    pub fn find(&self, role: &str, id: &str) -> Result<usize> {
        self.index_of(id).ok_or_else(|| Error::UnknownCamera {
            role: role.to_owned(),
            id: id.to_owned(),
            known: self.cameras.iter().map(|c| c.id().to_owned()).collect(),
        })
    }

    /// Index of the camera of that id.
    pub fn index_of(&self, id: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.id() == id)
    }
}

/// Refuses a camera that a rig has no use for: with hardly any field of view, or with a lens that
/// images nothing in the middle, as by coefficients of another model or in another order.
fn sees(camera: &Camera) -> Result<(), String> {
    let (id, lens) = (camera.id(), camera.intrinsics());
    let sides = [camera.width(), camera.height()].map(f64::from);
    for (name, focal, side) in [("fx", lens.fx(), sides[0]), ("fy", lens.fy(), sides[1])] {
        if focal > MOST_FOCAL * side {
            return Err(format!(
                "camera `{id}`: the focal length `{name}` of {focal} px is too long for an image of \
                 {side} px, which would show half a degree; give it in pixels of this image"
            ));
        }
    }
    let middle = Point2::from(sides.map(|side| (side - 1.0) / 2.0));
    if lens.unproject(&middle).is_none() {
        return Err(format!(
            "camera `{id}`: its lens has no ray for the middle of the image; check the model and the \
             order of the coefficients of `distortion`"
        ));
    }
    // A fisheye may have black corners; a pinhole's polynomial is of no use where it turns back.
    if lens.projection().family() != "pinhole" || lens.max_angle_deg().is_some() {
        return Ok(());
    }
    let blind = camera.blind_share();
    match blind <= MOST_BLIND {
        true => Ok(()),
        false => Err(format!(
            "camera `{id}`: its lens folds inside its image: {:.0} % of it has no line of sight, at most \
             {:.0} % expected; check the coefficients of `distortion`, their order and the image size, or give \
             `max_angle_deg` (`rig import --max-angle`) if it images no more",
            100.0 * blind,
            100.0 * MOST_BLIND
        )),
    }
}
