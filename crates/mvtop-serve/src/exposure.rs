//! One image of each camera, and what was found in them.

use std::path::Path;
use std::time::SystemTime;

use axum::body::Bytes;
use image::{ImageFormat, RgbImage};
use mvtop_core::image::decode;
use mvtop_core::{Camera, Error, Prediction, Request, Result, Rig, ViewImage};

/// An image as it came.
pub struct Upload {
    /// Index of the camera in the rig.
    pub camera: usize,
    pub bytes: Bytes,
    pub layout: Layout,
}

/// How an image's bytes are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// A file, which says itself what it is.
    File,
    /// Rows of grey bytes from the top, without padding.
    Mono8,
    /// Rows of three bytes each pixel.
    Rgb8,
    /// Rows of three bytes each pixel, blue first.
    Bgr8,
}

impl Layout {
    /// That of a part's content type.
    pub fn of(content_type: Option<&str>) -> Self {
        match content_type {
            Some("image/x-raw-mono8") => Self::Mono8,
            Some("image/x-raw-rgb8") => Self::Rgb8,
            Some("image/x-raw-bgr8") => Self::Bgr8,
            _ => Self::File,
        }
    }
}

impl Upload {
    pub fn decode(&self, camera: &Camera) -> Result<RgbImage> {
        let pixels = camera.width() as usize * camera.height() as usize;
        let channels = match self.layout {
            Layout::File => return decode(&self.bytes, Path::new("received"), camera),
            Layout::Mono8 => 1,
            Layout::Rgb8 | Layout::Bgr8 => 3,
        };
        let expected = pixels * channels;
        let wrong = || Error::Image {
            camera: camera.id().to_owned(),
            path: "received".into(),
            problem: format!(
                "expected {expected} raw bytes, {}x{} px of {channels}, got {}; send all rows without padding",
                camera.width(),
                camera.height(),
                self.bytes.len()
            ),
        };
        if self.bytes.len() != expected {
            return Err(wrong());
        }
        let rgb = match self.layout {
            Layout::Mono8 => self.bytes.iter().flat_map(|grey| [*grey; 3]).collect(),
            Layout::Bgr8 => {
                let pixels = self.bytes.chunks_exact(3);
                pixels.flat_map(|bgr| [bgr[2], bgr[1], bgr[0]]).collect()
            }
            _ => self.bytes.to_vec(),
        };
        RgbImage::from_raw(camera.width(), camera.height(), rgb).ok_or_else(wrong)
    }

    /// The image as a file, and how its name ends: raw bytes become a PNG of the same pixels.
    pub fn file(&self, camera: &Camera) -> (Bytes, &'static str) {
        if self.layout == Layout::File {
            let format = image::guess_format(&self.bytes).ok();
            let ending = format.and_then(|format| format.extensions_str().first().copied());
            return (self.bytes.clone(), ending.unwrap_or("bin"));
        }
        let mut png = std::io::Cursor::new(Vec::new());
        let written = self.decode(camera).is_ok_and(|image| {
            let written = image.write_to(&mut png, ImageFormat::Png);
            written.is_ok()
        });
        match written {
            true => (png.into_inner().into(), "png"),
            false => (self.bytes.clone(), "bin"),
        }
    }
}

/// Decodes all images; the first that is refused ends it.
pub fn decode_all(uploads: &[Upload], rig: &Rig) -> Result<Vec<ViewImage>> {
    let decoded = |upload: &Upload| {
        Ok(ViewImage {
            camera: upload.camera,
            image: upload.decode(&rig.cameras()[upload.camera])?,
        })
    };
    uploads.iter().map(decoded).collect()
}

/// What became of an exposure; its images are kept elsewhere, as long as there is room for them.
pub struct Exposure {
    /// Counts up from 1.
    pub number: u64,
    /// Of the request.
    pub id: String,
    pub time: SystemTime,
    /// Index of the model.
    pub model: usize,
    /// Index of the rig.
    pub rig: usize,
    /// Name of the stream that it belongs to, if any.
    pub stream: Option<String>,
    pub request: Request,
    /// From its arrival to the answer, milliseconds.
    pub took_ms: f64,
    /// What was found, or a sentence.
    pub outcome: std::result::Result<Found, String>,
}

/// What was found in an exposure.
pub struct Found {
    /// With the objects that were asked for alone.
    pub prediction: Prediction,
    /// With all objects.
    pub all: Prediction,
    /// The document, as `infer --json` prints it.
    pub json: String,
    pub accepted: bool,
    /// Exposures of the stream so far, with this one.
    pub stream_exposures: Option<u64>,
}

impl Found {
    /// The least confidence of a pose; `None` where there is none or the model does not say.
    pub fn least_confidence(&self) -> Option<f64> {
        let all = self.prediction.objects.iter();
        all.filter_map(|object| object.confidence).reduce(f64::min)
    }
}

impl Exposure {
    /// Why somebody should look at it, if so.
    ///
    /// - `below`: confidence below which a pose is not certain, where the request names none
    pub fn doubt(&self, below: f64) -> Option<String> {
        let found = match &self.outcome {
            Err(problem) => return Some(format!("failed: {problem}")),
            Ok(found) => found,
        };
        let least = self.request.min_confidence.unwrap_or(below);
        if found.prediction.objects.is_empty() {
            return Some("nothing was found".into());
        }
        if let Some(warning) = found.prediction.warnings.first() {
            return Some(format!("warning: {}", warning.message));
        }
        let confidence = found.least_confidence().filter(|lowest| *lowest < least)?;
        Some(format!(
            "a pose has a confidence of {confidence:.3}, below {least}"
        ))
    }
}

#[cfg(test)]
impl Exposure {
    /// One of that number, which failed that many seconds after the epoch.
    pub fn failed(number: u64) -> Self {
        Self {
            number,
            id: "a".into(),
            time: SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(number),
            model: 0,
            rig: 0,
            stream: None,
            request: Request::default(),
            took_ms: 1.0,
            outcome: Err("a sentence".into()),
        }
    }
}
