//! How well the images show an object at a pose.

/// How much less the images show a pose that is a third as probable: bits that it explains.
const AS_EXPLAINED: f64 = 0.1;
/// How much less they look like its print.
const AS_PRINTED: f64 = 0.2;
/// How much less of its edges they show.
const AS_SUPPORTED: f64 = 0.07;
/// How much less colors tell it from what is next to it.
const AS_APART: f64 = 0.1;

/// To compare poses of one object, also those far from each other: odds of the pose to show, as a
/// logarithm, up to what is the same of all poses.
///
/// By the means over views of what [`ViewQuality`] has of these names.
pub fn score(explained: f64, print: Option<f64>, supported: f64, overlap: f64) -> f64 {
    explained / AS_EXPLAINED
        + print.unwrap_or(0.0) / AS_PRINTED
        + supported / AS_SUPPORTED
        + overlap / AS_APART
}

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
    /// What knowing the part of the object tells of a pixel's color, bits: of the outline, and of the
    /// parts within.
    pub explained: f64,
    /// How far the view looks like what is printed on the object: correlation of color and brightness,
    /// 1 where alike, about 0 where it shows something else; `None` without print, or where too
    /// little of it is seen.
    pub print: Option<f64>,
}

/// How well the images show an object at a pose.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Quality {
    /// Of each view in which a contour is seen.
    pub views: Vec<ViewQuality>,
}

impl Quality {
    /// To compare poses of one object, also those far from each other: the one with more explains the
    /// images better. 0 where no view shows the object.
    ///
    /// The mean over views, so that one in which the object is hidden, at any pose, does not decide.
    pub fn explained(&self) -> f64 {
        self.mean(|view| view.explained).unwrap_or(0.0)
    }

    /// [`score`] of these.
    pub fn score(&self) -> f64 {
        score(
            self.explained(),
            self.print(),
            self.supported(),
            self.overlap(),
        )
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

    /// Mean over the views that tell; `None` where none does.
    pub fn print(&self) -> Option<f64> {
        let told: Vec<f64> = self.views.iter().filter_map(|view| view.print).collect();
        (!told.is_empty()).then(|| told.iter().sum::<f64>() / told.len() as f64)
    }

    /// The view of which the pose explains least.
    pub fn worst(&self) -> Option<&ViewQuality> {
        let least = |a: &&ViewQuality, b: &&ViewQuality| a.explained.total_cmp(&b.explained);
        self.views.iter().min_by(least)
    }

    fn mean(&self, number: impl Fn(&ViewQuality) -> f64) -> Option<f64> {
        let count = self.views.len() as f64;
        (count > 0.0).then(|| self.views.iter().map(number).sum::<f64>() / count)
    }
}
