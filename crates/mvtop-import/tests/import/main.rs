//! Files of each format: hand-worked cases, what is asked for, and rigs that are written and read.

mod asked;
mod by_hand;
mod contradictions;
mod fitted;
mod formats;
mod hostile;
mod joined;
mod levels;
mod stated;
mod texts;
mod unread;
mod written;

use std::path::PathBuf;

use mvtop_geometry::{Camera, Result};
use mvtop_import::{Imported, Options, import};
use tempfile::TempDir;

/// Imports files of these names and contents.
fn read(files: &[(&str, &str)], options: &Options) -> Result<Imported> {
    let files: Vec<_> = files
        .iter()
        .map(|(name, text)| (*name, text.as_bytes()))
        .collect();
    read_bytes(&files, options)
}

fn read_bytes(files: &[(&str, &[u8])], options: &Options) -> Result<Imported> {
    let folder = TempDir::new().unwrap();
    let paths: Vec<PathBuf> = files
        .iter()
        .map(|(name, bytes)| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, bytes).unwrap();
            path
        })
        .collect();
    import(&paths, options)
}

fn refusal(files: &[(&str, &str)], options: &Options) -> String {
    let error = read(files, options).unwrap_err().to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    error
}

fn scaled(scale: f64) -> Options {
    Options {
        scale: Some(scale),
        ..Options::default()
    }
}

fn assert_near<const N: usize>(got: [f64; N], expected: [f64; N]) {
    let far = got.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-9);
    assert!(!far, "{got:?} instead of {expected:?}");
}

/// Where a camera is, and where its x and z axes point, in the world.
fn assert_pose(camera: &Camera, at: [f64; 3], x: [f64; 3], z: [f64; 3]) {
    let pose = camera.world_from_cam();
    assert_near(pose.translation.vector.into(), at);
    let axis = |index| -> [f64; 3] {
        let matrix = pose.rotation.to_rotation_matrix();
        matrix.matrix().column(index).into_owned().into()
    };
    assert_near(axis(0), x);
    assert_near(axis(2), z);
}

fn assert_plane(camera: &Camera, plane: [f64; 4]) {
    let of = camera.intrinsics();
    assert_near([of.fx(), of.fy(), of.cx(), of.cy()], plane);
}

/// Coefficients in a rig's order; those that are not listed are 0.
fn assert_params(camera: &Camera, expected: &[f64]) {
    let mut got = camera.intrinsics().projection().params().to_vec();
    while got.len() > expected.len() && got.last() == Some(&0.0) {
        got.pop();
    }
    assert_eq!(got, expected);
}
