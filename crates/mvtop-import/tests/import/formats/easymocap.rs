use mvtop_import::{Format, ImageSize, Options};

use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

fn matrix(key: &str, rows: usize, cols: usize, data: &str) -> String {
    format!(
        "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"
    )
}

fn files() -> [String; 2] {
    let names = "%YAML:1.0\n---\nnames:\n   - \"01\"\n   - top_view\n";
    let intri = ["01", "top_view"].map(|name| {
        matrix(
            &format!("K_{name}"),
            3,
            3,
            "700., 0., 320., 0., 710., 240., 0., 0., 1.",
        ) + &matrix(&format!("dist_{name}"), 1, 5, "0.1, 0., 0., 0., 0.")
    });
    let extri = matrix("R_01", 3, 1, "0., 0., 0.")
        + &matrix("Rot_01", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.")
        + &matrix("T_01", 3, 1, "0., 0., 0.")
        + &matrix("R_top_view", 3, 1, "0., 0., 1.5707963267948966")
        + &matrix("Rot_top_view", 3, 3, "0., -1., 0., 1., 0., 0., 0., 0., 1.")
        + &matrix("T_top_view", 3, 1, "-0.4, 0., 0.");
    [
        names.to_owned() + &intri.concat(),
        names.to_owned() + &extri,
    ]
}

#[test]
fn easymocap_keys_end_in_names_of_cameras() {
    let [intri, extri] = files();
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..scaled(1.0)
    };
    let imported = read(&[("intri.yml", &intri), ("extri.yml", &extri)], &options).unwrap();
    assert_eq!(imported.format, Format::EasyMocap);
    let [first, top] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!((first.id(), top.id()), ("01", "top_view"));
    assert_plane(top, [700.0, 710.0, 320.0, 240.0]);
    assert_params(top, &[0.1, 0.0, 0.0, 0.0, 0.0]);
    assert_pose(first, [0.0; 3], X, Z);
    assert_pose(top, [0.0, -0.4, 0.0], MINUS_Y, Z);
    let error = refusal(&[("intri.yml", &intri)], &options);
    assert!(error.contains("give extri.yml as well"), "{error}");
}

#[test]
fn easymocap_s_rotation_is_there_twice_and_said_once() {
    let options = Options {
        image_sizes: vec![ImageSize::parse("640x480").unwrap()],
        ..scaled(1.0)
    };
    let [intri, extri] = files();
    let other = extri.replace("1.5707963267948966", "1.2");
    let error = refusal(&[("intri.yml", &intri), ("extri.yml", &other)], &options);
    assert!(error.contains("different rotations"), "{error}");
    // Without the vector, the matrix maps world to camera as well.
    let [head, of_top] = extri
        .split_once("R_top_view")
        .map(<[&str; 2]>::from)
        .unwrap();
    let rest = &of_top[of_top.find("Rot_top_view").unwrap()..];
    let matrix = format!("{head}{rest}");
    let rig = read(&[("intri.yml", &intri), ("extri.yml", &matrix)], &options)
        .unwrap()
        .rig;
    assert_pose(&rig.cameras()[1], [0.0, -0.4, 0.0], MINUS_Y, Z);
    let more = format!("{extri}{}", matrix_of_none());
    let error = refusal(&[("intri.yml", &intri), ("extri.yml", &more)], &options);
    assert!(error.contains("the key `R_03` is not known"), "{error}");
}

fn matrix_of_none() -> String {
    matrix("R_03", 3, 1, "0., 0., 1.")
}
