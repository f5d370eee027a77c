//! The images with their cameras.

use image::RgbImage;
use ndarray::Array4;

use crate::bundle::{Bundle, Input};
use crate::camera::Camera;
use crate::image::{Letterbox, ViewImage, fill, is_one_color};
use crate::prediction::{Warning, WarningCode};
use crate::{BBox, Error, Result, Rig, parallel, refine};

/// A camera that gave an image.
pub struct View<'a> {
    /// Index of the camera in the rig.
    pub index: usize,
    pub camera: &'a Camera,
    pub image: &'a RgbImage,
    /// How the image lies in the detector's input.
    pub letterbox: Letterbox,
}

/// The images with their cameras, in the order of the cameras' ids: so that no sum depends on the order
/// of the images or of the rig.
pub fn gather<'a>(bundle: &Bundle, rig: &'a Rig, images: &'a [ViewImage]) -> Result<Vec<View<'a>>> {
    let mut views = Vec::new();
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
        let Input { width, height, .. } = bundle.input;
        views.push(View {
            index: *index,
            camera,
            image,
            letterbox: Letterbox::new(camera.width(), camera.height(), width, height),
        });
    }
    views.sort_by(|a, b| a.camera.id().cmp(b.camera.id()));
    if let Some(twice) = views.windows(2).find(|pair| pair[0].index == pair[1].index) {
        let id = twice[0].camera.id();
        return Err(Error::Input(format!(
            "camera `{id}`: expected one image, got two"
        )));
    }
    Ok(views)
}

/// What is wrong with the images, though poses can be predicted from them.
pub fn warnings(views: &[View]) -> Vec<Warning> {
    let dark = views.iter().filter(|view| is_one_color(view.image));
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
/// - returns: `[V, 3, Hn, Wn]`
pub fn tensor(views: &[View], input: &Input) -> Result<Array4<f32>> {
    let Input { mean, std, .. } = *input;
    let shape = (views.len(), 3, input.height as usize, input.width as usize);
    let mut tensor = Array4::zeros(shape);
    let images = tensor.outer_iter_mut().zip(views).collect();
    let filled = parallel::each(images, |(image, view)| {
        fill(image, view.image, &view.letterbox, mean, std)
    });
    filled.into_iter().collect::<Result<()>>()?;
    Ok(tensor)
}

impl View<'_> {
    /// As the refinement takes it.
    pub fn refined(&self) -> refine::View<'_> {
        refine::View {
            camera: self.camera,
            image: self.image,
        }
    }

    /// The part within the image of a box of the detector's input.
    pub fn image_box(&self, bbox: BBox) -> Option<BBox> {
        let bbox = self.letterbox.image_box(bbox);
        bbox.clip(self.camera.width(), self.camera.height())
    }
}
