//! Lines of sight: as numbers of a line, and of a box.

use nalgebra::{Isometry3, Point2, Vector3};
use serde::{Deserialize, Serialize};

use crate::BBox;
use crate::camera::Camera;

/// Enlarges the half widths of a box's lines of sight towards the size of its other numbers.
const EXTENT_SCALE: f64 = 10.0;

/// What a line of sight is encoded as: unit direction `d`, origin `o` (metres), moment `d x o`.
///
/// The moment has the sign that the MVTOP paper prints, the opposite of the textbooks' `o x d`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LosEncoding {
    /// `[d]`
    Direction,
    /// `[o, d]`
    OriginDirection,
    /// `[d, d x o]`
    Plucker,
    /// `[d, d x o, o]`
    PluckerOrigin,
}

impl LosEncoding {
    /// Every encoding.
    pub const ALL: [Self; 4] = [
        Self::Direction,
        Self::OriginDirection,
        Self::Plucker,
        Self::PluckerOrigin,
    ];

    /// Numbers per line of sight.
    pub fn width(self) -> usize {
        match self {
            Self::Direction => 3,
            Self::OriginDirection | Self::Plucker => 6,
            Self::PluckerOrigin => 9,
        }
    }

    /// The numbers of the line through `o` (metres) along the unit vector `d`: of the nine the first
    /// [`LosEncoding::width`], the others are 0.
    ///
    /// ```
    /// use mvtop_geometry::rays::LosEncoding;
    /// use nalgebra::Vector3;
    ///
    /// // A camera one metre along x that looks along z.
    /// let line = LosEncoding::Plucker.line(&Vector3::z(), &Vector3::x());
    /// assert_eq!(line, [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    /// ```
    pub fn line(self, d: &Vector3<f32>, o: &Vector3<f32>) -> [f32; 9] {
        let m = d.cross(o);
        let none = Vector3::zeros();
        let parts = match self {
            Self::Direction => [d, &none, &none],
            Self::OriginDirection => [o, d, &none],
            Self::Plucker => [d, &m, &none],
            Self::PluckerOrigin => [d, &m, o],
        };
        std::array::from_fn(|i| parts[i / 3][i % 3])
    }
}

/// Lines of sight of a box, in its camera's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxRays {
    /// Unit direction through the box's center, `ray(xc, yc)`.
    pub center: Vector3<f64>,
    /// Half the way from the left side's direction to the right one's,
    /// `(ray(x1, yc) - ray(x0, yc)) / 2`.
    pub half_x: Vector3<f64>,
    /// The same from the top to the bottom side, `(ray(xc, y1) - ray(xc, y0)) / 2`.
    pub half_y: Vector3<f64>,
}

impl BoxRays {
    /// Of a box in the camera's image; `None` where one of its pixels has no ray.
    pub fn new(camera: &Camera, bbox: BBox) -> Option<Self> {
        let ray = |u, v| {
            let ray = camera.intrinsics().unproject(&Point2::new(u, v))?;
            Some(ray.into_inner())
        };
        let (BBox { x0, y0, x1, y1 }, center) = (bbox, bbox.center());
        Some(Self {
            center: ray(center.x, center.y)?,
            half_x: (ray(x1, center.y)? - ray(x0, center.y)?) / 2.0,
            half_y: (ray(center.x, y1)? - ray(center.x, y0)?) / 2.0,
        })
    }

    /// What the network is told of the box: `[o, d, 10 e_x, 10 e_y]`, camera center (metres), center
    /// direction and half widths, in the reference camera's frame.
    pub fn encode(&self, ref_from_cam: &Isometry3<f64>) -> [f32; 12] {
        let turn = &ref_from_cam.rotation;
        let parts = [
            ref_from_cam.translation.vector,
            turn * self.center,
            turn * self.half_x * EXTENT_SCALE,
            turn * self.half_y * EXTENT_SCALE,
        ];
        std::array::from_fn(|i| parts[i / 3][i % 3] as f32)
    }
}
