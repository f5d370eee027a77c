//! Whether the images have red and blue exchanged, as OpenCV reads them.

use image::RgbImage;
use nalgebra::Point2;
use ndarray::{Array4, Axis, s};

use super::instance::Instance;
use super::occlusion::Seen;
use super::pipeline::Pipeline;
use crate::Result;
use crate::network::DetectorMaps;
use crate::prediction::{Warning, WarningCode};

/// Warns of exchanged colors: by the colors of instances whose poses are more probably right than
/// wrong, or by the detector where there are none.
pub fn check(
    pipeline: &Pipeline,
    instances: &[Instance],
    seen: &[Vec<Seen>],
) -> Result<Option<Warning>> {
    let known = instances.iter().any(is_probable);
    let reason = match known {
        true => by_surfaces(pipeline, instances, seen),
        false => by_detector(pipeline)?,
    };
    Ok(reason.map(|reason| Warning {
        code: WarningCode::ColorsExchanged,
        camera: None,
        object: None,
        message: format!(
            "images seem to have red and blue exchanged: {reason}; give RGB (images that OpenCV reads \
             are BGR)"
        ),
    }))
}

fn is_probable(instance: &Instance) -> bool {
    instance.confidence() >= 0.5
}

/// Red less blue, as a share of all light.
fn redness(color: [u8; 3]) -> Option<f64> {
    let [red, green, blue] = color.map(f64::from);
    let sum = red + green + blue;
    (sum > 0.0).then(|| (red - blue) / sum)
}

/// How the colors of probable poses speak for an exchange, if they do.
fn by_surfaces(pipeline: &Pipeline, instances: &[Instance], seen: &[Vec<Seen>]) -> Option<String> {
    let probable = instances.iter().zip(seen);
    let probable = probable.filter(|(one, _)| is_probable(one));
    let mut pairs = Vec::new();
    for (view, seen) in probable.flat_map(|(_, seen)| pipeline.views.iter().zip(seen)) {
        for (known, place) in &seen.points {
            let in_cam = view.camera.world_from_cam().inverse_transform_point(place);
            let pixel = view.camera.intrinsics().project(&in_cam);
            let image = pixel.and_then(|at| color(view.image.image(), at));
            pairs.extend(redness(*known).zip(image.and_then(redness)));
        }
    }
    let (correlation, spread) = correlation(&pairs);
    let config = pipeline.config();
    let colored = spread >= f64::from(config.refine.texture.contrast[1]);
    (colored && correlation <= -config.rig.exchanged_correlation).then(|| {
        format!(
            "red less blue correlates with the objects' colors by {correlation:.2} over {} points",
            pairs.len()
        )
    })
}

/// The pixel at a place; `None` off the image.
fn color(image: &RgbImage, at: Point2<f64>) -> Option<[u8; 3]> {
    let [u, v] = [at.x, at.y].map(f64::round);
    let inside = (0.0..f64::from(image.width())).contains(&u)
        && (0.0..f64::from(image.height())).contains(&v);
    inside.then(|| image.get_pixel(u as u32, v as u32).0)
}

/// Pearson's correlation of pairs, 0 where it is not defined, and the standard deviation of the first
/// numbers.
fn correlation(pairs: &[(f64, f64)]) -> (f64, f64) {
    let count = pairs.len().max(1) as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    let [a, b] = [mean(|one| one.0), mean(|one| one.1)];
    let [aa, bb] = [mean(|one| one.0 * one.0), mean(|one| one.1 * one.1)];
    let ab = mean(|one| one.0 * one.1);
    let [of_a, of_b] = [(aa - a * a).max(0.0), (bb - b * b).max(0.0)];
    let spread = (of_a * of_b).sqrt();
    let correlation = if spread > 0.0 {
        (ab - a * b) / spread
    } else {
        0.0
    };
    (correlation, of_a.sqrt())
}

/// How the detector speaks for an exchange, if it does.
fn by_detector(pipeline: &Pipeline) -> Result<Option<String>> {
    let bundle = &pipeline.estimator.bundle;
    let Some(maps) = pipeline.maps.as_ref().filter(|_| bundle.scorer.is_some()) else {
        return Ok(None);
    };
    // Of some classes there may be no object, though the detector knows others.
    let threshold = f64::from(bundle.detector.score_threshold);
    if !pipeline.wanted.has_all_classes() && best_scores(maps) >= threshold {
        return Ok(None);
    }
    let images = super::view::tensor(&pipeline.views, &bundle.input)?;
    let exchanged = exchanged(images, bundle.input.mean, bundle.input.std);
    let other = pipeline.network.detect(exchanged.view())?;
    let (as_they_are, exchanged) = (best_scores(maps), best_scores(&other));
    let gains = exchanged - as_they_are >= pipeline.config().rig.exchanged_gain;
    Ok((exchanged >= threshold && gains).then(|| {
        format!(
            "the detector's best score, mean over views, is {exchanged:.2} with them exchanged back \
             instead of {as_they_are:.2}"
        )
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

    #[test]
    fn correlation_is_pearsons() {
        let (all, spread) = correlation(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]);
        assert!((all - 1.0).abs() < 1e-12 && (spread - (2.0f64 / 3.0).sqrt()).abs() < 1e-12);
        let (less, _) = correlation(&[(0.0, 1.0), (1.0, 0.0), (2.0, 0.0), (3.0, 1.0)]);
        assert!(less.abs() < 1e-12, "{less}");
        assert_eq!(correlation(&[]), (0.0, 0.0));
        assert_eq!(correlation(&[(1.0, 0.5); 3]).0, 0.0);
    }

    #[test]
    fn red_and_blue_exchanged_change_the_sign() {
        assert_eq!(redness([0, 0, 0]), None);
        let [red, blue] = [[200, 50, 50], [50, 50, 200]].map(|color| redness(color).unwrap());
        assert!((red - 0.5).abs() < 1e-12 && (red + blue).abs() < 1e-12);
    }
}
