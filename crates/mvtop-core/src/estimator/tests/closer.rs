//! Second looks at large images, by a detector that finds what is large enough in its input.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;

const BALL: [f64; 3] = [0.05, 0.1, 1.0];
/// Least width of what is found, px of the detector's input.
const LEAST: usize = 20;

/// Finds what is white.
struct White<'a> {
    decoder: Geometry,
    /// Pictures that the detector was shown.
    shown: &'a AtomicUsize,
}

impl Network for White<'_> {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        let pictures = images.dim().0;
        self.shown.fetch_add(pictures, Ordering::Relaxed);
        let (h, w) = (NET.1 as usize / STRIDE, NET.0 as usize / STRIDE);
        let mut maps = DetectorMaps {
            scores: Array4::zeros((pictures, 1, h, w)),
            boxes: Array4::zeros((pictures, 4, h, w)),
        };
        for (p, image) in images.outer_iter().enumerate() {
            let white = image.slice(s![0, .., ..]);
            let white = white.indexed_iter().filter(|(_, value)| **value > 1.0);
            let (rows, columns): (Vec<usize>, Vec<usize>) = white.map(|(at, _)| at).unzip();
            let ends = |of: &[usize]| Some((*of.iter().min()?, *of.iter().max()?));
            let (Some((y0, y1)), Some((x0, x1))) = (ends(&rows), ends(&columns)) else {
                continue;
            };
            if x1 - x0 < LEAST {
                continue;
            }
            let (row, column) = ((y0 + y1) / 2 / STRIDE, (x0 + x1) / 2 / STRIDE);
            maps.scores[(p, 0, row, column)] = 0.9;
            for (side, value) in [x0, y0, x1, y1].into_iter().enumerate() {
                maps.boxes[(p, side, row, column)] = value as f32;
            }
        }
        Ok(maps)
    }

    fn encode(&self, pictures: ArrayView4<f32>, rays: ArrayView3<f32>) -> Result<Array3<f32>> {
        self.decoder.encode(pictures, rays)
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        self.decoder.decode(memory, queries)
    }

    fn provider(&self) -> &str {
        "white"
    }
}

/// A white box where the ball is, on darker ground.
fn image(camera: &Camera) -> RgbImage {
    let bbox = ball_box(camera, BALL);
    RgbImage::from_fn(camera.width(), camera.height(), |x, y| {
        let (u, v) = (f64::from(x), f64::from(y));
        let inside = bbox.x0 <= u && u <= bbox.x1 && bbox.y0 <= v && v <= bbox.y1;
        image::Rgb([if inside { 255 } else { (x / 16) as u8 }; 3])
    })
}

/// What is found, and how many pictures the detector was shown for it.
///
/// - `cameras`: size and focal length, px
fn found(cameras: [((u32, u32), f64); 2]) -> (Rig, Prediction, usize) {
    let centers = [[-1.2, -0.8, 1.2], [1.1, -0.9, 1.5]];
    let place = |(i, (size, f))| camera(["left", "right"][i], size, f, centers[i]);
    let rig = Rig::new(cameras.into_iter().enumerate().map(place).collect(), 0).unwrap();
    let taken = rig.cameras().iter().enumerate();
    let images: Vec<ViewImage> = taken
        .map(|(camera, of)| ViewImage {
            camera,
            image: image(of),
        })
        .collect();
    let shown = Box::leak(Box::new(AtomicUsize::new(0)));
    let network = White {
        decoder: Geometry::new(&rig, &[]),
        shown,
    };
    let estimator = Estimator::new(bundle(), Box::new(network));
    let prediction = estimator.predict(&rig, &images, &PredictOptions::default());
    (rig, prediction.unwrap(), shown.load(Ordering::Relaxed))
}

fn assert_found_in_both(rig: &Rig, prediction: &Prediction) {
    assert_eq!(prediction.objects.len(), 1);
    let object = &prediction.objects[0];
    for (camera, seen) in rig.cameras().iter().zip(&object.cameras) {
        let (found, expected) = (seen.bbox.unwrap(), ball_box(camera, BALL));
        let sides: [[f64; 4]; 2] = [found.into(), expected.into()];
        let pairs = sides[0].iter().zip(sides[1]);
        // To one pixel of the detector's input.
        assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 4.0), "{sides:?}");
    }
    let off = object.world_from_obj.translation.vector - Vector3::from(BALL);
    assert!(off.norm() < 5e-3, "{off}");
}

const LARGE: (u32, u32) = (1280, 960);

#[test]
fn object_that_is_too_small_in_one_image_is_looked_for_where_the_other_tells() {
    // A ball of 94 px is 23 px of the detector's input, one of 62 px is 15 px.
    let (rig, prediction, shown) = found([(LARGE, 1000.0), (LARGE, 650.0)]);
    assert_found_in_both(&rig, &prediction);
    assert_eq!(shown, 2 + 1);
}

#[test]
fn images_in_which_nothing_is_large_enough_are_looked_at_in_parts() {
    let (rig, prediction, shown) = found([(LARGE, 750.0), (LARGE, 510.0)]);
    // In parts that are 1.6 times as large the first is seen, by which the second is found.
    assert_found_in_both(&rig, &prediction);
    assert_eq!(shown, 2 + 8 + 1);
}

#[test]
fn images_that_hardly_shrink_are_seen_once() {
    let (_, prediction, shown) = found([((600, 450), 300.0), ((600, 450), 300.0)]);
    assert_eq!((prediction.objects.len(), shown), (0, 2));
}
