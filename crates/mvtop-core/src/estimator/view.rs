//! The images with their cameras, and the pictures of them that the network is shown.

use image::RgbImage;
use ndarray::{Array2, Array3, Array4, Axis};

use crate::bundle::{Bundle, CloseUps, Input};
use crate::camera::Camera;
use crate::closeup::CloseUp;
use crate::detect::clip;
use crate::image::{Letterbox, to_tensor};
use crate::rays::camera_rays;
use crate::{Error, Result, Rig};

/// A camera that gave an image.
pub struct View<'a> {
    /// Index of the camera in the rig.
    pub index: usize,
    pub camera: &'a Camera,
    pub image: &'a RgbImage,
    pub letterbox: Letterbox,
}

/// What the network is shown of a view, and the camera that would have taken it.
pub struct Picture {
    pub camera: Camera,
    pub letterbox: Letterbox,
    /// `[N, 3]`
    pub camera_rays: Array2<f32>,
    /// `[3, Hn, Wn]`
    tensor: Array3<f32>,
}

/// The images with their cameras, in the rig's order whatever order they came in.
pub fn gather<'a>(
    bundle: &Bundle,
    rig: &'a Rig,
    images: &'a [(usize, RgbImage)],
) -> Result<Vec<View<'a>>> {
    let mut views = Vec::new();
    for (index, image) in images {
        let camera = rig.cameras().get(*index).ok_or_else(|| {
            let cameras = rig.cameras().len();
            Error::Input(format!(
                "camera {index}: the rig has {cameras}, counted from 0"
            ))
        })?;
        if image.dimensions() != (camera.width(), camera.height()) {
            return Err(Error::Input(format!(
                "camera `{}`: expected an image of {}x{} px as in the rig, got {}x{}",
                camera.id(),
                camera.width(),
                camera.height(),
                image.width(),
                image.height()
            )));
        }
        let input = &bundle.input;
        let letterbox = Letterbox::new(camera.width(), camera.height(), input.width, input.height);
        views.push(View {
            index: *index,
            camera,
            image,
            letterbox,
        });
    }
    views.sort_by_key(|view| view.index);
    if let Some(twice) = views.windows(2).find(|pair| pair[0].index == pair[1].index) {
        let id = &twice[0].camera.id();
        return Err(Error::Input(format!(
            "camera `{id}`: expected one image, got two"
        )));
    }
    if views.is_empty() {
        return Err(Error::Input("no image given: expected at least one".into()));
    }
    Ok(views)
}

/// The network's input.
///
/// - returns: `[V, 3, Hn, Wn]`, `[V, N, 3]`
pub fn stack(pictures: &[&Picture]) -> (Array4<f32>, Array3<f32>) {
    let first = pictures[0];
    let (channels, height, width) = first.tensor.dim();
    let mut tensor = Array4::zeros((pictures.len(), channels, height, width));
    let mut rays = Array3::zeros((pictures.len(), first.camera_rays.nrows(), 3));
    for (v, picture) in pictures.iter().enumerate() {
        tensor.index_axis_mut(Axis(0), v).assign(&picture.tensor);
        rays.index_axis_mut(Axis(0), v).assign(&picture.camera_rays);
    }
    (tensor, rays)
}

impl View<'_> {
    /// The whole image; without rays where these are asked of close-ups only.
    pub fn picture(&self, bundle: &Bundle) -> Result<Picture> {
        let input = &bundle.input;
        Ok(Picture {
            camera: self.camera.clone(),
            letterbox: self.letterbox.clone(),
            camera_rays: match bundle.closeup {
                Some(_) => Array2::zeros((0, 3)),
                None => camera_rays(self.camera, &self.letterbox, &bundle.strides),
            },
            tensor: to_tensor(self.image, &self.letterbox, input.mean, input.std)?,
        })
    }

    /// The close-up of a box, and the box in it; `None` where it has none.
    pub fn closeup(
        &self,
        input: &Input,
        closeups: &CloseUps,
        bbox: [f64; 4],
    ) -> Option<(Picture, [f64; 4])> {
        let closeup = CloseUp::new(self.camera, bbox, closeups.size)?;
        let picture = Picture {
            letterbox: closeup.letterbox(),
            camera_rays: closeup.camera_rays(self.camera, &closeups.strides),
            tensor: closeup.picture(self.camera, self.image, input.mean, input.std),
            camera: closeup.camera,
        };
        Some((picture, closeup.bbox))
    }

    /// The part within the image of a box of the network's input, in image px.
    pub fn image_box(&self, net: [f64; 4]) -> Option<[f64; 4]> {
        let [x0, y0] = self.letterbox.image_from_net([net[0], net[1]]);
        let [x1, y1] = self.letterbox.image_from_net([net[2], net[3]]);
        clip([x0, y0, x1, y1], self.camera.width(), self.camera.height())
    }
}

impl Picture {
    /// Center and half size of a box over the network's input, 0 to 1.
    ///
    /// - `bbox`: px of what `camera` takes
    pub fn net_box(&self, bbox: [f64; 4]) -> ([f64; 2], [f64; 2]) {
        let from = self.letterbox.net_from_image([bbox[0], bbox[1]]);
        let to = self.letterbox.net_from_image([bbox[2], bbox[3]]);
        let size = [self.letterbox.net_width, self.letterbox.net_height].map(f64::from);
        let center = |axis: usize| ((from[axis] + to[axis]) / 2.0 + 0.5) / size[axis];
        let half = |axis: usize| (to[axis] - from[axis]) / 2.0 / size[axis];
        ([center(0), center(1)], [half(0), half(1)])
    }
}
