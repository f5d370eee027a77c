mod files;

use std::fs::File;

use super::files::digest;
use super::*;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// A graph with its version and a documentation alone, 8 bytes.
const GRAPH: &str = "\u{8}\u{a}2\u{4}text";

/// A bundle whose graphs are empty, with `change` made to its description.
fn bundle(change: impl FnOnce(&mut Value)) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let points = r#"{"unit":"m","points":[[0.01,0.02,0.03,255,127.6,0]]}"#;
    let mut files = json!({});
    for (name, text) in [("f.onnx", GRAPH), ("d.onnx", GRAPH), ("p.json", points)] {
        std::fs::write(dir.path().join(name), text).unwrap();
        let file = File::open(dir.path().join(name)).unwrap();
        files[name] = json!({ "bytes": text.len(), "sha256": digest(file).unwrap() });
    }
    let mut model = json!({
        "format": "mvtop-model",
        "version": 1,
        "preset": "small",
        "input": {"width": 640, "height": 480, "mean": [0.5, 0.5, 0.5], "std": [0.2, 0.2, 0.2]},
        "strides": [8, 16, 32],
        "los_encoding": "plucker_origin",
        "classes": [{"id": 1, "name": "mvball", "diameter_m": 0.138, "points": "p.json"}],
        "detector": {"score_threshold": 0.3, "nms_iou": 0.5},
        "closeup": {"size": 160, "strides": [16, 32]},
        "graphs": {"features": "f.onnx", "closeup": "f.onnx", "decoder": "d.onnx"},
        "portable": false,
        "files": files,
        "provenance": {"seed": 1},
    });
    change(&mut model);
    std::fs::write(dir.path().join("model.json"), model.to_string()).unwrap();
    dir
}

fn refusal(change: impl FnOnce(&mut Value)) -> String {
    Bundle::load(bundle(change).path()).unwrap_err().to_string()
}

#[test]
fn poses_come_of_a_decoder_or_of_coordinates() {
    let coordinates = |model: &mut Value| model["classes"][0]["coordinates_extent_m"] = 0.1.into();
    let without_decoder = |model: &mut Value| {
        model["graphs"].as_object_mut().unwrap().remove("decoder");
    };
    let dir = bundle(|model| {
        coordinates(model);
        without_decoder(model);
    });
    let loaded = Bundle::load(dir.path()).unwrap();
    assert!(loaded.has_coordinates() && loaded.decoder.is_none());
    let expected = "expected either a `decoder` or coordinates_extent_m";
    for refused in [refusal(coordinates), refusal(without_decoder)] {
        assert!(refused.contains(expected), "{refused}");
    }
}

#[test]
fn a_bundle_is_read() {
    let dir = bundle(|_| ());
    let bundle = Bundle::load(dir.path()).unwrap();
    assert_eq!(bundle.los_encoding, LosEncoding::PluckerOrigin);
    assert_eq!(bundle.features, dir.path().join("f.onnx"));
    assert_eq!(bundle.class_index("mvball"), Some(0));
    assert_eq!(bundle.class_index("cube"), None);
    let point = SurfacePoint {
        position: [0.01, 0.02, 0.03],
        color: [255, 128, 0],
    };
    assert_eq!(bundle.classes[0].points, [point]);
}

#[test]
fn closeups_have_a_size_strides_and_a_graph() {
    let dir = bundle(|_| ());
    let expected = CloseUps {
        size: 160,
        strides: vec![16, 32],
        graph: dir.path().join("f.onnx"),
    };
    assert_eq!(Bundle::load(dir.path()).unwrap().closeups, expected);

    let without = |of: fn(&mut Value) -> &mut Value| {
        refusal(|m| {
            of(m).as_object_mut().unwrap().remove("closeup");
        })
    };
    for error in [without(|m| m), without(|m| &mut m["graphs"])] {
        assert!(error.contains("missing field `closeup`"), "{error}");
    }
    let uneven = refusal(|m| m["closeup"] = json!({"size": 160, "strides": [16, 48]}));
    assert!(uneven.contains("strides that divide it"), "{uneven}");
}

#[test]
fn threshold_of_agreeing_boxes_may_be_left_out() {
    let agree_threshold = |dir: tempfile::TempDir| {
        let detector = Bundle::load(dir.path()).unwrap().detector;
        detector.agree_threshold
    };
    assert_eq!(agree_threshold(bundle(|_| ())), None);
    let given = bundle(|m| m["detector"]["agree_threshold"] = json!(0.25));
    assert_eq!(agree_threshold(given), Some(0.25));
}

#[test]
fn symmetries_are_read_and_checked() {
    let half_turn = || json!([[[-1, 0, 0, 0.02], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]]);
    let dir = bundle(|m| {
        m["classes"][0]["symmetries_discrete"] = half_turn();
        m["classes"][0]["symmetries_continuous"] =
            json!([{"axis": [0, 0, 2], "offset": [0.01, 0, 0]}]);
    });
    let symmetry = &Bundle::load(dir.path()).unwrap().classes[0].symmetry;
    assert_eq!(symmetry.discrete[0].translation.x, 0.02);
    assert!((symmetry.discrete[0].rotation.angle() - std::f64::consts::PI).abs() < 1e-12);
    let axis = symmetry.axis.unwrap();
    assert_eq!((axis.direction.z, axis.point.x), (1.0, 0.01));

    let bent = refusal(|m| {
        m["classes"][0]["symmetries_discrete"] = half_turn();
        m["classes"][0]["symmetries_discrete"][0][2][2] = json!(2);
    });
    assert!(
        bent.contains("class `mvball`: symmetries_discrete: "),
        "{bent}"
    );
    let nowhere = refusal(|m| {
        m["classes"][0]["symmetries_continuous"] =
            json!([{"axis": [0, 0, 0], "offset": [0, 0, 0]}]);
    });
    assert!(
        nowhere.contains("expected an axis, got [0.0, 0.0, 0.0]"),
        "{nowhere}"
    );
}

#[test]
fn half_widths_of_a_bar_are_its_thickness_and_its_length() {
    // Corners of 20 x 40 x 120 mm.
    let points = (0..8).map(|i| SurfacePoint {
        position: std::array::from_fn(|axis| {
            let half = [0.01, 0.02, 0.06][axis];
            if i >> axis & 1 == 1 { half } else { -half }
        }),
        color: [0; 3],
    });
    let class = Class {
        id: 1,
        name: "bar".into(),
        diameter_m: 0.128,
        symmetry: Symmetry::default(),
        mesh: None,
        coordinates_extent_m: None,
        points: points.collect(),
    };
    let [least, greatest] = class.half_widths();
    // Up to 3 degrees off the thin direction, the long side shows: 10 mm + 60 mm * sin(3 deg).
    assert!((0.01..0.0132).contains(&least), "{least}");
    assert_eq!(greatest, 0.064);
    let unknown = Class {
        points: vec![],
        ..class
    };
    assert_eq!(unknown.half_widths()[0], 0.0);
}

#[test]
fn another_format_or_version_is_refused_before_anything_else() {
    let future = refusal(|m| *m = json!({ "format": "mvtop-model", "version": 2 }));
    assert!(
        future.contains("version 2, expected `mvtop-model` version 1"),
        "{future}"
    );
    let other = refusal(|m| m["format"] = json!("other"));
    assert!(other.contains("`other`"), "{other}");
}

#[test]
fn a_key_that_comes_twice_is_refused() {
    let dir = bundle(|_| ());
    let path = dir.path().join("model.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen('{', "{\"preset\": \"other\",", 1)).unwrap();
    let error = Bundle::load(dir.path()).unwrap_err().to_string();
    assert!(error.contains("`preset` comes twice"), "{error}");
}

#[test]
fn impossible_numbers_are_refused() {
    let cases: [(&str, Value, &str); 13] = [
        ("/input/width", json!(0), "input is 0 x 480"),
        ("/input/height", json!(4_000_000), "input is 640 x 4000000"),
        (
            "/input",
            json!({"width": 16384, "height": 16384, "mean": [0, 0, 0], "std": [1, 1, 1]}),
            "16777216 px at most",
        ),
        ("/input/std", json!([0.2, 0.0, 0.2]), "std"),
        ("/strides", json!([]), "strides"),
        ("/strides", json!([16, 8]), "strides"),
        ("/strides", json!([0, 8]), "stride 0"),
        ("/strides", json!([7]), "stride 7 does not divide"),
        ("/detector/nms_iou", json!(1.5), "from 0 to 1"),
        (
            "/detector",
            json!({"score_threshold": 0.3, "agree_threshold": -0.1, "nms_iou": 0.5}),
            "from 0 to 1",
        ),
        ("/classes", json!([]), "classes are 0, expected 1 to 256"),
        ("/classes/0/diameter_m", json!(-1.0), "diameter"),
        ("/los_encoding", json!("polar"), "polar"),
    ];
    for (place, value, part) in cases {
        let error = refusal(|m| *m.pointer_mut(place).unwrap() = value.clone());
        assert!(error.contains(part), "{place} = {value}: {error}");
    }
    let twice = refusal(|m| {
        let class = m["classes"][0].clone();
        m["classes"].as_array_mut().unwrap().push(class);
    });
    assert!(twice.contains("comes twice"), "{twice}");
}

#[test]
fn names_that_mislead_a_terminal_are_refused() {
    for place in ["/preset", "/classes/0/name"] {
        for name in [
            "small\nall well",
            "\u{1b}[2J",
            "\u{9b}2J",
            "\u{202e}llab",
            "ball\u{200b}",
            "b\u{ad}all",
            "ball\u{e0061}",
            "\u{61c}ball",
            "\u{2028}",
        ] {
            let error = refusal(|m| *m.pointer_mut(place).unwrap() = json!(name));
            assert!(error.contains("control characters"), "{place}: {error}");
            assert!(!error.contains(name), "{place}: {error}");
        }
    }
}

#[test]
fn points_of_another_size_than_the_diameter_are_refused() {
    // 0.2 m apart, as if the diameter of 0.138 m were another object's; and a tenth of it.
    for (reach, part) in [(0.2, "[0.2, "), (0.01, "[0.01, ")] {
        let points = json!({"unit": "m", "points": [
            [0, 0, 0, 9, 9, 9], [reach, 0, 0, 9, 9, 9], [0, reach, 0, 9, 9, 9], [0, 0, reach, 9, 9, 9],
        ]});
        let points = points.to_string();
        let dir = bundle(|m| {
            let sha256 = format!("{:x}", Sha256::digest(&points));
            m["files"]["p.json"] = json!({"bytes": points.len(), "sha256": sha256});
        });
        std::fs::write(dir.path().join("p.json"), &points).unwrap();
        let error = Bundle::load(dir.path()).unwrap_err().to_string();
        assert!(
            error.contains("diameter 0.138 m") && error.contains(part),
            "{error}"
        );
    }
}

#[test]
fn points_that_are_none_are_refused() {
    let cases = [
        (r#"{"unit":"mm","points":[[0,0,0,0,0,0]]}"#, "metres"),
        (r#"{"unit":"m","points":[]}"#, "no points"),
        (r#"{"unit":"m","points":[[0,0,0,0,0,256]]}"#, "point 0"),
        (r#"{"unit":"m","points":[[0,0,0]]}"#, "not a points file"),
    ];
    for (text, part) in cases {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.json");
        std::fs::write(&path, text).unwrap();
        let error = read_points(&path).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains("p.json"), "{error}");
    }
}

#[test]
fn mesh_of_a_class_is_read_and_checked() {
    let ply = |last: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n\
             0 0 0 9 8 7\n0.01 0 0 9 8 7\n{last}\n3 0 1 2\n"
        )
    };
    let with_mesh = |text: String| {
        let dir = bundle(|_| ());
        std::fs::write(dir.path().join("m.ply"), &text).unwrap();
        let path = dir.path().join("model.json");
        let mut model: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let sha256 = digest(File::open(dir.path().join("m.ply")).unwrap()).unwrap();
        model["files"]["m.ply"] = json!({ "bytes": text.len(), "sha256": sha256 });
        model["classes"][0]["mesh"] = json!("m.ply");
        std::fs::write(&path, model.to_string()).unwrap();
        Bundle::load(dir.path())
    };
    let read = with_mesh(ply("0 0.01 0 1 2 3")).unwrap().classes.remove(0);
    let mesh = read.mesh.unwrap();
    assert_eq!(mesh.triangles(), [[0, 1, 2]]);
    assert_eq!(mesh.colors(), [[9, 8, 7], [9, 8, 7], [1, 2, 3]]);

    let without_colors = ply("0 0.01 0 1 2 3").replace("green", "alpha");
    for (text, problem) in [
        ("solid".to_owned(), "is no mesh"),
        (
            ply("0 0.01 0 1 2 3").replace("3 0 1 2", "0"),
            "has 0 triangles",
        ),
        (without_colors, "without colors"),
    ] {
        let error = with_mesh(text).unwrap_err().to_string();
        assert!(
            error.contains("m.ply") && error.contains(problem),
            "{error}"
        );
    }
    let unlisted = refusal(|m| m["classes"][0]["mesh"] = json!("m.ply"));
    assert!(unlisted.contains("used but not listed"), "{unlisted}");
}

#[test]
fn calibrations_for_another_pipeline_are_refused() {
    let earlier = refusal(|m| m["confidence"] = json!({"within_deg": 5.0, "weights": {}}));
    let says = [
        "version 1 of the pipeline, expected 2",
        "mvtop-train calibrate",
    ];
    assert!(says.iter().all(|part| earlier.contains(part)), "{earlier}");
    let scorer = || serde_json::to_value(Scorer::default()).unwrap();
    // Unversioned, earlier, later.
    for version in [None, Some(1), Some(3)] {
        let problem = refusal(|m| {
            m["scorer"] = scorer();
            if let Some(version) = version {
                m["pipeline_version"] = json!(version);
            }
        });
        let fitted = format!("version {} of the pipeline", version.unwrap_or(1));
        assert!(problem.contains(&fitted), "{problem}");
    }
    // Of this one; what is left over from an earlier calibration does not matter.
    let dir = bundle(|m| {
        m["scorer"] = scorer();
        m["pipeline_version"] = json!(2);
        m["confidence"] = json!({});
    });
    assert_eq!(
        Bundle::load(dir.path()).unwrap().scorer,
        Some(Scorer::default())
    );
    // Without a calibration there is nothing to refuse.
    let dir = bundle(|m| m["pipeline_version"] = json!(1));
    assert_eq!(Bundle::load(dir.path()).unwrap().scorer, None);
}

#[test]
fn settings_of_inference_are_read_and_checked() {
    let dir = bundle(|m| m["inference"] = json!({"search": {"settled": 0.7}}));
    let bundle = Bundle::load(dir.path()).unwrap();
    let mut expected = InferenceConfig::default();
    expected.search.settled = 0.7;
    assert_eq!(bundle.inference, expected);
    let unknown = refusal(|m| m["inference"] = json!({"search": {"setled": 0.7}}));
    assert!(unknown.contains("setled"), "{unknown}");
    let impossible = refusal(|m| m["inference"] = json!({"search": {"settled": 1.7}}));
    assert!(impossible.contains("search.settled"), "{impossible}");
    let scorer = refusal(|m| {
        m["pipeline_version"] = json!(2);
        m["scorer"] = serde_json::to_value(Scorer::default()).unwrap();
        m["scorer"]["refined"]["view"]["smell"] = json!(1.0);
    });
    assert!(scorer.contains("\"smell\""), "{scorer}");
}

#[test]
fn bundles_of_the_fixtures_are_read() {
    for name in ["tiny", "tiny/portable"] {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../fixtures")
            .join(name);
        let bundle = Bundle::load(&dir).unwrap();
        assert_eq!(bundle.closeups.size, 64);
        assert_eq!(
            (bundle.scorer, bundle.inference),
            (None, InferenceConfig::default())
        );
    }
}
