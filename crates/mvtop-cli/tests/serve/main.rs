//! The service as its clients see it, with the example and the model that come along. Needs ONNX
//! Runtime.

#![cfg(unix)]

mod bounds;
mod client;
mod ends;
mod lines;
mod records;
mod strangers;
mod streams;

use client::{Server, cli, images, timeless};

#[test]
fn answer_is_that_of_infer() {
    let server = Server::start(&[]);
    let got = server.post("", &["X-Request-Id: cell-1"], &images());
    assert_eq!(got.status, 200, "{}", got.text());
    assert!(
        got.head.contains("x-request-id: cell-1") && got.head.contains("x-mvtop-accepted: true")
    );
    let files = ["examples/mvball/cam0.png", "examples/mvball/cam1.png"];
    let rig = ["infer", "--json", "--rig", "examples/mvball/rig.json"];
    let infer = cli(&[&rig[..], &files].concat()).output().unwrap();
    let text = String::from_utf8(infer.stdout).unwrap();
    assert_eq!(timeless(&got.text()), timeless(&text));
    assert_eq!(timeless(&text)["objects"].as_array().unwrap().len(), 1);
    let lines = |text: &str| text.lines().filter(|line| !line.contains("00e")).count();
    assert_eq!(lines(&got.text()), lines(&text));

    // In another order, with options in the query and in a part of its own.
    let mut parts = images();
    parts.reverse();
    let request = br#"{"T_base_world": [[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "most": 9}"#;
    parts.push(("request", "application/json", request.to_vec()));
    let got = server
        .post("?frame=base&classes=mvball&min_confidence=0.5", &[], &parts)
        .json();
    assert_eq!(
        (&got["frame"], &got["left_out"]["most"]),
        (&"base".into(), &0.into())
    );
    let object = &got["objects"][0];
    let x = |pose: &str| object[pose][0][3].as_f64().unwrap();
    assert!((x("T_frame_obj") - x("T_world_obj") - 1.0).abs() < 1e-12);
    assert_eq!(object["verdict"], "accept");
    let elsewhere = server.post("?region=5,5,5,6,6,6", &[], &images()).json();
    assert_eq!(
        (&elsewhere["objects"], &elsewhere["left_out"]["region"]),
        (&serde_json::json!([]), &1.into())
    );
    // The same by `infer`.
    let chosen = cli(&[
        &rig[..],
        &files,
        &["--region", "5", "5", "5", "6", "6", "6"],
    ]
    .concat());
    let infer = { chosen }.output().unwrap();
    assert_eq!(
        timeless(&String::from_utf8(infer.stdout).unwrap())["left_out"]["region"],
        1
    );

    for (path, kind) in [
        ("/", "text/html"),
        ("/page.js", "text/javascript"),
        ("/openapi.json", "application/json"),
        ("/healthz", "text/plain"),
        ("/readyz", "text/plain"),
        ("/v1/info", "application/json"),
        ("/v1/rigs/rig", "application/json"),
        ("/v1/models/mvball", "application/json"),
        ("/v1/exposures", "application/json"),
        ("/v1/exposures/1", "application/json"),
        ("/v1/exposures/1/views/cam1", "image/jpeg"),
    ] {
        let got = server.get(path, &[]);
        assert_eq!(got.status, 200, "{path}");
        assert!(got.head.contains(kind), "{path}: {}", got.head);
    }
    let api = server.get("/openapi.json", &[]).json();
    let text = api.to_string();
    let refs = text.split("\"$ref\":\"#").skip(1);
    let refs: Vec<&str> = refs.map(|rest| rest.split('"').next().unwrap()).collect();
    assert!(refs.contains(&"/components/schemas/Report"), "{refs:?}");
    assert!(refs.contains(&"/components/schemas/Request"), "{refs:?}");
    for path in refs {
        assert!(api.pointer(path).is_some(), "{path}");
    }
    let metrics = server.get("/metrics", &[]).text();
    for line in [
        "mvtop_requests_total{outcome=\"ok\"} 3",
        "mvtop_objects_total{class=\"mvball\"} 2",
        "mvtop_stage_seconds_count{stage=\"features\"} 3",
        "mvtop_confidence_count{class=\"mvball\"} 2",
        "mvtop_ready 1",
    ] {
        assert!(metrics.contains(line), "{line} in {metrics}");
    }
    assert_eq!(server.stop(), Some(0));
}

#[test]
fn grey_bytes_without_a_file_are_what_their_file_is() {
    let server = Server::start(&[]);
    let grey: Vec<_> = images()
        .into_iter()
        .map(|(name, _, png)| (name, image::load_from_memory(&png).unwrap().into_luma8()))
        .collect();
    let raw: Vec<_> = grey
        .iter()
        .map(|(name, image)| (*name, "image/x-raw-mono8", image.as_raw().clone()))
        .collect();
    let files: Vec<_> = grey
        .iter()
        .map(|(name, image)| {
            let mut png = std::io::Cursor::new(Vec::new());
            image.write_to(&mut png, image::ImageFormat::Png).unwrap();
            (*name, "image/png", png.into_inner())
        })
        .collect();
    let (of_raw, of_files) = (server.post("", &[], &raw), server.post("", &[], &files));
    assert_eq!(of_raw.status, 200, "{}", of_raw.text());
    assert_eq!(timeless(&of_raw.text()), timeless(&of_files.text()));
    let short = vec![("cam0", "image/x-raw-rgb8", vec![0; 17])];
    let refused = server.post("", &[], &short);
    assert_eq!(
        (refused.status, refused.code().as_str()),
        (400, "bad_request")
    );
    assert!(
        refused.text().contains("expected 921600 raw bytes"),
        "{}",
        refused.text()
    );
}

#[test]
fn priors_are_taken_and_reasons_are_told() {
    let server = Server::start(&[]);
    let found = server.post("", &[], &images()).json();
    let mut pose = found["objects"][0]["T_world_obj"].clone();
    let x = pose[0][3].as_f64().unwrap();
    pose[0][3] = (x + 0.2).into();
    let prior = serde_json::json!({
        "class": "mvball", "T_world_obj": pose, "sigma_m": 0.01, "sigma_deg": 60,
    });
    let request = serde_json::json!({"priors": [prior]}).to_string();
    let mut parts = images();
    parts.push(("request", "application/json", request.into_bytes()));
    let missed = server.post("?classes=mvball", &[], &parts).json();
    assert_eq!(missed["objects"], serde_json::json!([]));
    let why = &missed["why"][0];
    assert_eq!(
        (&why["class"], &why["reason"]),
        (&"mvball".into(), &"prior".into())
    );
    assert!((why["value"].as_f64().unwrap() - 20.0).abs() < 0.1);
    let refused =
        br#"{"planes": [{"point_m": [0,0,0], "normal": [0,0,0], "within_m": 1, "within_deg": 1}]}"#;
    let mut parts = images();
    parts.push(("request", "application/json", refused.to_vec()));
    let refused = server.post("", &[], &parts);
    assert_eq!(refused.status, 400);
    assert!(
        refused.text().contains("plane: normal"),
        "{}",
        refused.text()
    );
}
