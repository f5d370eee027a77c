//! Evidence for a pose in each view.

/// Evidence for a pose in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewQuality {
    /// Index of the view, as given.
    pub view: usize,
    /// Share of inliers among the visible contour points.
    pub contour_inliers: f64,
    /// Mean distance of the contour from its projection, along the normals, px of the image.
    pub contour_residual_px: f64,
    /// Mean probability of belonging to the object, by color, of the silhouette's pixels less that of
    /// the background's: 1 if colors separate them everywhere, 0 if they do not.
    pub color_separation: f64,
    /// Mutual information of segment and color, bits per pixel: along the outline, and within it.
    pub mutual_information: f64,
    /// Normalised cross-correlation (NCC) of the surface's colors with the image, at most 1; `None`
    /// without texture, or if too little of it is visible.
    pub texture_correlation: Option<f64>,
    /// NCC at the pose less the mean NCC of the same surface points displaced up, down, left and right
    /// in the image; `None` without texture, or if too little of it is visible.
    pub texture_gain: Option<f64>,
    /// Share of the silhouette's area in the crop that lies inside the image, 0 to 1.
    pub visible_share: f64,
}

/// Evidence for a pose in all views.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Quality {
    /// Views that show a contour.
    pub views: Vec<ViewQuality>,
}

impl Quality {
    /// Mean over views, bits per pixel; 0 without any.
    pub fn mutual_information(&self) -> f64 {
        self.mean(|view| view.mutual_information).unwrap_or(0.0)
    }

    /// Least over views, bits per pixel; 0 without any.
    pub fn mutual_information_min(&self) -> f64 {
        self.worst().map_or(0.0, |view| view.mutual_information)
    }

    /// Mean over views; 0 without any.
    pub fn color_separation(&self) -> f64 {
        self.mean(|view| view.color_separation).unwrap_or(0.0)
    }

    /// Mean over the views that have one; `None` without any.
    pub fn texture_correlation(&self) -> Option<f64> {
        mean(
            self.views
                .iter()
                .filter_map(|view| view.texture_correlation),
        )
    }

    /// Mean over the views that have one; `None` without any.
    pub fn texture_gain(&self) -> Option<f64> {
        mean(self.views.iter().filter_map(|view| view.texture_gain))
    }

    /// The view with the least mutual information.
    pub fn worst(&self) -> Option<&ViewQuality> {
        let information = |view: &&ViewQuality| view.mutual_information;
        let least = |a: &&ViewQuality, b: &&ViewQuality| information(a).total_cmp(&information(b));
        self.views.iter().min_by(least)
    }

    fn mean(&self, number: impl Fn(&ViewQuality) -> f64) -> Option<f64> {
        mean(self.views.iter().map(number))
    }
}

/// `None` without numbers.
fn mean(numbers: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = numbers.collect();
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
}
