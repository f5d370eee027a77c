//! All views in one picture.

use image::RgbImage;
use image::imageops::replace;

use crate::image::resized;

/// Height of the views in a contact sheet, and the gap between them, px.
const HEIGHT: u32 = 480;
const GAP: u32 = 6;
/// As many views stand in one row; more are laid out as a square, as far as they go.
const ONE_ROW: usize = 3;

/// The images in rows, at one height each; empty without images.
pub fn contact_sheet(images: &[RgbImage]) -> RgbImage {
    let columns = match images.len() {
        0 => return RgbImage::new(0, 0),
        count @ 1..=ONE_ROW => count,
        count => (count as f64).sqrt().ceil() as usize,
    };
    let rows: Vec<&[RgbImage]> = images.chunks(columns).collect();
    let row_width =
        |row: &&[RgbImage]| row.iter().map(width).sum::<u32>() + GAP * (row.len() as u32 - 1);
    let widest = rows.iter().map(row_width).max().unwrap_or_default();
    let count = rows.len() as u32;
    let mut sheet = RgbImage::new(widest, count * HEIGHT + GAP * (count - 1));
    for (row, images) in rows.into_iter().enumerate() {
        let top = row as i64 * i64::from(HEIGHT + GAP);
        let mut left = 0;
        for image in images {
            let view = resized(image, [width(image), HEIGHT]).ok();
            let view = view.and_then(|bytes| RgbImage::from_raw(width(image), HEIGHT, bytes));
            // An empty image stays black.
            if let Some(view) = view {
                replace(&mut sheet, &view, left, top);
            }
            left += i64::from(width(image) + GAP);
        }
    }
    sheet
}

/// Width of an image at the sheet's height, px.
fn width(image: &RgbImage) -> u32 {
    let (width, height) = (u64::from(image.width()), u64::from(image.height().max(1)));
    // No view may be wider than sixteen times its height.
    (width * u64::from(HEIGHT) / height).clamp(1, 16 * u64::from(HEIGHT)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_keep_their_colors_and_places() {
        let plain = |value| RgbImage::from_pixel(960, 960, image::Rgb([value; 3]));
        let sheet = contact_sheet(&[plain(10), plain(200)]);
        assert_eq!(sheet.get_pixel(240, 240).0, [10; 3]);
        assert_eq!(sheet.get_pixel(480 + GAP / 2, 240).0, [0; 3]);
        assert_eq!(sheet.get_pixel(480 + GAP + 240, 240).0, [200; 3]);
    }

    #[test]
    fn sheet_has_views_at_one_height_in_rows() {
        let (wide, square) = (RgbImage::new(640, 480), RgbImage::new(960, 960));
        let of = |images: &[&RgbImage]| {
            let images: Vec<RgbImage> = images.iter().map(|image| (*image).clone()).collect();
            contact_sheet(&images).dimensions()
        };
        assert_eq!(of(&[&wide, &square]), (640 + GAP + 480, 480));
        assert_eq!(of(&[&wide; 3]), (3 * 640 + 2 * GAP, 480));
        assert_eq!(of(&[&wide; 4]), (2 * 640 + GAP, 2 * 480 + GAP));
        assert_eq!(of(&[&wide; 8]), (3 * 640 + 2 * GAP, 3 * 480 + 2 * GAP));
        assert_eq!(of(&[]), (0, 0));
        assert_eq!(of(&[&RgbImage::new(0, 0), &wide]), (1 + GAP + 640, 480));
    }
}
