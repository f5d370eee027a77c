use mvtop_import::{Format, ImageSize, Options};

use super::samples::ZED;
use super::{X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal};

fn of_size(text: &str) -> Options {
    Options {
        image_sizes: vec![ImageSize::parse(text).unwrap()],
        ..Options::default()
    }
}

#[test]
fn right_camera_is_a_baseline_to_the_right_of_the_left_one() {
    let imported = read(&[("SN123.conf", ZED)], &of_size("1280x720")).unwrap();
    assert_eq!(imported.format, Format::Zed);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((left.id(), right.id()), ("left", "right"));
    assert_eq!((left.width(), left.height()), (1280, 720));
    assert_plane(left, [700.0, 701.0, 640.0, 360.0]);
    assert_params(left, &[-0.17, 0.02, 1e-4, -2e-4, 0.003]);
    assert_pose(left, [0.0; 3], X, Z);
    // x_right = x_left - 120 mm, turned by nothing at this resolution.
    assert_pose(right, [0.12, 0.0, 0.0], X, Z);
}

#[test]
fn turns_are_of_the_resolution_and_map_left_to_right() {
    let imported = read(&[("SN123.conf", ZED)], &of_size("672x376")).unwrap();
    let right = &imported.rig.cameras()[1];
    // A quarter turn about y takes the left camera's x to the right one's -z, so its own z to x.
    assert_pose(right, [0.0, 0.0, 0.12], Z, [-1.0, 0.0, 0.0]);
}

#[test]
fn size_is_asked_for_and_compared() {
    let error = refusal(&[("a.conf", ZED)], &Options::default());
    assert!(
        error.contains("has images of 1280x720, 672x376; give the size of yours"),
        "{error}"
    );
    let error = refusal(&[("a.conf", ZED)], &of_size("640x480"));
    assert!(error.contains("got 640x480"), "{error}");
}

#[test]
fn lens_of_all_resolutions_is_read() {
    let text = "[LEFT_CAM_FHD1200]\nfx = 700\nfy = 700\ncx = 960\ncy = 600\n\
                [RIGHT_CAM_FHD1200]\nfx = 700\nfy = 700\ncx = 960\ncy = 600\n\
                [LEFT_DISTO]\nk1 = 0.1\nk2 = 0.2\nk3 = 0.3\nk4 = 0.4\n\
                [RIGHT_DISTO]\nk1 = 0.1\nk2 = 0\np1 = 0\np2 = 0\nk3 = 0\nk4 = 0.5\nk5 = 0\nk6 = 0\n\
                [STEREO]\nBaseline = 50\nTY = 0\nTZ = 0\nCV_FHD1200 = 0\nRX_FHD1200 = 0\nRZ_FHD1200 = 0\n";
    let imported = read(&[("SN1.conf", text)], &Options::default()).unwrap();
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!(left.intrinsics().projection().family(), "fisheye");
    assert_params(left, &[0.1, 0.2, 0.3, 0.4]);
    assert_params(right, &[0.1, 0.0, 0.0, 0.0, 0.0, 0.5]);
    let twice = text.replacen("cy = 600", "cy = 600\nk1 = 0.1", 1);
    let error = refusal(&[("SN1.conf", &twice)], &Options::default());
    assert!(
        error.contains("its lens in one section, got two"),
        "{error}"
    );
}

#[test]
fn what_is_missing_or_unknown_is_named() {
    let hd = of_size("1280x720");
    for (from, to, expected) in [
        ("CV_HD=0\n", "", "`CV_HD` is missing"),
        ("cx=640\n", "", "`CX` is missing"),
        ("cx=640\n", "cx=left\n", "a finite number"),
        ("k3=0.003\n", "k3=0.003\nk9=0.1\n", "`K9`"),
        ("[STEREO]", "[OTHER]", "`STEREO` is missing"),
    ] {
        assert!(ZED.contains(from));
        let error = refusal(&[("a.conf", &ZED.replacen(from, to, 1))], &hd);
        assert!(error.contains(expected), "{error}");
    }
}
