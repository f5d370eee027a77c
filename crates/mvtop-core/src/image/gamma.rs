//! The gamma that a PNG file states.
//!
//! Source: <https://www.w3.org/TR/png-3>, 11.3.2 and 13.13: `gAMA` is 100000 times the exponent of the samples;
//! where there is `cICP`, `iCCP` or `sRGB` as well, these count. Networks know images as cameras and screens have
//! them, of 1 / 2.2.

/// Exponent of samples that are taken as they are.
const USUAL: f64 = 1.0 / 2.2;
/// Exponents that differ by this share are the same: 0.45455 and 0.45.
const SAME: f64 = 0.05;

/// The exponent that turns a PNG file's samples, 0 to 1, into the usual ones; `None` where they are these.
pub fn correction(png: &[u8]) -> Option<f64> {
    let mut rest = png.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    let mut stated = None;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk()?) as usize;
        let kind = rest.get(4..8)?;
        match kind {
            b"cICP" | b"iCCP" | b"sRGB" => return None,
            b"gAMA" => stated = Some(u32::from_be_bytes(*rest.get(8..)?.first_chunk()?)),
            b"IDAT" => break,
            _ => {}
        }
        rest = rest.get(length.checked_add(12)?..)?;
    }
    let exponent = f64::from(stated?) / 1e5;
    let correction = USUAL / exponent;
    (exponent > 0.0 && (correction - 1.0).abs() > SAME).then_some(correction)
}

/// The same samples of 16 bits by that exponent.
pub fn corrected(samples: &mut [u16], exponent: f64) {
    let most = f64::from(u16::MAX);
    let table: Vec<u16> = (0..=u16::MAX)
        .map(|sample| (most * (f64::from(sample) / most).powf(exponent)).round() as u16)
        .collect();
    for sample in samples {
        *sample = table[usize::from(*sample)];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, data) in chunks {
            bytes.extend((data.len() as u32).to_be_bytes());
            bytes.extend(*kind);
            bytes.extend(*data);
            bytes.extend([0; 4]);
        }
        bytes
    }

    #[test]
    fn only_an_unusual_gamma_without_a_profile_is_corrected() {
        let gamma = |value: u32| value.to_be_bytes();
        let of = |value: u32| correction(&png(&[(b"gAMA", &gamma(value)), (b"IDAT", &[])]));
        assert_eq!(of(45_455), None);
        assert_eq!(of(45_000), None);
        assert_eq!(of(0), None);
        assert!((of(100_000).unwrap() - 1.0 / 2.2).abs() < 1e-12);
        let linear = gamma(100_000);
        let with = |kind| correction(&png(&[(b"gAMA", &linear), (kind, &[0]), (b"IDAT", &[])]));
        assert_eq!(with(b"sRGB"), None);
        assert_eq!(with(b"iCCP"), None);
        assert!(with(b"tEXt").is_some());
        assert_eq!(correction(&png(&[(b"IDAT", &[])])), None);
        assert_eq!(correction(b"no PNG"), None);
    }

    #[test]
    fn linear_samples_become_brighter_but_for_black_and_white() {
        let mut samples = [0, 16_384, u16::MAX];
        corrected(&mut samples, 1.0 / 2.2);
        assert_eq!([samples[0], samples[2]], [0, u16::MAX]);
        let expected = 65_535.0 * 0.25f64.powf(1.0 / 2.2);
        assert!((f64::from(samples[1]) - expected).abs() < 5.0);
    }
}
