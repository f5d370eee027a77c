//! A calibrated camera: its intrinsics, between points and pixels, and its place in the world.
//!
//! Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centers, the
//! top-left one at (0, 0).

mod intrinsics;
#[macro_use]
pub(crate) mod projection;
mod radial;

use nalgebra::{Isometry3, Point2, Point3, Vector3};

pub use intrinsics::{Branchless, Intrinsics};
pub use projection::ProjectionModel;

use crate::{Error, Result, transform};

// Every model of projection: its file and its type.
projections! {
    brown_conrady: BrownConrady,
    kannala_brandt: KannalaBrandt,
}

/// Longest image side, px: far above real cameras, low enough to bound memory.
const LONGEST_SIDE: u32 = 20_000;
/// Columns and rows of pixels that stand for the image's area.
const BLIND_GRID: [u32; 2] = [40, 30];
/// Longest id, bytes; ids become parts of file names.
const LONGEST_ID: usize = 100;

/// One camera of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    id: String,
    width: u32,
    height: u32,
    intrinsics: Intrinsics,
    world_from_cam: Isometry3<f64>,
}

impl Camera {
    /// A camera whose every value is believable.
    ///
    /// - `id`: letters, digits, `_`, `-` and `.`, as it becomes part of file names
    /// - `[width, height]`: size of its images, px
    /// - `world_from_cam`: camera frame to world frame, metres
    ///
    /// # Errors
    /// [`Error::Camera`] for an id that is no part of a file name, a side that is not 1 to 20000 px,
    /// a focal length below a hundredth of the image's side, a principal point more than one image
    /// size outside the image, or a pose that is not finite, not of unit rotation or too far away.
    ///
    /// ```
    /// use mvtop_geometry::camera::{Camera, Intrinsics, Projection};
    /// use nalgebra::{Isometry3, Point3};
    ///
    /// let intrinsics = Intrinsics::new(500.0, 510.0, 320.0, 240.0, Projection::Pinhole)?;
    /// let camera = Camera::new("left", [640, 480], intrinsics, Isometry3::identity())?;
    /// let pixel = camera.intrinsics().project(&Point3::new(0.1, -0.2, 2.0)).expect("in front");
    /// assert_eq!([pixel.x, pixel.y], [345.0, 189.0]);
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn new(
        id: impl Into<String>,
        [width, height]: [u32; 2],
        intrinsics: Intrinsics,
        world_from_cam: Isometry3<f64>,
    ) -> Result<Self> {
        let id = id.into();
        if let Some(problem) = id_problem(&id) {
            return Err(Error::Camera(format!("camera: {problem}")));
        }
        let pose =
            || transform::check(&world_from_cam).map_err(|cause| format!("its pose: {cause}"));
        side("width", width)
            .and_then(|()| side("height", height))
            .and_then(|()| intrinsics.check_size(width, height))
            .and_then(|()| pose())
            .map_err(|problem| Error::Camera(format!("camera `{id}`: {problem}")))?;
        Ok(Self {
            id,
            width,
            height,
            intrinsics,
            world_from_cam,
        })
    }

    /// Its name, unique in a rig and usable in file names.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Image width, px.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Image height, px.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Between points of the camera frame and pixels.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Camera frame to world frame, metres.
    pub fn world_from_cam(&self) -> &Isometry3<f64> {
        &self.world_from_cam
    }

    /// Share of the image without a line of sight, 0 to 1: where the lens folds the image back, and beyond
    /// the greatest angle at which it images anything.
    ///
    /// ```
    /// use mvtop_geometry::camera::{Camera, Intrinsics, Projection};
    /// use nalgebra::Isometry3;
    ///
    /// // r (1 - 0.9 r²) turns back at r = 0.61, which is 0.41 focal lengths from the middle of the image.
    /// let folding = Projection::from_params("pinhole", None, &[-0.9, 0.0, 0.0, 0.0])?;
    /// let lens = Intrinsics::new(400.0, 400.0, 319.5, 239.5, folding)?;
    /// let camera = Camera::new("left", [640, 480], lens, Isometry3::identity())?;
    /// assert!((camera.blind_share() - 0.73).abs() < 0.01);
    /// # Ok::<(), mvtop_geometry::Error>(())
    /// ```
    pub fn blind_share(&self) -> f64 {
        let [columns, rows] = BLIND_GRID;
        let at = |index: u32, of: u32, side: u32| {
            (f64::from(index) + 0.5) / f64::from(of) * f64::from(side) - 0.5
        };
        let pixels = (0..columns * rows).map(|i| {
            let x = at(i % columns, columns, self.width);
            Point2::new(x, at(i / columns, rows, self.height))
        });
        let blind = pixels.filter(|pixel| self.intrinsics.unproject(pixel).is_none());
        blind.count() as f64 / f64::from(columns * rows)
    }

    /// The same camera at another place.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn moved_to(&self, world_from_cam: Isometry3<f64>) -> Result<Self> {
        let (size, intrinsics) = ([self.width, self.height], self.intrinsics.clone());
        Self::new(self.id.as_str(), size, intrinsics, world_from_cam)
    }
}

/// What is wrong with an id, if anything.
pub(crate) fn id_problem(id: &str) -> Option<String> {
    let usable = |c: char| c.is_alphanumeric() || "._-".contains(c);
    let problem = if id.is_empty() {
        "is empty".to_owned()
    } else if id.len() > LONGEST_ID {
        format!("is longer than {LONGEST_ID} bytes")
    } else if !id.chars().all(usable) || id.starts_with(['.', '-']) {
        "cannot be part of a file name; use letters, digits, `_`, `-` and `.`, starting with a \
         letter, a digit or `_`"
            .to_owned()
    } else {
        return None;
    };
    let id: String = id.chars().take(LONGEST_ID).collect();
    Some(format!("the id {id:?} {problem}"))
}

fn side(key: &str, side: u32) -> Result<(), String> {
    match side {
        1..=LONGEST_SIDE => Ok(()),
        _ => Err(side_problem(key, &side.to_string())),
    }
}

pub(crate) fn side_problem(key: &str, got: &str) -> String {
    format!("`{key}` must be a whole number of pixels from 1 to {LONGEST_SIDE}, got {got}")
}
