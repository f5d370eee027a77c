//! How well the images show an object at a pose.

use super::region::SEARCHED;

/// How well one view shows an object at a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewQuality {
    /// Index of the view, as given.
    pub view: usize,
    /// Share of the visible contour that the image shows within 1.5 px of the close-up.
    pub supported: f64,
    /// Mean distance of the contour from where the image shows it, along its normals, px of the
    /// image.
    pub residual_px: f64,
    /// How likely a pixel within the silhouette is of the object by its color, less how likely one
    /// next to it is: 1 where colors tell them apart everywhere, 0 where they do not.
    pub overlap: f64,
    /// Of [`Self::residual_px`], as a share of the greatest that is searched for: 0 to 1.
    off: f64,
}

/// How well the images show an object at a pose.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Quality {
    /// Of each view in which a contour is seen.
    pub views: Vec<ViewQuality>,
}

impl ViewQuality {
    /// - `residual`: px of the close-up
    /// - `scale`: px of the close-up in one of the image
    pub(super) fn new(
        view: usize,
        supported: f64,
        residual: f64,
        overlap: f64,
        scale: f64,
    ) -> Self {
        Self {
            view,
            supported,
            residual_px: residual / scale,
            overlap,
            off: (residual / f64::from(SEARCHED)).min(1.0),
        }
    }

    /// How badly the view fits: 0 is best, 3 worst.
    pub fn energy(&self) -> f64 {
        (1.0 - self.supported) + self.off + (1.0 - self.overlap).clamp(0.0, 1.0)
    }
}

impl Quality {
    /// How badly the images fit, to compare poses of one object: the less, the better; 0 to 3, and 3
    /// where no view shows the object.
    ///
    /// The mean over views, so that one in which the object is hidden, at any pose, does not decide.
    pub fn energy(&self) -> f64 {
        self.mean(ViewQuality::energy).unwrap_or(3.0)
    }

    /// Share of the visible contour that is supported, mean over views; 0 without any.
    pub fn supported(&self) -> f64 {
        self.mean(|view| view.supported).unwrap_or(0.0)
    }

    /// Mean over views, px of the images; `None` without any.
    pub fn residual_px(&self) -> Option<f64> {
        self.mean(|view| view.residual_px)
    }

    /// Mean over views; 0 without any.
    pub fn overlap(&self) -> f64 {
        self.mean(|view| view.overlap).unwrap_or(0.0)
    }

    /// The view that fits worst.
    pub fn worst(&self) -> Option<&ViewQuality> {
        let by_energy = |a: &&ViewQuality, b: &&ViewQuality| a.energy().total_cmp(&b.energy());
        self.views.iter().max_by(by_energy)
    }

    fn mean(&self, number: impl Fn(&ViewQuality) -> f64) -> Option<f64> {
        let count = self.views.len() as f64;
        (count > 0.0).then(|| self.views.iter().map(number).sum::<f64>() / count)
    }
}
