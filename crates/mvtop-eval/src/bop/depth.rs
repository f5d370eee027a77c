//! Measured depth images.

use std::io::BufReader;

use image::{DynamicImage, ImageReader};
use mvtop_core::file;

use super::json::MM;
use super::scene::Frame;
use crate::metrics::DepthImage;
use crate::{Error, Result};

/// Reads a frame's depth image, metres, 0 where nothing was measured; `None` where it has none.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] where it is no grey image of 16
/// bits.
pub fn load_depth(frame: &Frame) -> Result<Option<DepthImage>> {
    let Some(path) = &frame.depth else {
        return Ok(None);
    };
    let reader = ImageReader::new(BufReader::new(file::open(path)?));
    let reader = reader.with_guessed_format().map_err(Error::read(path))?;
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
    let size = (image.height() as usize, image.width() as usize);
    let depth = |(row, column)| {
        let [depth] = image.get_pixel(column as u32, row as u32).0;
        (f64::from(depth) * unit) as f32
    };
    Ok(Some(DepthImage::from_shape_fn(size, depth)))
}
