//! Whether the images have red and blue exchanged, as OpenCV reads them.

use ndarray::{Array4, Axis, s};

use super::instance::Instance;
use super::pipeline::Pipeline;
use crate::Result;
use crate::network::DetectorMaps;
use crate::prediction::{Warning, WarningCode};

/// By how much the detector's best score must rise with red and blue exchanged back, mean over views.
const MIN_GAIN: f64 = 0.15;

/// Shows the detector the images with red and blue exchanged, if it is sure of nothing as they are.
pub fn check(pipeline: &Pipeline, instances: &[Instance]) -> Result<Option<Warning>> {
    let settled = pipeline.config().search.settled;
    let bundle = &pipeline.estimator.bundle;
    let Some(maps) = pipeline.maps.as_ref().filter(|_| bundle.scorer.is_some()) else {
        return Ok(None);
    };
    if instances.iter().any(|one| one.confidence() >= settled) {
        return Ok(None);
    }
    let images = super::view::tensor(&pipeline.views, &bundle.input)?;
    let exchanged = exchanged(images, bundle.input.mean, bundle.input.std);
    let other = pipeline.network.detect(exchanged.view())?;
    let (as_they_are, exchanged) = (best_scores(maps), best_scores(&other));
    let threshold = f64::from(bundle.detector.score_threshold);
    if exchanged < threshold || exchanged - as_they_are < MIN_GAIN {
        return Ok(None);
    }
    Ok(Some(Warning {
        code: WarningCode::ColorsExchanged,
        camera: None,
        object: None,
        message: format!(
            "images seem to have red and blue exchanged: the detector's best score, mean over views, is \
             {exchanged:.2} with them exchanged back instead of {as_they_are:.2}; give RGB (images that \
             OpenCV reads are BGR)"
        ),
    }))
}

/// The greatest score of each view, mean over views.
fn best_scores(maps: &DetectorMaps) -> f64 {
    let best = |view: ndarray::ArrayView3<f32>| view.iter().copied().fold(0.0, f32::max);
    let sum: f32 = maps.scores.outer_iter().map(best).sum();
    f64::from(sum) / maps.scores.len_of(Axis(0)).max(1) as f64
}

/// `[V, 3, H, W]`, normalised, with red and blue exchanged.
fn exchanged(images: Array4<f32>, mean: [f32; 3], std: [f32; 3]) -> Array4<f32> {
    let mut exchanged = images.clone();
    for (to, from) in [(0, 2), (2, 0)] {
        let channel = images.slice(s![.., from, .., ..]);
        let channel = channel.mapv(|x| (x * std[from] + mean[from] - mean[to]) / std[to]);
        exchanged.slice_mut(s![.., to, .., ..]).assign(&channel);
    }
    exchanged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanging_twice_gives_the_images_again() {
        let images = Array4::from_shape_fn((2, 3, 4, 5), |(v, c, y, x)| {
            (v + 2 * c + 3 * y + x) as f32 / 10.0 - 1.0
        });
        let (mean, std) = ([0.4, 0.5, 0.6], [0.2, 0.25, 0.3]);
        let once = exchanged(images.clone(), mean, std);
        // 0.4 + 0.2 * x is the red value; it becomes blue: (value - 0.6) / 0.3.
        let red = 0.2f32.mul_add(images[(1, 0, 2, 3)], 0.4);
        assert!((once[(1, 2, 2, 3)] - (red - 0.6) / 0.3).abs() < 1e-6);
        let twice = exchanged(once, mean, std);
        assert!(twice.iter().zip(&images).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
