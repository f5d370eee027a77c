//! Image files, and what of them is refused.

use std::io::{BufReader, Cursor};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};
use rayon::prelude::*;

use super::{ViewImage, gamma, jpeg, tiff};
use crate::camera::Camera;
use crate::{Error, Result, Rig, file};

/// Largest image file that is read.
const MAX_FILE_BYTES: u64 = 1 << 29;
/// Most pixels of an image: more than any camera has, so that memory is bounded also where the
/// camera's size is the image's own.
const MAX_PIXELS: u64 = 1 << 28;
/// Decoded bytes per pixel at most: RGBA of 16 bits.
const MAX_PIXEL_BYTES: u64 = 8;
/// What a decoder may need beside the pixels.
const DECODER_BYTES: u64 = 1 << 26;
/// Images of 16 bits that are no brighter anywhere have 14 bits or fewer, as cameras give them.
const FOURTEEN_BITS: u16 = (1 << 14) - 1;

/// Reads a PNG, JPEG, TIFF or BMP file taken by `camera`, as 8-bit RGB.
///
/// Grey images are spread over the three channels, alpha is dropped, 16 bits are scaled to 8, and
/// floats from 0..1 to 0..255. A PNG file that states another gamma than 1 / 2.2 (`gAMA`), without a profile, is
/// brought to that. The size is checked against the camera's before anything is decoded,
/// which bounds the memory.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read; [`Error::Image`] where it is none of these, is
/// broken or cut short, has another size than the camera's or more than 268 million pixels, is marked
/// as rotated, in which case its pixels may not be those that the camera was calibrated with, or has
/// values that cannot be what was seen: 16 bits of which 12 or 14 are used, or floats that are not 0 to 1; or
/// is a TIFF file of several pages.
pub fn load(path: &Path, camera: &Camera) -> Result<RgbImage> {
    decode(&file::read(path, MAX_FILE_BYTES)?, path, camera)
}

/// [`load`] of the files of some cameras, all at a time.
///
/// - `files`: each with the index of its camera in the rig, which has one of it
///
/// # Errors
/// Those of [`load`], of the first file that has one.
pub fn load_views(rig: &Rig, files: &[(usize, impl AsRef<Path> + Sync)]) -> Result<Vec<ViewImage>> {
    let view = |(camera, path): &(usize, _)| {
        let camera = *camera;
        let image = load(AsRef::<Path>::as_ref(path), &rig.cameras()[camera])?;
        Ok(ViewImage { camera, image })
    };
    // Not collected at once: of several errors that would be any.
    let views: Vec<Result<ViewImage>> = files.par_iter().map(view).collect();
    views.into_iter().collect()
}

/// [`load`] of a file's bytes, however they came.
///
/// - `path`: what to call them in errors
///
/// # Errors
/// [`Error::Image`], as [`load`].
pub fn decode(bytes: &[u8], path: &Path, camera: &Camera) -> Result<RgbImage> {
    let refuse = |problem: String| Error::Image {
        camera: camera.id().to_owned(),
        path: path.to_owned(),
        problem,
    };
    let broken = |cause: image::ImageError| refuse(format!("cannot be decoded: {cause}"));

    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(Error::read(path))?;
    let usable = |format: ImageFormat| format.reading_enabled();
    if !reader.format().is_some_and(usable) {
        return Err(refuse(
            "is none of PNG, JPEG, TIFF and BMP; convert it to one of them".into(),
        ));
    }
    let is_jpeg = reader.format() == Some(ImageFormat::Jpeg);
    let pixels = u64::from(camera.width()) * u64::from(camera.height());
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(pixels.min(MAX_PIXELS) * MAX_PIXEL_BYTES + DECODER_BYTES);
    reader.limits(limits);

    let mut decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    if (width, height) != (camera.width(), camera.height()) {
        return Err(refuse(format!(
            "expected {}x{} px as in the rig, got {width}x{height}; give the image as calibrated \
             or change the camera's size, focal lengths and principal point in the rig",
            camera.width(),
            camera.height()
        )));
    }
    if pixels > MAX_PIXELS {
        return Err(refuse(format!(
            "expected {MAX_PIXELS} px at most, got {width}x{height}; give a smaller image"
        )));
    }
    if is_jpeg && !jpeg::is_whole(bytes) {
        return Err(refuse(
            "ends before its last pixels; copy or take it again".into(),
        ));
    }
    if let Some(pages) = tiff::pages(bytes).filter(|pages| *pages > 1) {
        return Err(refuse(format!(
            "has {pages} pages, expected one; save the one that is meant as a file of its own"
        )));
    }
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    if orientation != Orientation::NoTransforms {
        return Err(refuse(format!(
            "is marked as rotated or mirrored (EXIF orientation {}); save it upright, as \
             calibrated, without the mark",
            orientation.to_exif()
        )));
    }
    let decoded = DynamicImage::from_decoder(decoder).map_err(broken)?;
    if let Some(problem) = value_problem(&decoded) {
        return Err(refuse(problem));
    }
    match gamma::correction(bytes) {
        None => Ok(decoded.into_rgb8()),
        Some(exponent) => {
            let mut samples = decoded.into_rgb16();
            gamma::corrected(&mut samples, exponent);
            Ok(DynamicImage::ImageRgb16(samples).into_rgb8())
        }
    }
}

/// Width and height of an image file, px; no more than its header is read.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] where it is no PNG, JPEG, TIFF or
/// BMP file.
pub fn size(path: &Path) -> Result<[u32; 2]> {
    let reader = ImageReader::new(BufReader::new(file::open(path)?));
    let reader = reader.with_guessed_format().map_err(Error::read(path))?;
    let (width, height) = reader.into_dimensions().map_err(|cause| {
        let path = path.display();
        Error::Data(format!(
            "image {path}: expected PNG, JPEG, TIFF or BMP, got: {cause}"
        ))
    })?;
    Ok([width, height])
}

/// What is wrong with the range of an image's values, if anything.
fn value_problem(image: &DynamicImage) -> Option<String> {
    match image {
        DynamicImage::ImageLuma16(image) => depth_problem(image.as_raw(), 1, 1),
        DynamicImage::ImageLumaA16(image) => depth_problem(image.as_raw(), 2, 1),
        DynamicImage::ImageRgb16(image) => depth_problem(image.as_raw(), 3, 3),
        DynamicImage::ImageRgba16(image) => depth_problem(image.as_raw(), 4, 3),
        DynamicImage::ImageRgb32F(image) => range_problem(image.as_raw()),
        DynamicImage::ImageRgba32F(image) => range_problem(image.as_raw()),
        _ => None,
    }
}

/// - `colors`: the first of each pixel's `channels`, without alpha
fn depth_problem(values: &[u16], channels: usize, colors: usize) -> Option<String> {
    let seen = values
        .chunks(channels)
        .flat_map(|pixel| pixel.iter().take(colors));
    let brightest = seen.copied().max().unwrap_or(0);
    // All black is not a question of bits.
    (1..=FOURTEEN_BITS).contains(&brightest).then(|| {
        let used = if brightest >> 12 == 0 { 12 } else { 14 };
        format!(
            "has 16 bits of which {used} at most are used, its brightest value being {brightest}; \
             scale the values to 0 to 65535, or save 8 bits"
        )
    })
}

fn range_problem(values: &[f32]) -> Option<String> {
    let wrong = values.iter().find(|value| !(0.0..=1.0).contains(*value))?;
    Some(format!(
        "expected floats from 0 to 1, got {wrong}; scale them, or save 8 or 16 bits"
    ))
}
