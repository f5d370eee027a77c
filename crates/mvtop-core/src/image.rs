//! Images: from file to the network's input.

mod gamma;
mod jpeg;
mod load;
mod pyramid;
mod tiff;

use fast_image_resize as fir;
use image::RgbImage;
use ndarray::{Array3, ArrayViewMut3};

use crate::{BBox, Error, Result};
pub use load::{decode, load, load_views, size};
pub use pyramid::Pyramid;

/// Images whose values differ by no more than this, of 255, in any channel show nothing.
const ONE_COLOR: u8 = 8;

/// What one camera of a rig saw.
#[derive(Debug, Clone)]
pub struct ViewImage {
    /// Index of the camera in the rig.
    pub camera: usize,
    /// Of the camera's size.
    pub image: RgbImage,
}

/// Whether an image is of one color, up to noise: of a covered, dead or blinded camera.
pub(crate) fn is_one_color(image: &RgbImage) -> bool {
    let (mut least, mut most) = ([u8::MAX; 3], [0; 3]);
    // Row by row, as most images are decided by their first ones.
    let row = image.width().max(1) as usize * 3;
    image.as_raw().chunks(row).all(|row| {
        for pixel in row.chunks_exact(3) {
            for channel in 0..3 {
                least[channel] = least[channel].min(pixel[channel]);
                most[channel] = most[channel].max(pixel[channel]);
            }
        }
        (0..3).all(|channel| most[channel].saturating_sub(least[channel]) <= ONE_COLOR)
    })
}

/// How an image lies in the network's input: scaled to fit, at the top left, the rest padded.
#[derive(Debug, Clone, PartialEq)]
pub struct Letterbox {
    /// Width of the image, px.
    pub width: u32,
    /// Height of the image, px.
    pub height: u32,
    /// Width of the network's input, px.
    pub net_width: u32,
    /// Height of the network's input, px.
    pub net_height: u32,
    /// Width of the scaled image in the input, px.
    pub resized_width: u32,
    /// Height of the scaled image in the input, px.
    pub resized_height: u32,
    /// Network pixels per image pixel along u: exact, after rounding to whole pixels.
    pub su: f64,
    /// The same along v.
    pub sv: f64,
}

impl Letterbox {
    /// The letterbox of an image of `width` x `height` px; sizes of 0 count as 1.
    pub fn new(width: u32, height: u32, net_width: u32, net_height: u32) -> Self {
        let [width, height, net_width, net_height] =
            [width, height, net_width, net_height].map(|size| size.max(1));
        let (w, h) = (f64::from(width), f64::from(height));
        let scale = (f64::from(net_width) / w).min(f64::from(net_height) / h);
        let resized_width = ((w * scale).round() as u32).clamp(1, net_width);
        let resized_height = ((h * scale).round() as u32).clamp(1, net_height);
        Self {
            width,
            height,
            net_width,
            net_height,
            resized_width,
            resized_height,
            su: f64::from(resized_width) / w,
            sv: f64::from(resized_height) / h,
        }
    }

    /// A box of the image in the network's input.
    pub fn net_box(&self, bbox: BBox) -> BBox {
        let [x0, y0] = self.net_from_image([bbox.x0, bbox.y0]);
        let [x1, y1] = self.net_from_image([bbox.x1, bbox.y1]);
        BBox { x0, y0, x1, y1 }
    }

    /// A box of the network's input in the image; it may reach beyond the image.
    pub fn image_box(&self, bbox: BBox) -> BBox {
        let [x0, y0] = self.image_from_net([bbox.x0, bbox.y0]);
        let [x1, y1] = self.image_from_net([bbox.x1, bbox.y1]);
        BBox { x0, y0, x1, y1 }
    }

    /// Network pixel of an image pixel, `[u, v]`.
    pub fn net_from_image(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [(u + 0.5) * self.su - 0.5, (v + 0.5) * self.sv - 0.5]
    }

    /// Image pixel of a network pixel, `[u, v]`; it may lie outside the image.
    pub fn image_from_net(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [(u + 0.5) / self.su - 0.5, (v + 0.5) / self.sv - 0.5]
    }
}

/// The network's input for one image: antialiased bilinear resize, then `(x/255 - mean)/std`.
///
/// - `mean`, `std`: per channel, RGB, for values in `[0, 1]`
/// - returns: `[3, net_height, net_width]`, padded with 0 after normalisation
///
/// # Errors
/// [`Error::Shape`] where the letterbox is of another image size.
pub fn to_tensor(
    image: &RgbImage,
    letterbox: &Letterbox,
    mean: [f32; 3],
    std: [f32; 3],
) -> Result<Array3<f32>> {
    let [rows, columns] = [letterbox.net_height, letterbox.net_width].map(|n| n as usize);
    let mut tensor = Array3::zeros((3, rows, columns));
    fill(
        tensor.view_mut(),
        &Pyramid::new(image),
        letterbox,
        mean,
        std,
    )?;
    Ok(tensor)
}

/// [`to_tensor`] into zeros.
///
/// - `tensor`: `[3, net_height, net_width]`
pub(crate) fn fill(
    mut tensor: ArrayViewMut3<f32>,
    image: &Pyramid,
    letterbox: &Letterbox,
    mean: [f32; 3],
    std: [f32; 3],
) -> Result<()> {
    let Letterbox { width, height, .. } = letterbox;
    let resized = resize(image, letterbox).map_err(|()| Error::Shape {
        name: "image",
        expected: format!("{width}x{height} px, the letterbox's"),
        got: vec![
            image.image().width() as usize,
            image.image().height() as usize,
        ],
    })?;
    let width = letterbox.resized_width as usize;
    for (channel, mut plane) in tensor.outer_iter_mut().enumerate() {
        let normalised: [f32; 256] =
            std::array::from_fn(|x| (x as f32 / 255.0 - mean[channel]) / std[channel]);
        for (mut out, row) in plane.outer_iter_mut().zip(resized.chunks_exact(3 * width)) {
            for (out, pixel) in out.iter_mut().zip(row.chunks_exact(3)) {
                *out = normalised[usize::from(pixel[channel])];
            }
        }
    }
    Ok(())
}

/// RGB bytes of the image at its size within the letterbox.
fn resize(image: &Pyramid, letterbox: &Letterbox) -> Result<Vec<u8>, ()> {
    if image.image().dimensions() != (letterbox.width, letterbox.height) {
        return Err(());
    }
    let size = [letterbox.resized_width, letterbox.resized_height];
    resized(image.of_size(size), size)
}

/// RGB bytes of the image at another size, without aliasing; unchanged where that is its own size.
pub(crate) fn resized(image: &RgbImage, [width, height]: [u32; 2]) -> Result<Vec<u8>, ()> {
    if image.dimensions() == (width, height) {
        return Ok(image.as_raw().clone());
    }
    use fir::images::{TypedImage, TypedImageRef};
    let mut resized = vec![0; width as usize * height as usize * 3];
    // Typed, because the untyped call compiles the resizer for every pixel type there is: a minute.
    type Rgb = fir::pixels::U8x3;
    let from = TypedImageRef::<Rgb>::from_buffer(image.width(), image.height(), image.as_raw())
        .map_err(drop)?;
    let mut to = TypedImage::<Rgb>::from_buffer(width, height, &mut resized).map_err(drop)?;
    let bilinear = fir::ResizeOptions::new()
        .resize_alg(fir::ResizeAlg::Convolution(fir::FilterType::Bilinear));
    fir::Resizer::new()
        .resize_typed(&from, &mut to, &bilinear)
        .map_err(drop)?;
    Ok(resized)
}
