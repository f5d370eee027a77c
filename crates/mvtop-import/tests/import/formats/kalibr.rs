use mvtop_import::Options;

use super::{X, Z};
use crate::{assert_pose, read, refusal};

const CAMERA: &str = "camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0.1, 0, 0, 0]\n  \
    intrinsics: [300, 301, 320, 240]\n  resolution: [640, 480]\n";

fn at(key: &str, x: f64) -> String {
    format!("  {key}:\n  - [1, 0, 0, {x}]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n")
}

#[test]
fn chains_of_several_files_stand_in_the_imu_or_are_refused() {
    let chain = |first: usize, imu: bool| {
        let of_imu = |x: f64| {
            if imu {
                at("T_cam_imu", x)
            } else {
                String::new()
            }
        };
        let (x, link) = (-(first as f64), at("T_cn_cnm1", -1.0));
        format!(
            "cam{first}:\n  {CAMERA}{}cam{}:\n  {CAMERA}{link}{}",
            of_imu(x),
            first + 1,
            of_imu(x - 1.0)
        )
    };
    let (a, b) = (chain(0, false), chain(2, false));
    let error = refusal(&[("a.yaml", &a), ("b.yaml", &b)], &Options::default());
    assert!(
        error.contains("several files, which have no frame in common"),
        "{error}"
    );
    let (a, b) = (chain(0, true), chain(2, true));
    let rig = read(&[("a.yaml", &a), ("b.yaml", &b)], &Options::default())
        .unwrap()
        .rig;
    for (index, camera) in rig.cameras().iter().enumerate() {
        assert_pose(camera, [index as f64, 0.0, 0.0], X, Z);
    }
}

#[test]
fn kalibr_s_other_entries_are_named() {
    let text = format!("cam0:\n  {CAMERA}  calibrated_distortion_coeffs: [0.1, 0.02, 0, 0]\n");
    let error = refusal(&[("a.yaml", &text)], &Options::default());
    assert!(error.contains("`calibrated_distortion_coeffs`"), "{error}");
    let text = format!("cam0:\n  {CAMERA}cam1:\n  intrinsics: [300, 301, 320, 240]\n");
    let error = refusal(&[("a.yaml", &text)], &Options::default());
    assert!(error.contains("the key `cam1` is not known"), "{error}");
}
