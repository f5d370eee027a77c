//! What a model of projection is, and the enum of those that `camera.rs` lists.

use nalgebra::{Point2, Point3, Vector3};

use super::intrinsics::finite;
use super::{MODELS, Projection};
use crate::{Error, Result};

/// How rays meet the image plane of unit focal length, before `(fx, fy, cx, cy)`.
///
/// A camera has a family (`model` in rig files: "pinhole", "fisheye") and, within it, a distortion of
/// some name with its coefficients.
pub trait ProjectionModel: Sized {
    /// The family.
    const FAMILY: &'static str;
    /// Name of the distortion.
    const NAME: &'static str;
    /// Names of its coefficients, in OpenCV's order.
    const PARAMS: &'static [&'static str];
    /// How many of them may be given; the others are 0.
    const COUNTS: &'static [usize];

    /// From finite coefficients; missing ones are 0.
    fn from_finite(params: &[f64]) -> Self;

    /// All coefficients, 0 where fewer were given.
    fn params(&self) -> &[f64];

    /// Where a point of the camera frame is imaged, in focal lengths from the principal point; `None`
    /// for one that cannot be imaged.
    fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>>;

    /// Direction of the ray that is imaged there, of any length; `None` where there is none.
    fn unproject(&self, image: &Point2<f64>) -> Option<Vector3<f64>>;

    /// From the first [`ProjectionModel::COUNTS`] coefficients.
    ///
    /// # Errors
    /// [`Error::Camera`] for another number of coefficients, or one that is not finite.
    fn new(params: &[f64]) -> Result<Self> {
        if !Self::COUNTS.contains(&params.len()) {
            let counts: Vec<_> = Self::COUNTS.iter().map(usize::to_string).collect();
            return Err(Error::Camera(format!(
                "{} takes {} coefficients ({}), got {}",
                Self::NAME,
                either(counts),
                Self::PARAMS.join(" "),
                params.len()
            )));
        }
        if let Some(bad) = params.iter().find(|p| !p.is_finite()) {
            return Err(Error::Camera(format!(
                "{} coefficients must be finite, got {bad}",
                Self::NAME
            )));
        }
        Ok(Self::from_finite(params))
    }
}

/// A registered model, by its names.
pub(super) struct Registered {
    pub family: &'static str,
    pub distortion: &'static str,
    pub counts: &'static [usize],
    pub new: fn(&[f64]) -> Result<Projection>,
    pub undistorted: fn() -> Projection,
}

/// `file: Model` declares the file, makes the variant and knows the model by its names.
macro_rules! projections {
    ($($file:ident: $model:ident),+ $(,)?) => {
        $(
            mod $file;
            pub use $file::$model;
        )+

        /// Between rays and the image plane of unit focal length.
        #[derive(Debug, Clone, PartialEq)]
        pub enum Projection {
            /// An ideal pinhole.
            Pinhole,
            $(
                #[doc = concat!("[`", stringify!($model), "`]")]
                $model($model),
            )+
        }

        const MODELS: &[projection::Registered] = &[$(projection::Registered {
            family: $model::FAMILY,
            distortion: $model::NAME,
            counts: $model::COUNTS,
            new: |params| $model::new(params).map(Projection::$model),
            undistorted: || Projection::$model($model::from_finite(&[])),
        }),+];

        impl Projection {
            /// Family and distortion of every model, in the order of registration.
            pub const NAMES: &[(&str, &str)] = &[$(($model::FAMILY, $model::NAME)),+];

            /// Family of the model, "pinhole" or "fisheye".
            pub fn family(&self) -> &'static str {
                match self {
                    Self::Pinhole => projection::PINHOLE,
                    $(Self::$model(_) => $model::FAMILY,)+
                }
            }

            /// Name of the distortion, as "brown_conrady"; `None` for an ideal pinhole.
            pub fn distortion(&self) -> Option<&'static str> {
                match self {
                    Self::Pinhole => None,
                    $(Self::$model(_) => Some($model::NAME),)+
                }
            }

            /// All coefficients, in OpenCV's order; none for an ideal pinhole.
            pub fn params(&self) -> &[f64] {
                match self {
                    Self::Pinhole => &[],
                    $(Self::$model(model) => model.params(),)+
                }
            }

            /// Where a point of the camera frame is imaged, in focal lengths from the principal
            /// point; `None` for one that cannot be imaged.
            #[inline]
            pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
                match self {
                    Self::Pinhole => projection::on_plane(point),
                    $(Self::$model(model) => model.project(point),)+
                }
            }

            /// Direction of the ray that is imaged there, of any length; `None` where there is none.
            pub fn unproject(&self, image: &Point2<f64>) -> Option<Vector3<f64>> {
                match self {
                    Self::Pinhole => Some(image.coords.push(1.0)),
                    $(Self::$model(model) => model.unproject(image),)+
                }
            }
        }
    };
}

/// The family that is nothing but a pinhole where it has no distortion.
pub(super) const PINHOLE: &str = "pinhole";

impl Projection {
    /// The projection of that name, with these coefficients.
    ///
    /// - `family`: "pinhole" or "fisheye"
    /// - `distortion`: its name; `None` for the family's model that takes as many coefficients
    /// - `params`: in OpenCV's order; where `distortion` is `None`, any number of zeros, also none, is no
    ///   distortion
    /// - returns: [`Projection::Pinhole`] for a pinhole whose coefficients are all 0
    ///
    /// # Errors
    /// [`Error::Camera`] for names that are not known or do not belong together, another number of
    /// coefficients, or one that is not finite.
    pub fn from_params(family: &str, distortion: Option<&str>, params: &[f64]) -> Result<Self> {
        let mut alike = MODELS.iter().filter(|model| model.family == family);
        let Some(first) = alike.clone().next() else {
            return Err(Error::Camera(format!(
                "`model` must be {}, got {family:?}",
                either(quoted(families()))
            )));
        };
        let projection = match distortion {
            None if params.iter().all(|&p| p == 0.0) => (first.undistorted)(),
            None => {
                let fitting = alike.find(|model| model.counts.contains(&params.len()));
                (fitting.unwrap_or(first).new)(params)?
            }
            Some(name) => match MODELS.iter().find(|model| model.distortion == name) {
                Some(model) if model.family == family => (model.new)(params)?,
                Some(other) => {
                    return Err(Error::Camera(format!(
                        "the distortion {name} needs `model` {:?}, got {family:?}",
                        other.family
                    )));
                }
                None => {
                    return Err(Error::Camera(format!(
                        "the distortion's `model` must be {}, got {name:?}",
                        either(quoted(distortions()))
                    )));
                }
            },
        };
        Ok(projection.simplest())
    }

    /// A pinhole without distortion is a pinhole.
    pub(super) fn simplest(self) -> Self {
        match self.family() == PINHOLE && self.params().iter().all(|&p| p == 0.0) {
            true => Self::Pinhole,
            false => self,
        }
    }
}

/// All families, in the order of registration.
pub(crate) fn families() -> Vec<&'static str> {
    let mut families: Vec<_> = Projection::NAMES.iter().map(|names| names.0).collect();
    families.dedup();
    families
}

/// Names of all distortions, in the order of registration.
pub(crate) fn distortions() -> Vec<&'static str> {
    Projection::NAMES.iter().map(|names| names.1).collect()
}

fn quoted(names: Vec<&str>) -> Vec<String> {
    names.iter().map(|name| format!("{name:?}")).collect()
}

/// The first coefficients, 0 where there are no more.
pub(super) fn padded<const N: usize>(params: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| params.get(i).copied().unwrap_or(0.0))
}

/// `a, b or c`
fn either(names: Vec<String>) -> String {
    match names.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => names.concat(),
    }
}

/// The point on the plane z = 1, `None` unless it lies in front of the camera.
#[inline]
pub(super) fn on_plane(point: &Point3<f64>) -> Option<Point2<f64>> {
    let on_plane = (point.z > 0.0).then(|| Point2::new(point.x / point.z, point.y / point.z));
    on_plane.and_then(finite)
}
