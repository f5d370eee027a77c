use std::fs;
use std::path::PathBuf;

use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageEncoder, Luma, LumaA, Rgb, RgbImage, Rgba};
use mvtop_core::image::{Letterbox, load, load_views, to_tensor};
use mvtop_core::{Camera, Rig};
use ndarray::s;
use proptest::prelude::*;
use tempfile::TempDir;

use super::camera;
use super::examples::pinhole;

const ZERO: [f32; 3] = [0.0; 3];
const ONE: [f32; 3] = [1.0; 3];

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn written(folder: &TempDir, name: &str, image: impl Into<DynamicImage>) -> PathBuf {
    let path = folder.path().join(name);
    image.into().save(&path).unwrap();
    path
}

fn left(width: u32, height: u32) -> mvtop_core::Camera {
    let [cx, cy] = [width, height].map(|side| f64::from(side) / 2.0);
    camera(pinhole(600.0, cx, cy), width, height)
}

/// The header of a PNG file of that size, and nothing else.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut image = Vec::new();
    let pixel = RgbImage::new(1, 1);
    let encoder = image::codecs::png::PngEncoder::new(&mut image);
    encoder
        .write_image(&pixel, 1, 1, image::ExtendedColorType::Rgb8)
        .unwrap();
    image[16..20].copy_from_slice(&width.to_be_bytes());
    image[20..24].copy_from_slice(&height.to_be_bytes());
    let crc = image[12..29].iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())
        })
    });
    image[29..33].copy_from_slice(&(!crc).to_be_bytes());
    image.truncate(60);
    image
}

#[test]
fn every_kind_of_pixel_becomes_rgb8() {
    let folder = folder();
    let camera = left(3, 2);
    let grey = image::GrayImage::from_pixel(3, 2, Luma([7]));
    let grey_alpha = image::GrayAlphaImage::from_pixel(3, 2, LumaA([7, 0]));
    let rgb = RgbImage::from_pixel(3, 2, Rgb([1, 2, 3]));
    let (grey_tiff, rgb_bmp) = (grey.clone(), rgb.clone());
    let rgba = image::RgbaImage::from_pixel(3, 2, Rgba([1, 2, 3, 0]));
    let deep = image::ImageBuffer::from_pixel(3, 2, Rgb([257u16, 514, 51400]));
    let float = image::Rgb32FImage::from_pixel(3, 2, Rgb([0.0, 0.2, 1.0]));
    for (name, image, expected) in [
        ("grey.png", DynamicImage::from(grey), [7, 7, 7]),
        ("grey_alpha.png", grey_alpha.into(), [7, 7, 7]),
        ("rgb.png", rgb.into(), [1, 2, 3]),
        ("rgba.png", rgba.into(), [1, 2, 3]),
        ("deep.png", deep.clone().into(), [1, 2, 200]),
        ("grey.tif", grey_tiff.into(), [7, 7, 7]),
        ("deep.tif", deep.into(), [1, 2, 200]),
        ("float.tif", float.into(), [0, 51, 255]),
        ("rgb.bmp", rgb_bmp.into(), [1, 2, 3]),
    ] {
        let loaded = load(&written(&folder, name, image), &camera).unwrap();
        assert_eq!(loaded.dimensions(), (3, 2), "{name}");
        assert!(
            loaded.pixels().all(|p| p.0 == expected),
            "{name}: {:?}",
            loaded.get_pixel(0, 0)
        );
    }
    let jpeg = written(
        &folder,
        "flat.jpg",
        RgbImage::from_pixel(3, 2, Rgb([90, 90, 90])),
    );
    assert!(
        load(&jpeg, &camera)
            .unwrap()
            .pixels()
            .all(|p| p.0.iter().all(|x| x.abs_diff(90) < 3))
    );
}

#[test]
fn unusable_files_are_refused_in_one_sentence() {
    let folder = folder();
    let whole = fs::read(written(&folder, "whole.png", RgbImage::new(64, 48))).unwrap();
    let bytes = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let mut turned = Vec::new();
    let mut encoder = JpegEncoder::new(&mut turned);
    let orientation_6 = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    encoder.set_exif_metadata(orientation_6.to_vec()).unwrap();
    encoder.encode_image(&RgbImage::new(64, 48)).unwrap();
    for (path, facts) in [
        (
            written(&folder, "small.png", RgbImage::new(32, 24)),
            ["expected 64x48 px", "got 32x24"],
        ),
        (
            written(&folder, "small.jpg", RgbImage::new(32, 24)),
            ["expected 64x48 px", "got 32x24"],
        ),
        (
            bytes("huge.png", &png_header(2_000_000, 2_000_000)),
            ["expected 64x48", "2000000"],
        ),
        (
            bytes("cut.png", &whole[..whole.len() / 2]),
            ["cut.png", "cannot be decoded"],
        ),
        (
            bytes("empty.png", b""),
            ["none of PNG, JPEG, TIFF and BMP", "convert"],
        ),
        (
            bytes("text.png", b"no image at all"),
            ["none of PNG, JPEG, TIFF and BMP", "convert"],
        ),
        (
            bytes("anim.gif", b"GIF89a\x01\0\x01\0\0\0\0"),
            ["none of PNG, JPEG, TIFF and BMP", "convert"],
        ),
        (
            bytes("turned.jpg", &turned),
            ["rotated", "EXIF orientation 6"],
        ),
        (
            folder.path().join("absent.png"),
            ["cannot read", "absent.png"],
        ),
    ] {
        let error = load(&path, &left(64, 48)).unwrap_err().to_string();
        for fact in facts {
            assert!(error.contains(fact), "`{error}` lacks `{fact}`");
        }
        let is_about_file = error.starts_with("cannot read");
        assert!(is_about_file || error.contains("camera `left`"), "{error}");
    }
}

#[test]
fn images_whose_values_cannot_be_what_was_seen_are_refused() {
    let (folder, camera) = (folder(), left(64, 48));
    let twelve_bits = image::ImageBuffer::from_fn(64, 48, |x, _| Luma([x as u16 * 65]));
    let fourteen_bits = image::ImageBuffer::from_fn(64, 48, |x, _| Luma([x as u16 * 260]));
    let with_alpha = image::ImageBuffer::from_fn(64, 48, |x, _| LumaA([x as u16 * 65, u16::MAX]));
    let float = |value| image::Rgb32FImage::from_pixel(64, 48, Rgb([0.5, value, 0.5]));
    for (name, image, fact) in [
        (
            "12.png",
            DynamicImage::from(twelve_bits),
            "brightest value being 4095",
        ),
        (
            "14.tif",
            DynamicImage::from(fourteen_bits),
            "of which 14 at most are used, its brightest value being 16380",
        ),
        ("alpha.png", with_alpha.into(), "brightest value being 4095"),
        (
            "bright.tif",
            float(255.0).into(),
            "floats from 0 to 1, got 255",
        ),
        (
            "below.tif",
            float(-0.1).into(),
            "floats from 0 to 1, got -0.1",
        ),
        (
            "nan.tif",
            float(f32::NAN).into(),
            "floats from 0 to 1, got NaN",
        ),
    ] {
        let error = load(&written(&folder, name, image), &camera).unwrap_err();
        assert!(error.to_string().contains(fact), "{error}");
    }
    // Black is no question of bits.
    let black = image::ImageBuffer::from_pixel(64, 48, Luma([0u16]));
    load(
        &written(&folder, "black.png", DynamicImage::from(black)),
        &camera,
    )
    .unwrap();

    let ramp = RgbImage::from_fn(64, 48, |x, y| Rgb([4 * x as u8, 5 * y as u8, 99]));
    let jpeg = fs::read(written(&folder, "whole.jpg", ramp)).unwrap();
    for share in [3, 2] {
        let path = folder.path().join("cut.jpg");
        fs::write(&path, &jpeg[..jpeg.len() - jpeg.len() / (3 * share)]).unwrap();
        let error = load(&path, &camera).unwrap_err().to_string();
        assert!(error.contains("ends before its last pixels"), "{error}");
    }
}

#[test]
fn a_tiff_of_several_pages_is_refused() {
    let (folder, camera) = (folder(), left(64, 48));
    let picture = DynamicImage::from(RgbImage::from_pixel(64, 48, Rgb([90, 9, 200])));
    let path = written(&folder, "pages.tif", picture);
    load(&path, &camera).unwrap();
    // The directory's last number is where the next one is: here, a copy of it at the end of the file.
    let mut bytes = fs::read(&path).unwrap();
    let four = |bytes: &[u8], at: usize| {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    };
    let first = four(&bytes, 4);
    let entries = usize::from(u16::from_le_bytes([bytes[first], bytes[first + 1]]));
    let next = first + 2 + 12 * entries;
    assert_eq!(four(&bytes, next), 0);
    let copy = bytes[first..next + 4].to_vec();
    let end = u32::try_from(bytes.len()).unwrap();
    bytes[next..next + 4].copy_from_slice(&end.to_le_bytes());
    bytes.extend(copy);
    fs::write(&path, bytes).unwrap();
    let error = load(&path, &camera).unwrap_err().to_string();
    assert!(error.contains("has 2 pages, expected one"), "{error}");
}

#[test]
fn a_png_s_gamma_is_applied() {
    let (folder, camera) = (folder(), left(64, 48));
    let picture = RgbImage::from_pixel(64, 48, Rgb([0, 64, 255]));
    let path = written(&folder, "linear.png", picture);
    let bytes = fs::read(&path).unwrap();
    // After the header of 8 bytes and IHDR of 25: length, kind, linear, checksum.
    let mut with_gamma = bytes[..33].to_vec();
    with_gamma.extend([0, 0, 0, 4]);
    with_gamma.extend(b"gAMA");
    with_gamma.extend(100_000u32.to_be_bytes());
    with_gamma.extend([0x31, 0xe8, 0x96, 0x5f]);
    with_gamma.extend(&bytes[33..]);
    fs::write(&path, with_gamma).unwrap();
    let loaded = load(&path, &camera).unwrap();
    let expected = (255.0 * (64.0f64 / 255.0).powf(1.0 / 2.2)).round() as u8;
    assert_eq!(*loaded.get_pixel(5, 5), Rgb([0, expected, 255]));
}

#[test]
fn an_image_of_the_networks_size_is_only_normalised() {
    let image = RgbImage::from_fn(4, 2, |x, y| Rgb([x as u8, 10 * y as u8, 255]));
    let letterbox = Letterbox::new(4, 2, 4, 2);
    assert_eq!((letterbox.su, letterbox.sv), (1.0, 1.0));
    let (mean, std) = ([0.5, 0.25, 0.0], [0.5, 0.25, 2.0]);
    let tensor = to_tensor(&image, &letterbox, mean, std).unwrap();
    assert_eq!(tensor.dim(), (3, 2, 4));
    assert_eq!(tensor[[0, 1, 3]], (3.0 / 255.0 - 0.5) / 0.5);
    assert_eq!(tensor[[1, 1, 0]], (10.0 / 255.0 - 0.25) / 0.25);
    assert_eq!(tensor[[2, 0, 0]], 0.5);
}

#[test]
fn the_rest_is_padded_with_zero_after_normalisation() {
    let image = RgbImage::from_pixel(1280, 720, Rgb([255; 3]));
    let letterbox = Letterbox::new(1280, 720, 640, 480);
    assert_eq!(
        (letterbox.resized_width, letterbox.resized_height),
        (640, 360)
    );
    let tensor = to_tensor(&image, &letterbox, [0.5; 3], ONE).unwrap();
    assert!(tensor.slice(s![.., ..360, ..]).iter().all(|&x| x == 0.5));
    assert!(tensor.slice(s![.., 360.., ..]).iter().all(|&x| x == 0.0));
}

#[test]
fn an_image_of_another_size_than_the_letterboxs_is_an_error() {
    let letterbox = Letterbox::new(64, 48, 32, 32);
    let error = to_tensor(&RgbImage::new(48, 64), &letterbox, ZERO, ONE)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("64x48") && error.contains("[48, 64]"),
        "{error}"
    );
}

#[test]
fn content_moves_as_the_letterbox_says() {
    // A ramp keeps its slope under any resize, so a pixel's value tells where it came from.
    let image = RgbImage::from_fn(240, 160, |x, y| Rgb([x as u8, y as u8, 0]));
    for (net_width, net_height) in [(120, 80), (100, 100), (160, 60), (480, 320)] {
        let letterbox = Letterbox::new(240, 160, net_width, net_height);
        let tensor = to_tensor(&image, &letterbox, ZERO, [1.0 / 255.0; 3]).unwrap();
        // The filter is one-sided near the border.
        for y in 4..letterbox.resized_height - 4 {
            for x in 4..letterbox.resized_width - 4 {
                let [u, v] = letterbox.image_from_net([f64::from(x), f64::from(y)]);
                let at = |channel| f64::from(tensor[[channel, y as usize, x as usize]]);
                // Half a grey level of rounding, and some for fixed-point filter weights.
                assert!(
                    (at(0) - u).abs() < 0.8,
                    "{net_width}: ({x}, {y}) is {} not {u}",
                    at(0)
                );
                assert!(
                    (at(1) - v).abs() < 0.8,
                    "{net_width}: ({x}, {y}) is {} not {v}",
                    at(1)
                );
            }
        }
    }
}

#[test]
fn shrinking_averages_fine_stripes() {
    let image = RgbImage::from_fn(256, 64, |x, _| Rgb([if x % 4 < 2 { 0 } else { 200 }; 3]));
    let tensor = to_tensor(
        &image,
        &Letterbox::new(256, 64, 64, 16),
        ZERO,
        [1.0 / 255.0; 3],
    )
    .unwrap();
    let inner = tensor.slice(s![.., .., 2..62]);
    assert!(inner.iter().all(|x| (x - 100.0).abs() < 20.0), "{inner}");
}

proptest! {
    #[test]
    fn the_letterbox_fits_and_maps_border_to_border(
        width in 1..5000u32,
        height in 1..5000u32,
        net_width in 1..2000u32,
        net_height in 1..2000u32,
    ) {
        let letterbox = Letterbox::new(width, height, net_width, net_height);
        let (w, h) = (letterbox.resized_width, letterbox.resized_height);
        prop_assert!(w <= net_width && h <= net_height && (w == net_width || h == net_height));
        let corner = [f64::from(width) - 0.5, f64::from(height) - 0.5];
        let [u, v] = letterbox.net_from_image(corner);
        prop_assert!((u - f64::from(w) + 0.5).abs() < 1e-9);
        prop_assert!((v - f64::from(h) + 0.5).abs() < 1e-9);
        prop_assert_eq!(letterbox.net_from_image([-0.5, -0.5]), [-0.5, -0.5]);
        let [u, v] = letterbox.image_from_net(letterbox.net_from_image([12.25, 3.5]));
        prop_assert!((u - 12.25).abs() < 1e-9 && (v - 3.5).abs() < 1e-9);
    }

    #[test]
    fn no_bytes_make_loading_panic(
        end in prop::sample::select(vec!["png", "jpg", "tif", "bmp"]),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        length in any::<prop::sample::Index>(),
    ) {
        let folder = folder();
        let path = written(&folder, &format!("a.{end}"), RgbImage::new(16, 12));
        let mut bytes = fs::read(&path).unwrap();
        for (at, byte) in edits {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(length.index(2 * bytes.len()));
        fs::write(&path, bytes).unwrap();
        if let Ok(image) = load(&path, &left(16, 12)) {
            prop_assert_eq!(image.dimensions(), (16, 12));
        }
    }
}

#[test]
fn images_of_several_cameras_come_in_the_order_of_their_files() {
    let folder = folder();
    let of = |id: usize| {
        Camera::new(
            id.to_string(),
            [3, 2],
            pinhole(3.0, 1.5, 1.0),
            nalgebra::Isometry3::translation(id as f64, 0.0, 0.0),
        )
    };
    let rig = Rig::new((0..4).map(|id| of(id).unwrap()).collect(), 0).unwrap();
    let file = |camera: usize| {
        let image = RgbImage::from_pixel(3, 2, Rgb([camera as u8; 3]));
        (camera, written(&folder, &format!("{camera}.png"), image))
    };
    let mut files: Vec<_> = [2, 0, 3, 1].map(file).into();
    let views = load_views(&rig, &files).unwrap();
    let seen = views.iter().map(|view| (view.camera, view.image[(2, 1)]));
    let expected = [2, 0, 3, 1].map(|camera| (camera, Rgb([camera as u8; 3])));
    assert_eq!(seen.collect::<Vec<_>>(), expected);
    // The first of two that cannot be read is named.
    for broken in [3, 1] {
        files[broken].1 = folder.path().join(format!("none {broken}"));
    }
    let error = load_views(&rig, &files).unwrap_err().to_string();
    assert!(error.contains("none 1"), "{error}");
}
