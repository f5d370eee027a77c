//! The images with their cameras.

use image::RgbImage;
use ndarray::Array4;

use crate::bundle::{Bundle, Input};
use crate::camera::Camera;
use crate::config::TilingConfig;
use crate::image::{Letterbox, Pyramid, ViewImage, fill, is_one_color};
use crate::prediction::{Warning, WarningCode};
use crate::{BBox, Error, Result, Rig, parallel, refine};

/// Stride of the detector's coarsest features, px.
const COARSEST: u32 = 32;

/// A camera that gave an image.
pub struct View<'a> {
    /// Index of the camera in the rig.
    pub index: usize,
    pub camera: &'a Camera,
    pub image: Pyramid<'a>,
    /// How the image lies in the detector's input.
    pub letterbox: Letterbox,
}

/// The images with their cameras, in the order of the cameras' ids: so that no sum depends on the order
/// of the images or of the rig.
///
/// - `tiling`: how large the detector is shown the images; `None`: it takes the bundle's input alone
pub fn gather<'a>(
    bundle: &Bundle,
    tiling: Option<&TilingConfig>,
    rig: &'a Rig,
    images: &'a [ViewImage],
) -> Result<Vec<View<'a>>> {
    let mut found = Vec::new();
    for ViewImage {
        camera: index,
        image,
    } in images
    {
        let camera = rig.cameras().get(*index).ok_or_else(|| {
            let cameras = rig.cameras().len();
            Error::Input(format!(
                "camera {index}: the rig has {cameras}, counted from 0"
            ))
        })?;
        if image.dimensions() != (camera.width(), camera.height()) {
            return Err(Error::ImageSize {
                camera: camera.id().to_owned(),
                expected: [camera.width(), camera.height()],
                got: image.dimensions().into(),
            });
        }
        found.push((*index, camera, image));
    }
    let sizes: Vec<[u32; 2]> = found
        .iter()
        .map(|(_, _, image)| image.dimensions().into())
        .collect();
    let [width, height] = match tiling {
        Some(tiling) => detector_input(&bundle.input, tiling, &sizes),
        None => [bundle.input.width, bundle.input.height],
    };
    let view = |(index, camera, image): (usize, &'a Camera, &'a RgbImage)| View {
        index,
        camera,
        image: Pyramid::new(image),
        letterbox: Letterbox::new(camera.width(), camera.height(), width, height),
    };
    let mut views: Vec<View> = found.into_iter().map(view).collect();
    views.sort_by(|a, b| a.camera.id().cmp(b.camera.id()));
    if let Some(twice) = views.windows(2).find(|pair| pair[0].index == pair[1].index) {
        let id = twice[0].camera.id();
        return Err(Error::Input(format!(
            "camera `{id}`: expected one image, got two"
        )));
    }
    Ok(views)
}

/// Size of the input in which the detector is shown images: of the bundle's, or larger ones where that
/// would show an image at less than `full_scale`. Its sides are multiples of [`COARSEST`].
///
/// - `sizes`: width and height of each image, px
fn detector_input(input: &Input, tiling: &TilingConfig, sizes: &[[u32; 2]]) -> [u32; 2] {
    let [width, height] = [input.width, input.height].map(f64::from);
    let mut sides = [0.0, 0.0];
    for size in sizes {
        let [w, h] = size.map(|side| f64::from(side.max(1)));
        let fitting = (width / w).min(height / h);
        let largest = (tiling.max_input * width * height / (w * h)).sqrt();
        let scale = tiling.full_scale.min(largest).max(fitting);
        sides = [(w * scale).max(sides[0]), (h * scale).max(sides[1])];
    }
    // Rounded, so that no rounding error of the product adds a multiple.
    sides.map(|side| (side.round() as u32).max(1).next_multiple_of(COARSEST))
}

/// What is wrong with the images, though poses can be predicted from them.
pub fn warnings(views: &[View]) -> Vec<Warning> {
    let dark = views.iter().filter(|view| is_one_color(view.image.image()));
    dark.map(|view| Warning {
        code: WarningCode::OneColor,
        camera: Some(view.index),
        object: None,
        message: format!(
            "image of camera `{}` is of one color, so it shows nothing; check that the camera is \
             neither covered nor dead, and its exposure",
            view.camera.id()
        ),
    })
    .collect()
}

/// The detector's input.
///
/// - returns: `[V, 3, Hn, Wn]`, of the size of the views' letterboxes
pub fn tensor(views: &[View], input: &Input) -> Result<Array4<f32>> {
    let Input { mean, std, .. } = *input;
    let size = views.first().map(|view| &view.letterbox);
    let [rows, columns] = size.map_or([0, 0], |one| [one.net_height, one.net_width]);
    let shape = (views.len(), 3, rows as usize, columns as usize);
    let mut tensor = Array4::zeros(shape);
    let images = tensor.outer_iter_mut().zip(views).collect();
    let filled = parallel::each(images, |(image, view)| {
        fill(image, &view.image, &view.letterbox, mean, std)
    });
    filled.into_iter().collect::<Result<()>>()?;
    Ok(tensor)
}

impl View<'_> {
    /// As the refinement takes it.
    pub fn refined(&self) -> refine::View<'_> {
        refine::View {
            camera: self.camera,
            image: &self.image,
        }
    }

    /// The part within the image of a box of the detector's input.
    pub fn image_box(&self, bbox: BBox) -> Option<BBox> {
        let bbox = self.letterbox.image_box(bbox);
        bbox.clip(self.camera.width(), self.camera.height())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same cases as in `training/tests/test_detector.py`.
    #[test]
    fn large_images_are_shown_larger() {
        let input = Input {
            width: 512,
            height: 384,
            mean: [0.5; 3],
            std: [0.25; 3],
        };
        let tiling = TilingConfig::default();
        let shown = |sizes: &[[u32; 2]]| detector_input(&input, &tiling, sizes);
        assert_eq!(shown(&[[640, 480]]), [512, 384]); // 0.8 times as large
        assert_eq!(shown(&[[1280, 720]]), [800, 448]); // 0.611: 1.75 times the pixels of the input
        assert_eq!(shown(&[[320, 240]]), [512, 384]); // small ones fill the input
        assert_eq!(shown(&[[2448, 2048]]), [672, 544]);
        assert_eq!(shown(&[[480, 640]]), [384, 512]); // not letterboxed: a scale of 0.8 as well
        assert_eq!(shown(&[[640, 480], [1280, 720]]), [800, 448]);
        assert_eq!(shown(&[[640, 480], [480, 640]]), [512, 512]);
    }
}
