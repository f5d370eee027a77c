//! Whether a JPEG file is whole. Decoders fill up what is missing with grey, so they do not tell.

/// Whether the file goes on to its end: from segment to segment, over the coded pixels of each scan,
/// to the marker that ends the image. What follows it is not looked at.
///
/// Source: ITU-T T.81, annex B.
pub(super) fn is_whole(bytes: &[u8]) -> bool {
    const END: u8 = 0xD9;
    const SCAN: u8 = 0xDA;
    let mut rest = bytes;
    while let Some((marker, after)) = next_marker(rest) {
        rest = match marker {
            END => return true,
            // Start of the image and its like, restarts: nothing but the marker.
            0x01 | 0xD0..=0xD8 => after,
            _ => {
                let length = after
                    .first_chunk()
                    .map_or(0, |&bytes| u16::from_be_bytes(bytes));
                let Some(after) = after.get(usize::from(length).max(2)..) else {
                    return false;
                };
                match marker {
                    SCAN => coded(after),
                    _ => after,
                }
            }
        };
    }
    false
}

/// The marker that comes next, fill bytes left out, and what follows it.
fn next_marker(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let start = bytes.iter().position(|&byte| byte == 0xFF)?;
    let fill = bytes[start..].iter().position(|&byte| byte != 0xFF)?;
    let (marker, after) = bytes[start + fill..].split_first()?;
    Some((*marker, after))
}

/// What follows the coded pixels: 0xFF is written as 0xFF00 in them.
fn coded(mut bytes: &[u8]) -> &[u8] {
    while let Some(at) = bytes.iter().position(|&byte| byte == 0xFF) {
        match bytes.get(at + 1) {
            Some(0) => bytes = &bytes[at + 2..],
            _ => return &bytes[at..],
        }
    }
    &[]
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{Rgb, RgbImage};

    #[test]
    fn whole_and_cut_files_are_told_apart_at_every_length() {
        let image = RgbImage::from_fn(64, 48, |x, y| Rgb([x as u8 * 4, y as u8 * 5, 99]));
        let mut thumbnail = Vec::new();
        let mut encoder = JpegEncoder::new(&mut thumbnail);
        encoder.encode_image(&image).unwrap();
        // A preview within the file has an end of its own.
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new(&mut bytes);
        image::ImageEncoder::set_exif_metadata(&mut encoder, thumbnail).unwrap();
        encoder.encode_image(&image).unwrap();
        assert!(is_whole(&bytes));
        assert!(is_whole(&[&bytes[..], b"padding of a camera"].concat()));
        for end in 0..bytes.len() {
            assert!(!is_whole(&bytes[..end]), "{end} of {}", bytes.len());
        }
    }
}
