//! Boxes in images.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// Boxes that are thinner than this carry no direction worth reading.
const MIN_SIDE_PX: f64 = 1.0;

/// A box in an image, px: its left, top, right and bottom side.
///
/// Integers are pixel centers, so an image spans `[-0.5, width - 0.5]` by `[-0.5, height - 0.5]`. In
/// JSON a box is `[x0, y0, x1, y1]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(from = "[f64; 4]", into = "[f64; 4]")]
pub struct BBox {
    /// Left side.
    pub x0: f64,
    /// Top side.
    pub y0: f64,
    /// Right side.
    pub x1: f64,
    /// Bottom side.
    pub y1: f64,
}

impl BBox {
    /// The least one around some points; `None` where one is not known, or there are none.
    pub fn around(points: impl Iterator<Item = Option<Point2<f64>>>) -> Option<Self> {
        let mut all: Option<Self> = None;
        for point in points {
            let at = point?;
            let (x, y) = (at.x, at.y);
            let Self { x0, y0, x1, y1 } = all.unwrap_or([x, y, x, y].into());
            all = Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)].into());
        }
        all
    }

    /// The middle of the box.
    pub fn center(&self) -> Point2<f64> {
        Point2::new((self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0)
    }

    /// From the left to the right side, px.
    pub fn width(&self) -> f64 {
        self.x1 - self.x0
    }

    /// From the top to the bottom side, px.
    pub fn height(&self) -> f64 {
        self.y1 - self.y0
    }

    /// Larger or smaller by a factor, about its middle.
    pub fn scaled(&self, factor: f64) -> Self {
        let (center, width, height) = (self.center(), self.width(), self.height());
        Self {
            x0: center.x - factor * width / 2.0,
            y0: center.y - factor * height / 2.0,
            x1: center.x + factor * width / 2.0,
            y1: center.y + factor * height / 2.0,
        }
    }

    /// The part within an image of `width` by `height` px; `None` where less than a pixel a side is
    /// left, or a side is not a number.
    pub fn clip(&self, width: u32, height: u32) -> Option<Self> {
        let (right, bottom) = (f64::from(width) - 0.5, f64::from(height) - 0.5);
        let clipped = Self {
            x0: self.x0.clamp(-0.5, right),
            y0: self.y0.clamp(-0.5, bottom),
            x1: self.x1.clamp(-0.5, right),
            y1: self.y1.clamp(-0.5, bottom),
        };
        let large_enough = clipped.width() >= MIN_SIDE_PX && clipped.height() >= MIN_SIDE_PX;
        large_enough.then_some(clipped)
    }

    /// Whether its sides are finite and in order.
    pub fn is_proper(&self) -> bool {
        <[f64; 4]>::from(*self).iter().all(|side| side.is_finite())
            && self.x0 < self.x1
            && self.y0 < self.y1
    }

    /// Intersection over union: the area shared by two boxes over the area they cover together, 0
    /// to 1.
    pub fn iou(&self, other: &Self) -> f64 {
        let area = |b: &Self| b.width().max(0.0) * b.height().max(0.0);
        let shared = area(&Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        });
        let covered = area(self) + area(other) - shared;
        if covered > 0.0 { shared / covered } else { 0.0 }
    }
}

impl From<[f64; 4]> for BBox {
    fn from([x0, y0, x1, y1]: [f64; 4]) -> Self {
        Self { x0, y0, x1, y1 }
    }
}

impl From<BBox> for [f64; 4] {
    fn from(BBox { x0, y0, x1, y1 }: BBox) -> Self {
        [x0, y0, x1, y1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clip(sides: [f64; 4], width: u32, height: u32) -> Option<[f64; 4]> {
        BBox::from(sides).clip(width, height).map(Into::into)
    }

    #[test]
    fn iou_of_half_shifted_squares_is_one_third() {
        let iou = |a: [f64; 4], b: [f64; 4]| BBox::from(a).iou(&b.into());
        let shifted = iou([0., 0., 2., 2.], [1., 0., 3., 2.]);
        assert!((shifted - 1. / 3.).abs() < 1e-12);
        assert_eq!(iou([0., 0., 2., 2.], [2., 0., 4., 2.]), 0.0);
        assert_eq!(iou([0., 0., 0., 0.], [0., 0., 0., 0.]), 0.0);
    }

    #[test]
    fn clip_keeps_the_part_inside_the_image() {
        assert_eq!(clip([-9., 2., 5., 99.], 10, 8), Some([-0.5, 2., 5., 7.5]));
        assert_eq!(clip([20., 2., 30., 5.], 10, 8), None);
        assert_eq!(clip([f64::NAN, 2., 5., 6.], 10, 8), None);
        assert_eq!(clip([3., 2., 3.4, 6.], 10, 8), None);
    }

    #[test]
    fn json_is_a_list_of_four() {
        let bbox = BBox::from([1.0, 2.0, 3.5, 4.0]);
        let json = serde_json::to_string(&bbox).unwrap();
        assert_eq!(json, "[1.0,2.0,3.5,4.0]");
        assert_eq!(serde_json::from_str::<BBox>(&json).unwrap(), bbox);
        assert!(serde_json::from_str::<BBox>("[1, 2, 3]").is_err());
    }
}
