//! Measured depth images.

use image::{DynamicImage, ImageReader};

use super::json::MM;
use super::scene::Frame;
use crate::metrics::DepthImage;
use crate::{Error, Result};

/// Reads a frame's depth image, metres, 0 where nothing was measured; `None` where it has none.
///
/// # Errors
/// [`Error::Read`] where the file cannot be read, [`Error::Data`] where it is no grey image of 16
/// bits.
pub fn load_depth(frame: &Frame) -> Result<Option<DepthImage>> {
    let Some(path) = &frame.depth else {
        return Ok(None);
    };
    let reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|cause| Error::Read {
            path: path.clone(),
            cause,
        })?;
    let refuse = |got: String| {
        Error::Data(format!(
            "depth image {}: expected PNG or TIFF with 16 bits of grey, got: {got}",
            path.display()
        ))
    };
    let image = match reader.decode() {
        Ok(DynamicImage::ImageLuma16(image)) => image,
        Ok(other) => return Err(refuse(format!("{:?}", other.color()))),
        Err(cause) => return Err(refuse(cause.to_string())),
    };
    let unit = frame.depth_scale * MM;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let depths = image.into_raw();
    let depths = depths
        .into_iter()
        .map(|depth| (f64::from(depth) * unit) as f32);
    DepthImage::from_shape_vec((height, width), depths.collect())
        .map(Some)
        .map_err(|cause| refuse(cause.to_string()))
}
