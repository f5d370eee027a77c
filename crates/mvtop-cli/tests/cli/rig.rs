//! `rig`: import, show and check.

use std::fs::{read_to_string, write};
use std::path::Path;

use tempfile::TempDir;

use crate::{mvtop, refusal, root, stdout};

/// Two cameras 0.4 m apart that look at the same point 1 m ahead of the middle, in OpenCV's terms.
const PAIR: &str = r#"{"K1": [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], "D1": [0, 0, 0, 0, 0],
    "K2": [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], "D2": [0, 0, 0, 0, 0], "image_size": [640, 480],
    "rvec": [0, 0.4, 0], "T": [-0.38, 0, 0.1]}"#;

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn rig_file(folder: &TempDir, poses: &[&str]) -> String {
    let cameras: Vec<String> = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| {
            format!(
                r#"{{"id": "c{i}", "width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5,
                    {pose}}}"#
            )
        })
        .collect();
    let text = format!(
        r#"{{"format": "mvtop-rig", "version": 1, "unit": "m", "cameras": [{}]}}"#,
        cameras.join(", ")
    );
    let file = path(folder, "made.json");
    write(&file, text).unwrap();
    file
}

#[test]
fn import_asks_writes_once_and_is_read_back() {
    let folder = TempDir::new().unwrap();
    let (file, out) = (path(&folder, "pair.json"), path(&folder, "rig.json"));
    write(&file, PAIR).unwrap();
    let error = refusal(&mvtop(&["rig", "import", &file, "-o", &out]));
    assert!(
        error.contains("--scale") && !Path::new(&out).exists(),
        "{error}"
    );
    let import = [
        "rig", "import", "--from", "opencv", &file, "--unit", "m", "-o", &out,
    ];
    let text = stdout(&mvtop(&import));
    assert!(text.contains("2 cameras, from opencv"), "{text}");
    let written = read_to_string(&out).unwrap();
    assert!(mvtop_core::Rig::from_json(&written).is_ok());
    assert!(refusal(&mvtop(&import)).contains("--force"));
    assert_eq!(read_to_string(&out).unwrap(), written);
    stdout(&mvtop(&[&import[..], &["--force"]].concat()));
    stdout(&mvtop(&["rig", "check", &out]));
}

#[test]
fn import_of_cameras_far_apart_is_asked_for_and_is_read_back() {
    let folder = TempDir::new().unwrap();
    let (file, out) = (path(&folder, "pair.json"), path(&folder, "rig.json"));
    write(&file, PAIR).unwrap();
    let import = ["rig", "import", &file, "--scale", "500", "-o", &out];
    let error = refusal(&mvtop(&import));
    assert!(
        error.contains("`trust_unit` to true (--trust-unit)"),
        "{error}"
    );
    assert!(!Path::new(&out).exists());
    stdout(&mvtop(&[&import[..], &["--trust-unit"]].concat()));
    let said = stdout(&mvtop(&["rig", "show", &out]));
    assert!(said.contains("196.4688 m apart"), "{said}");
}

#[test]
fn show_says_and_draws_where_cameras_are() {
    let folder = TempDir::new().unwrap();
    let turned = |angle: f64, x: f64| {
        let (s, c) = (angle / 2.0).sin_cos();
        format!(r#""T_world_cam": {{"t": [{x}, 0, 0], "q_wxyz": [{c}, 0, {s}, 0]}}"#)
    };
    let angle = 0.2f64.atan2(1.0);
    let file = rig_file(&folder, &[&turned(angle, -0.2), &turned(-angle, 0.2)]);
    let picture = path(&folder, "rig.svg");
    let text = stdout(&mvtop(&["rig", "check", &file, "--picture", &picture]));
    for fact in [
        "c0 - c1: 0.4000 m apart, 22.6 deg",
        "in common: ",
        "in front of 2 of 2",
    ] {
        assert!(text.contains(fact), "{fact} is missing in:\n{text}");
    }
    let svg = read_to_string(&picture).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("0.400 m") && svg.contains(">c1<"));
    assert!(refusal(&mvtop(&["rig", "show", &file, "--picture", &picture])).contains("--force"));
}

#[test]
fn show_says_how_far_a_lens_sees_that_ends_before_the_edge() {
    let folder = TempDir::new().unwrap();
    let at = r#""T_world_cam": {"t": [0, 0, 0], "q_wxyz": [1, 0, 0, 0]}"#;
    let file = rig_file(&folder, &[at]);
    let fisheye = r#""model": "fisheye", "max_angle_deg": 60, "fx": 200, "fy": 200"#;
    let text = read_to_string(&file).unwrap();
    write(&file, text.replace(r#""fx": 500, "fy": 500"#, fisheye)).unwrap();
    let said = stdout(&mvtop(&["rig", "show", &file]));
    assert!(said.contains("sees 120 x 120 deg"), "{said}");
}

#[test]
fn files_that_are_read_are_never_replaced() {
    let folder = TempDir::new().unwrap();
    let at = |x: f64| format!(r#""T_world_cam": {{"t": [{x}, 0, 0], "q_wxyz": [1, 0, 0, 0]}}"#);
    let rig = rig_file(&folder, &[&at(0.0), &at(0.3)]);
    let [pair, a, b] = ["pair.json", "a.png", "b.png"].map(|name| path(&folder, name));
    write(&pair, PAIR).unwrap();
    write(&a, "a").unwrap();
    write(&b, "b").unwrap();
    let colmap = folder.path().join("sparse");
    std::fs::create_dir(&colmap).unwrap();
    let [cameras, images] = ["cameras.txt", "images.txt"].map(|name| colmap.join(name));
    write(&cameras, "7 SIMPLE_RADIAL 640 480 500 320 240 0.05\n").unwrap();
    write(
        &images,
        "1 1 0 0 0 0 0 0 7 a.png\n\n2 1 0 0 0 2 0 3 7 b.png\n\n",
    )
    .unwrap();
    let (sparse, cameras) = (colmap.to_str().unwrap(), cameras.to_str().unwrap());
    let named = format!("c1={b}");
    for (args, file) in [
        (&["rig", "show", &rig, "--picture", &rig][..], &*rig),
        (&["rig", "check", &rig, &a, &b, "--picture", &a], &*a),
        (&["rig", "check", &rig, &named, "--picture", &b], &*b),
        (&["rig", "refine", &rig, &a, &b, "-o", &b], &*b),
        (
            &["rig", "import", &pair, "--unit", "m", "-o", &pair],
            &*pair,
        ),
        (
            &["rig", "import", sparse, "--unit", "m", "-o", cameras],
            cameras,
        ),
    ] {
        let before = read_to_string(file).unwrap();
        let error = refusal(&mvtop(&[args, &["--force"]].concat()));
        assert!(
            error.contains("is one of the files that are read"),
            "{error}"
        );
        assert_eq!(read_to_string(file).unwrap(), before);
    }
    let beside = colmap.join("rig.json");
    let import = [
        "rig",
        "import",
        sparse,
        "--unit",
        "m",
        "-o",
        beside.to_str().unwrap(),
    ];
    stdout(&mvtop(&import));
    stdout(&mvtop(&[&import[..], &["--force"]].concat()));
}

#[test]
fn swapped_axes_and_directions_are_named() {
    let folder = TempDir::new().unwrap();
    // Two cameras opposite each other, 2 m apart, that look at the middle; in OpenGL's axes, away from it.
    let facing = [
        r#""T_world_cam": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1]]"#,
        r#""T_world_cam": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]"#,
    ];
    stdout(&mvtop(&["rig", "check", &rig_file(&folder, &facing)]));
    let away = [
        r#""T_world_cam": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, -1], [0, 0, 0, 1]]"#,
        r#""T_world_cam": [[-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]"#,
    ];
    let away = rig_file(&folder, &away);
    let error = refusal(&mvtop(&["rig", "check", &away]));
    assert!(
        error.contains("no view in common") || error.contains("any view in common"),
        "{error}"
    );
    assert!(
        error.contains("OpenGL") || error.contains("other direction"),
        "{error}"
    );
    stdout(&mvtop(&["rig", "show", &away])); // says it, but does not fail
}

#[test]
fn cameras_that_look_apart_are_refused_where_they_share_little() {
    let folder = TempDir::new().unwrap();
    let turned = |degrees: f64, x: f64| {
        let (s, c) = (degrees.to_radians() / 2.0).sin_cos();
        format!(r#""T_world_cam": {{"t": [{x}, 0, 0], "q_wxyz": [{c}, 0, {s}, 0]}}"#)
    };
    let apart = |degrees: f64| {
        let poses = [turned(-degrees, -0.2), turned(degrees, 0.2)];
        rig_file(&folder, &[&poses[0], &poses[1]])
    };
    let said = stdout(&mvtop(&["rig", "check", &apart(10.0)]));
    let away = "look away from where their axes meet";
    assert!(
        said.contains(&format!("warning: the cameras {away}")),
        "{said}"
    );
    assert!(said.contains("no other error was found"), "{said}");
    let error = refusal(&mvtop(&["rig", "check", &apart(30.0)]));
    assert!(error.contains(away), "{error}");
}

#[test]
fn cameras_that_share_all_they_see_are_not_doubted() {
    let folder = TempDir::new().unwrap();
    // Side by side and 4 degrees apart: axes meet behind, views overlap by nearly all.
    let turned = |degrees: f64, x: f64| {
        let (s, c) = (degrees.to_radians() / 2.0).sin_cos();
        format!(r#""T_world_cam": {{"t": [{x}, 0, 0], "q_wxyz": [{c}, 0, {s}, 0]}}"#)
    };
    let rig = rig_file(&folder, &[&turned(-2.0, -0.05), &turned(2.0, 0.05)]);
    let said = stdout(&mvtop(&["rig", "show", &rig]));
    assert!(!said.contains("warning"), "{said}");
}

#[test]
fn images_go_before_what_places_of_cameras_look_like() {
    let folder = TempDir::new().unwrap();
    let rig = read_to_string(root().join("examples/mvball/rig.json")).unwrap();
    let mut rig: serde_json::Value = serde_json::from_str(&rig).unwrap();
    // Seven cameras more around the ball, all of which look away from it, upwards.
    let k = 0.5f64.sqrt();
    for i in 0..7 {
        let (s, c) = (f64::from(i) * std::f64::consts::TAU / 7.0).sin_cos();
        rig["cameras"].as_array_mut().unwrap().push(serde_json::json!({
            "id": format!("out{i}"), "width": 640, "height": 480, "fx": 1500, "fy": 1500, "cx": 319.5,
            "cy": 239.5,
            "T_world_cam": [
                [s, k * c, k * c, 0.5 * k * c], [-c, k * s, k * s, 0.5 * k * s], [0, -k, k, 0.5 * k],
                [0, 0, 0, 1],
            ],
        }));
    }
    let file = path(&folder, "outwards.json");
    write(&file, rig.to_string()).unwrap();
    let error = refusal(&mvtop(&["rig", "check", &file]));
    let away = "look away from where their axes meet";
    assert!(error.contains(away), "{error}");
    let images = ["cam0", "cam1"].map(|id| format!("{id}=examples/mvball/{id}.png"));
    let [a, b] = &images;
    let said = stdout(&mvtop(&[
        "rig",
        "check",
        &file,
        a,
        b,
        "--model",
        "models/mvball",
    ]));
    assert!(
        said.contains(&format!("warning: the cameras {away}")),
        "{said}"
    );
    assert!(said.ends_with("no camera was found to be off\n"), "{said}");
}

#[test]
fn images_that_do_not_fit_a_rig_are_refused_before_the_network_is_loaded() {
    let folder = TempDir::new().unwrap();
    let at = |x: f64| format!(r#""T_world_cam": {{"t": [{x}, 0, 0], "q_wxyz": [1, 0, 0, 0]}}"#);
    let (pair, one) = (rig_file(&folder, &[&at(0.0), &at(0.3)]), at(0.0));
    let out = path(&folder, "better.json");
    let refine = |rest: &[&str]| refusal(&mvtop(&[&["rig", "refine", "-o", &out], rest].concat()));
    let error = refine(&[&pair, "a.png", "b.png", "c.png"]);
    assert!(
        error.contains("sets of 2 images") && error.contains("got 3"),
        "{error}"
    );
    // In each set all images are named after cameras, and are of these in any order, or none is.
    for command in [&["check"][..], &["refine", "-o", &out]] {
        let run = |images: &[&str]| {
            let args = [&["rig"], command, &[&pair], images].concat();
            refusal(&mvtop(&args))
        };
        let error = run(&["a/c1.png", "a/c0.png", "b/c0.png", "b/c1.png"]);
        assert!(error.contains("cannot read a/c0.png"), "{error}");
        let error = run(&["a/c0.png", "a/c1.png", "b/c0.png", "b/front.png"]);
        assert!(
            error.contains("image `b/front.png`: expected") && error.contains("ID=PATH"),
            "{error}"
        );
    }
    // The rig that is read is never replaced, whatever is forced.
    let onto = [
        "rig", "refine", &pair, "a.png", "b.png", "--force", "-o", &pair,
    ];
    let error = refusal(&mvtop(&onto));
    assert!(error.contains("name another file"), "{error}");
    let error = refine(&[&rig_file(&folder, &[&one]), "a.png"]);
    assert!(error.contains("two cameras or more"), "{error}");
    assert!(!Path::new(&out).exists());
}

#[test]
fn images_tell_a_true_rig_from_one_in_the_other_direction() {
    let folder = TempDir::new().unwrap();
    let example = |file: &str| format!("examples/mvball/{file}");
    let [a, b] = [example("cam0.png"), example("cam1.png")];
    let images = [&a, &b, "--model", "models/mvball"];
    let said = stdout(&mvtop(
        &[&["rig", "check", &example("rig.json")], &images[..]].concat(),
    ));
    assert!(said.contains("1 object in 1 set"), "{said}");
    assert!(said.ends_with("no camera was found to be off\n"), "{said}");
    let out = path(&folder, "better.json");
    let refine = ["rig", "refine", &example("rig.json"), "-o", &out];
    let error = refusal(&mvtop(&[&refine, &images[..]].concat()));
    assert!(error.contains("do not contradict the rig"), "{error}");
    assert!(!Path::new(&out).exists());

    let rig = read_to_string(root().join(example("rig.json"))).unwrap();
    let [read, meant] = ["T_world_cam", "T_cam_world"];
    let (from, to) = if rig.contains(read) {
        (read, meant)
    } else {
        (meant, read)
    };
    let wrong = path(&folder, "wrong.json");
    write(&wrong, rig.replace(from, to)).unwrap();
    let error = refusal(&mvtop(&[&["rig", "check", &wrong], &images[..]].concat()));
    assert!(
        error.contains("fit the images if read in the other direction"),
        "{error}"
    );
}

#[test]
fn what_the_wheel_does_is_said_to_come_with_it() {
    for command in ["calibrate", "board", "hand-eye"] {
        let sentence = refusal(&mvtop(&["rig", command, "--board", "b.json", "-h"]));
        assert!(
            sentence.contains("comes with the Python wheel"),
            "{sentence}"
        );
        assert!(
            sentence.contains(&format!("mvtop-cli rig {command} --board b.json -h")),
            "{sentence}"
        );
    }
}
