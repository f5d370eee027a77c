//! What a file says of its cameras, before what it leaves open is filled in and all is checked.

use mvtop_geometry::{Camera, Intrinsics, Rig, transform};
use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::lens::{Lens, Plane};
use crate::node::{Node, Rows4};
use crate::{Checked, Direction, Options};

/// How far a principal point lies from the middle of images that are not cropped, shares of a side.
const MOST_OFF_MIDDLE: f64 = 0.25;

/// A principal point farther from the middle of its image is implausible, share of a side, where the other
/// order of the sides puts it at most half as far.
const OFF_ORDER: f64 = 0.1;

/// Sizes of other images that a calibration may be of, as shares of the stated size.
const SCALES: [f64; 8] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0, 4.0];
/// How far from the middle of such images a principal point is at most, share of a side.
const NEAR_MIDDLE: f64 = 0.03;
/// Shortest focal length of flat images, share of the longer side: of 157 degrees.
const LEAST_FOCAL: f64 = 0.1;
/// Largest difference of two numbers that are the same, as a share.
const SAME_NUMBER: f64 = 1e-3;

/// A rig as a file has it.
pub struct Draft {
    pub cameras: Vec<DraftCamera>,
    /// Metres per unit of the file's lengths, where the format says it.
    pub metres: Option<f64>,
    /// What to do about cameras without a pose.
    pub posing: &'static str,
    pub notes: Vec<String>,
}

/// A camera as a file has it.
#[derive(Clone, PartialEq)]
pub struct DraftCamera {
    pub id: String,
    pub size: Option<[u32; 2]>,
    pub plane: Plane,
    pub lens: Lens,
    pub pose: Option<Pose>,
}

/// Where a camera is, in the file's unit.
#[derive(Clone, PartialEq)]
pub struct Pose {
    pub transform: Isometry3<f64>,
    /// `None` where the file does not say.
    pub direction: Option<Direction>,
}

impl Pose {
    pub fn world_from_cam(transform: Isometry3<f64>) -> Self {
        Self {
            transform,
            direction: Some(Direction::WorldFromCam),
        }
    }

    pub fn cam_from_world(transform: Isometry3<f64>) -> Self {
        Self {
            transform,
            direction: Some(Direction::CamFromWorld),
        }
    }
}

impl Draft {
    /// The rig.
    pub fn finish(self, options: &Options) -> Checked<(Rig, Vec<String>)> {
        let mut notes = self.notes;
        let moved = |camera: &DraftCamera| {
            let t = camera
                .pose
                .as_ref()
                .map(|pose| pose.transform.translation.vector);
            t.is_some_and(|t| t != Vector3::zeros())
        };
        let metres = match options.metres().or(self.metres) {
            Some(metres) => metres,
            None if self.cameras.iter().any(moved) => {
                return Err(
                    "the file does not say its unit of length; give `unit` (--unit m, cm or mm) or \
                     `scale` (--scale METRES, metres per unit of the file)"
                        .into(),
                );
            }
            None => 1.0,
        };
        for id in options
            .image_sizes
            .iter()
            .filter_map(|size| size.camera.as_ref())
        {
            if !self.cameras.iter().any(|camera| camera.id == *id) {
                let ids: Vec<_> = self
                    .cameras
                    .iter()
                    .map(|camera| camera.id.as_str())
                    .collect();
                let ids = ids.join(", ");
                return Err(format!(
                    "`image_size` (--image-size) names `{id}`, but the cameras are {ids}"
                ));
            }
        }
        let alone = self.cameras.len() == 1;
        let mut cameras = Vec::new();
        for camera in self.cameras {
            let id = camera.id;
            let of = |problem: String| format!("camera `{id}`: {problem}");
            let size = image_size(&id, camera.size, options).map_err(of)?;
            let lens = camera
                .lens
                .intrinsics(&camera.plane, size, options.max_angle);
            let (intrinsics, fitted) = lens.map_err(of)?;
            notes.extend(fitted.map(of));
            let confirmed = options.size_of(&id) == Some(size);
            plausible(&camera.plane, &camera.lens, size, confirmed).map_err(of)?;
            notes.extend(off_middle(&intrinsics, size).map(of));
            let mut world_from_cam = match camera.pose {
                Some(pose) => directed(&pose, options).map_err(of)?,
                None if alone => Isometry3::identity(),
                None => return Err(of(format!("its place is missing; {}", self.posing))),
            };
            world_from_cam.translation.vector *= metres;
            let camera = Camera::new(&id, size, intrinsics, world_from_cam)
                .map_err(|error| error.to_string())?;
            cameras.push(camera);
        }
        let rig = Rig::new(cameras, 0).map_err(|error| error.to_string())?;
        let warnings = rig.warnings().into_iter();
        notes.extend(warnings.map(|warning| format!("warning: {warning}")));
        let refuse = |error| {
            format!(
                "{error} (--trust-unit); check `unit` (--unit) or `scale` (--scale), {metres} m per unit \
                 here"
            )
        };
        match rig.check_spread() {
            Err(error) if !options.trust_unit => Err(refuse(error)),
            _ => Ok((rig, notes)),
        }
    }
}

/// Refuses a number that is there twice and different.
pub fn same_number(what: &str, other: Option<f64>, there: f64) -> Checked<()> {
    match other {
        Some(other) if (other - there).abs() > SAME_NUMBER * there.abs().max(1.0) => Err(format!(
            "{what} is there twice and different, {other} and {there}; leave the wrong one out"
        )),
        _ => Ok(()),
    }
}

/// Refuses intrinsics of images of another size, and focal lengths in mm.
///
/// - `confirmed`: whether the size was given, not only stated
fn plausible(plane: &Plane, lens: &Lens, [w, h]: [u32; 2], confirmed: bool) -> Checked<()> {
    let flat = matches!(lens, Lens::Native(projection) if projection.family() == "pinhole");
    let narrow = plane.fx.max(plane.fy) / f64::from(w.max(h));
    if flat && narrow < LEAST_FOCAL {
        return Err(format!(
            "its focal length of {:.4} px is too short for flat images of {w}x{h} px; give it in px, not in mm",
            plane.fx.max(plane.fy)
        ));
    }
    if confirmed {
        return Ok(());
    }
    let [x, y] = [plane.cx / f64::from(w), plane.cy / f64::from(h)];
    let near = |share: &&f64| {
        [x, y]
            .iter()
            .all(|side| (side / **share - 0.5).abs() < NEAR_MIDDLE)
    };
    let off = |w: u32, h: u32| {
        let side = |center: f64, side: u32| (center / f64::from(side) - 0.5).abs();
        side(plane.cx, w).max(side(plane.cy, h))
    };
    let of_what = match SCALES.iter().find(near) {
        Some(scale) => format!("images of {scale:.2} times its size"),
        None if off(w, h) > OFF_ORDER && off(h, w) < off(w, h) / 2.0 => {
            format!("images of {h}x{w} px")
        }
        None => return Ok(()),
    };
    Err(format!(
        "its principal point, {:.0} {:.0}, is in the middle of {of_what}, not of {w}x{h} px; calibrate at the size of \
         the images that are used, or, if that is it, confirm it as `image_size` (--image-size {w}x{h})",
        plane.cx, plane.cy
    ))
}

/// Of a crop the principal point is where it may; else the size is that of other images.
fn off_middle(intrinsics: &Intrinsics, size: [u32; 2]) -> Option<String> {
    let center = [intrinsics.cx(), intrinsics.cy()];
    let off = center.iter().zip(size).any(|(center, side)| {
        let side = f64::from(side);
        (center - (side - 1.0) / 2.0).abs() > MOST_OFF_MIDDLE * side
    });
    let ([cx, cy], [width, height]) = (center, size);
    off.then(|| {
        format!(
            "warning: its principal point, {cx:.0} {cy:.0}, lies far from the middle of images of \
             {width}x{height} px; is that their size when it was calibrated?"
        )
    })
}

fn image_size(id: &str, said: Option<[u32; 2]>, options: &Options) -> Checked<[u32; 2]> {
    match (said, options.size_of(id)) {
        (Some([w, h]), Some([width, height])) if [w, h] != [width, height] => Err(format!(
            "the file says {w}x{h} px, `image_size` (--image-size) {width}x{height}; leave one out, \
             and calibrate at the size of the images that are used"
        )),
        (Some(size), _) | (None, Some(size)) => Ok(size),
        (None, None) => Err(
            "the file does not say the size of its images; give `image_size` (--image-size WxH, or \
             ID=WxH for each camera)"
                .into(),
        ),
    }
}

/// Width and height, px, of two sides in a list.
///
/// - `rows_first`: whether rows come before columns by the key's name; `None` where programs differ
///
/// # Errors
/// Where the principal point speaks against the order, unless `image_size` says one of the two.
pub fn ordered_size(
    id: &str,
    key: &str,
    rows_first: Option<bool>,
    [a, b]: [u32; 2],
    plane: &Plane,
    options: &Options,
) -> Checked<[u32; 2]> {
    let off = |[w, h]: [u32; 2]| {
        let side = |center: f64, side: u32| (center / f64::from(side) - 0.5).abs();
        side(plane.cx, w).max(side(plane.cy, h))
    };
    let [columns, rows] = [[a, b], [b, a]];
    let out = |this, other| off(this) > OFF_ORDER && off(other) < off(this) / 2.0;
    let read = match rows_first {
        _ if a == b => Some(columns),
        Some(true) if !out(rows, columns) => Some(rows),
        Some(false) if !out(columns, rows) => Some(columns),
        None if out(rows, columns) => Some(columns),
        None if out(columns, rows) => Some(rows),
        _ => None,
    };
    let asked = || {
        options
            .size_of(id)
            .filter(|size| [columns, rows].contains(size))
    };
    read.or_else(asked).ok_or_else(|| {
        format!(
            "camera `{id}`: `{key}` of {a} and {b} px may be rows and columns or width and height, and the \
             principal point, {:.0} {:.0}, does not agree with one of them; give `image_size` (--image-size WxH)",
            plane.cx, plane.cy
        )
    })
}

/// Refuses a region of interest, as a list (x, y, width, height) or an object, that is not the whole image; all zeros
/// are ROS' whole image.
pub fn whole_image(roi: &Node, size: [u32; 2]) -> Checked<()> {
    const KEYS: [&[&str]; 4] = [
        &["x_offset", "x", "left"],
        &["y_offset", "y", "top"],
        &["width"],
        &["height"],
    ];
    let mut sides = [0.0; 4];
    let mut known = true;
    if roi.value.is_object() && !roi.has("data") {
        for (key, node) in roi.entries() {
            match KEYS.iter().position(|keys| keys.contains(&key)) {
                Some(index) => sides[index] = node.number()?,
                // Such as ROS' `do_rectify`.
                None => known &= node.value.is_boolean(),
            }
        }
    } else {
        sides = roi.vector()?;
    }
    let [x, y, width, height] = sides;
    let whole = [[0.0; 2], size.map(f64::from)].contains(&[width, height]);
    match known && whole && [x, y] == [0.0; 2] {
        true => Ok(()),
        false => Err(roi.wrong("the whole image; calibrate with the region that is used")),
    }
}

pub fn directed(pose: &Pose, options: &Options) -> Checked<Isometry3<f64>> {
    match (pose.direction, options.direction) {
        (Some(said), Some(asked)) if said != asked => Err(
            "the format says what its poses map to what, and it is not what `direction` \
             (--direction) says; leave that out"
                .into(),
        ),
        (None, None) => Err(
            "the file does not say what its pose maps to what; give `direction` (--direction \
             world_from_cam for the pose of the camera in the world, or cam_from_world for the \
             inverse, OpenCV's R and t)"
                .into(),
        ),
        (Some(direction), _) | (None, Some(direction)) => Ok(match direction {
            Direction::WorldFromCam => pose.transform,
            Direction::CamFromWorld => pose.transform.inverse(),
        }),
    }
}

/// An id that can be part of a file name.
pub fn id(name: &str) -> String {
    let usable = |c: char| c.is_alphanumeric() || "._-".contains(c);
    let name: String = name
        .chars()
        .take(80)
        .map(|c| if usable(c) { c } else { '_' })
        .collect();
    let name = name.trim_start_matches(['.', '-', '_']);
    match name {
        "" => "camera".into(),
        name => name.to_owned(),
    }
}

/// A rigid transform of a homogeneous matrix, in the file's unit.
pub fn rigid(place: &str, rows: &Rows4) -> Checked<Isometry3<f64>> {
    transform::from_matrix(rows).map_err(|error| format!("{place}: {error}"))
}

/// The same of a rotation, its rows one after the other, and a translation.
pub fn rotation_and_translation(place: &str, r: &[f64; 9], t: [f64; 3]) -> Checked<Isometry3<f64>> {
    let rows = std::array::from_fn(|row| std::array::from_fn(|column| r[3 * row + column]));
    transform::from_rotation(&rows, t).map_err(|error| format!("{place}: {error}"))
}

/// Half a turn about x: from OpenGL's camera axes (y up, z backward) to OpenCV's (y down, z forward).
pub fn opencv_from_opengl() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))
}
