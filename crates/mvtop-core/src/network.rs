//! The network's parts as the estimator sees them: images to boxes; pictures to object coordinates, or
//! to memory, and queries of it to poses.

pub(crate) mod cached;
#[cfg(feature = "onnx")]
mod graphs;

use ndarray::{Array1, Array2, Array3, Array4, ArrayView3, ArrayView4};

#[cfg(feature = "onnx")]
pub(crate) use self::graphs::OnnxNetwork;
use crate::{Error, Result};

/// What runs the network. [`crate::Estimator`] needs no more of it than this.
pub trait Network: Send + Sync {
    /// Backbone and detector, once for all images together.
    ///
    /// - `images`: `[V, 3, Hn, Wn]`, normalised
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps>;

    /// Backbone and encoder, once for some close-ups together, of bundles with a decoder.
    ///
    /// - `pictures`: `[P, 3, S, S]`, normalised, from [`crate::closeup::CloseUp::picture`]
    /// - `camera_rays`: `[P, N, 3]`, of their feature cells, from
    ///   [`crate::closeup::CloseUp::camera_rays`]
    /// - returns: the memory, `[P, N, C]`
    fn encode(
        &self,
        _pictures: ArrayView4<f32>,
        _camera_rays: ArrayView3<f32>,
    ) -> Result<Array3<f32>> {
        Err(without("encoder"))
    }

    /// The place of the object that each cell of a close-up shows, of bundles without a decoder.
    ///
    /// - `pictures`: `[P, 3, S, S]`, as in [`Network::encode`]
    /// - returns: `[P, 4, h, w]`: the place, object frame, in units of
    ///   [`crate::bundle::Class::coordinates_extent_m`], and how far it can be trusted, 0 to 1. Of
    ///   poses that look alike, it is in the frame of the one most upright in the close-up
    fn coordinates(&self, _pictures: ArrayView4<f32>) -> Result<Array4<f32>> {
        Err(without("object coordinates"))
    }

    /// The pose decoder, for objects that share an anchor: the view that comes first.
    ///
    /// - `memory`: `[V, N, C]`, of the views' pictures
    fn decode(&self, _memory: ArrayView3<f32>, _queries: &Queries) -> Result<Decoded> {
        Err(without("decoder"))
    }

    /// Whether [`Network::detect`] takes images of any size that its strides divide.
    fn takes_any_size(&self) -> bool {
        false
    }

    /// What executes the dense layers, for example `cpu`.
    fn provider(&self) -> &str;
}

fn without(part: &str) -> Error {
    Error::Pose(format!(
        "network: expected one with {part}, got one without"
    ))
}

/// The detector's maps, per cell of its finest level.
#[derive(Debug, Clone)]
pub struct DetectorMaps {
    /// `[V, classes, h, w]`, 0 to 1
    pub scores: Array4<f32>,
    /// `[V, 4, h, w]`, x0 y0 x1 y1, px of the network's input
    pub boxes: Array4<f32>,
}

/// Objects to decode and where each view sees them; everything in the frame of view 0.
#[derive(Debug, Clone)]
pub struct Queries {
    /// `[V, N, R]`, from [`crate::rays::encode`]
    pub rays: Array3<f32>,
    /// `[V, Q, 2]`, box centers over the network's input, 0 to 1; 0.5 where not detected
    pub centers: Array3<f32>,
    /// `[V, Q, 2]`, half the boxes' sides over the input's; 0 where not detected
    pub half_sizes: Array3<f32>,
    /// `[V, Q, 12]`, from [`crate::rays::BoxRays::encode`]; 0 where not detected
    pub box_rays: Array3<f32>,
    /// `[V, Q]`, 1 where detected, else 0
    pub valid: Array2<f32>,
    /// `[Q]`, indices into the bundle's classes
    pub class_index: Array1<i64>,
}

/// Poses in the frame of view 0.
#[derive(Debug, Clone)]
pub struct Decoded {
    /// `[Q, 6]`, for [`crate::pose::rotation_from_6d`]
    pub rotation_6d: Array2<f32>,
    /// `[Q, 3]`, metres
    pub translation: Array2<f32>,
    /// `[Q, 2]`, expected rotation error in degrees, standard deviation of the translation in metres
    pub sigma: Array2<f32>,
    /// Of networks that give several poses of each object, all of them; the ones above are those
    /// with the highest scores.
    pub hypotheses: Option<Hypotheses>,
}

/// Several poses of each object, of which one is meant to be right; frame and units as [`Decoded`].
#[derive(Debug, Clone)]
pub struct Hypotheses {
    /// `[Q, K, 6]`
    pub rotation_6d: Array3<f32>,
    /// `[Q, K, 3]`
    pub translation: Array3<f32>,
    /// `[Q, K, 2]`, of each if it is the right one
    pub sigma: Array3<f32>,
    /// `[Q, K]`, the logarithm of how probable each is, but for a constant
    pub score: Array2<f32>,
}

impl DetectorMaps {
    /// Refuses maps that belong to other views or classes, scores that are none, and boxes of objects
    /// that are none: an empty answer of a broken network is no empty scene.
    ///
    /// - `threshold`: least score of an object
    pub(crate) fn check(&self, views: usize, classes: usize, threshold: f32) -> Result<()> {
        let (scores, boxes) = (self.scores.shape(), self.boxes.shape());
        let cells = &scores[2..];
        expect("det_scores", scores, &[views, classes, cells[0], cells[1]])?;
        expect("det_boxes", boxes, &[views, 4, cells[0], cells[1]])?;
        let share = |score: &&f32| !(0.0..=1.0).contains(*score);
        if let Some(wrong) = self.scores.iter().find(share) {
            return Err(Error::Pose(format!(
                "detector: expected scores from 0 to 1, got {wrong}"
            )));
        }
        for ((view, _, row, column), _) in
            self.scores.indexed_iter().filter(|(_, s)| **s >= threshold)
        {
            let sides = [0, 1, 2, 3].map(|side| self.boxes[(view, side, row, column)]);
            let [x0, y0, x1, y1] = sides;
            if !(sides.iter().all(|side| side.is_finite()) && x0 <= x1 && y0 <= y1) {
                return Err(Error::Pose(format!(
                    "detector: expected boxes [x0, y0, x1, y1] with x0 <= x1 and y0 <= y1, got \
                     {sides:?}"
                )));
            }
        }
        Ok(())
    }
}

impl Decoded {
    /// Refuses poses of another number of objects.
    pub(crate) fn check(&self, queries: usize) -> Result<()> {
        expect("rotation_6d", self.rotation_6d.shape(), &[queries, 6])?;
        expect("translation", self.translation.shape(), &[queries, 3])?;
        expect("sigma", self.sigma.shape(), &[queries, 2])?;
        let Some(several) = &self.hypotheses else {
            return Ok(());
        };
        let count = several.score.ncols().max(1);
        expect("hypotheses_score", several.score.shape(), &[queries, count])?;
        for (name, array, length) in [
            ("hypotheses_rotation_6d", &several.rotation_6d, 6),
            ("hypotheses_translation", &several.translation, 3),
            ("hypotheses_sigma", &several.sigma, 2),
        ] {
            expect(name, array.shape(), &[queries, count, length])?;
        }
        Ok(())
    }
}

fn expect(name: &'static str, got: &[usize], expected: &[usize]) -> Result<()> {
    if got == expected {
        return Ok(());
    }
    Err(Error::Shape {
        name,
        expected: format!("{expected:?}"),
        got: got.to_vec(),
    })
}
