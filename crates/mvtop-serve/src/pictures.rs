//! Pictures of an exposure, drawn when somebody looks at it: predictions do not wait for them.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::imageops::thumbnail;
use mvtop_core::{Prediction, ViewImage, overlay};

use crate::exposure::Upload;
use crate::problem::{Kind, Problem};
use crate::station::{Model, NamedRig};

/// Widest picture, px: that of a large tablet.
const MOST_WIDTH: u32 = 1280;
/// Quality of the JPEG, of 100.
const QUALITY: u8 = 85;

/// One view as JPEG, with the objects drawn as `infer --overlay` does.
pub fn jpeg(
    upload: &Upload,
    rig: &NamedRig,
    found: Option<(&Model, &Prediction)>,
) -> Result<Vec<u8>, Problem> {
    let rig = &rig.rig;
    let image = upload.decode(&rig.cameras()[upload.camera])?;
    let camera = upload.camera;
    let views = [ViewImage { camera, image }];
    let drawn = found.map(|(model, prediction)| {
        let classes = &model.estimator.bundle().classes;
        overlay::draw_prediction(prediction, classes, rig, &views)
    });
    let drawn = drawn.and_then(|mut drawn| drawn.pop());
    let [ViewImage { image, .. }] = views;
    let mut picture = drawn.unwrap_or(image);
    if picture.width() > MOST_WIDTH {
        let height = u64::from(picture.height()) * u64::from(MOST_WIDTH);
        let height = (height / u64::from(picture.width())).max(1) as u32;
        picture = thumbnail(&picture, MOST_WIDTH, height);
    }
    let mut jpeg = Cursor::new(Vec::new());
    let written = JpegEncoder::new_with_quality(&mut jpeg, QUALITY).encode_image(&picture);
    written.map_err(|cause| {
        Problem::new(Kind::Internal, format!("cannot write a picture: {cause}"))
    })?;
    Ok(jpeg.into_inner())
}
