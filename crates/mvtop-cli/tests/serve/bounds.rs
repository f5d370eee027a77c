//! What is refused, and what becomes of those who do not behave.

use std::io::Write;
use std::thread;
use std::time::Duration;

use crate::client::{Answer, Server, cli, images, images_with_boxes};

#[test]
fn what_is_wrong_is_told_in_one_sentence() {
    let server = Server::start(&["--max-body-mb", "1"]);
    let broken = |bytes: &[u8]| vec![("cam0", "image/png", bytes.to_vec())];
    let whole = images().remove(0).2;
    let two = vec![
        ("cam0", "image/png", whole.clone()),
        ("cam0", "image/png", whole.clone()),
    ];
    let request = |text: &str| {
        let mut parts = images();
        parts.push(("request", "application/json", text.as_bytes().to_vec()));
        parts
    };
    for (query, parts, status, said) in [
        ("", broken(b"no image"), 400, "none of PNG"),
        ("", broken(b""), 400, "none of PNG"),
        ("", broken(&whole[..whole.len() / 2]), 400, "camera `cam0`"),
        ("", vec![], 400, "an image as a part"),
        (
            "",
            vec![("top", "image/png", whole.clone())],
            400,
            "no camera `top`",
        ),
        ("", two, 400, "got two"),
        ("?model=nut", images(), 400, "no model `nut`"),
        ("?rig=nut", images(), 400, "no rig `nut`"),
        ("?classes=nut", images(), 400, "no class `nut`"),
        (
            "?nonsense=1",
            images(),
            400,
            "no such setting, expected one of: model, rig, stream, reference,",
        ),
        ("", images_with_boxes(101), 400, "100 objects at most"),
        ("?min_views=3", images(), 400, "at most 2"),
        ("?frame=base", images(), 400, "T_base_world"),
        ("?grasps=true", images(), 400, "grasps.json"),
        ("", request("{"), 400, "request: expected JSON"),
        ("", request(r#"{"nonsense": 1}"#), 400, "unknown field"),
        ("", broken(&vec![0; 3 << 20]), 413, "--max-body-mb"),
        ("", request(&" ".repeat(300_000)), 413, "262144 bytes"),
        ("?rig=a&rig=b", images(), 400, "`rig`: expected it once"),
        (
            "",
            vec![(&*"a".repeat(100_000).leak(), "image/png", whole.clone())],
            400,
            "part `aaa",
        ),
    ] {
        let got = server.post(query, &[], &parts);
        assert_eq!(got.status, status, "{query}: {}", got.text());
        got.code();
        assert!(got.text().contains(said), "{said}: {}", got.text());
        assert!(got.text().len() < 4000, "{said}");
    }
    for (path, headers, code) in [
        ("/nothing", vec![], "not_found"),
        ("/v1/predict", vec![], "not_allowed"),
        ("/v1/exposures/x", vec![], "bad_request"),
        ("/v1/exposures/999", vec![], "not_found"),
        ("/v1/rigs/..%2f..", vec![], "not_found"),
        // A page of another host that leads its name here, and one that posts from elsewhere.
        ("/v1/info", vec!["Host: example.org:8080"], "forbidden"),
        ("/v1/info", vec!["Origin: http://example.org"], "forbidden"),
    ] {
        let got = server.get(path, &headers);
        assert_eq!(got.code(), code, "{path}");
        assert!(got.head.contains("x-request-id"), "{}", got.head);
    }
    let mut stream = server.connect();
    let plain = format!(
        "POST /v1/predict HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Length: 2\r\n\r\n{{}}",
        server.address
    );
    stream.write_all(plain.as_bytes()).unwrap();
    let got = Answer::read(stream);
    assert!(got.text().contains("multipart/form-data"), "{}", got.text());
    // And it still works.
    assert_eq!(server.post("", &[], &images()).status, 200);
}

#[test]
fn refusals_reach_who_still_sends() {
    let server = Server::start(&["--max-body-mb", "1"]);
    let image = vec![("cam0", "image/png", vec![0; 8 << 20])];
    for (query, status) in [("", 413), ("?model=nut", 400)] {
        let bytes = server.posted(query, &[], &image);
        let mut stream = server.connect();
        for piece in bytes.chunks(3 << 20) {
            stream.write_all(piece).unwrap();
            thread::sleep(Duration::from_millis(200));
        }
        assert_eq!(Answer::read(stream).status, status);
    }
}

#[test]
fn arguments_that_cannot_be_meant_end_it_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let short = folder.path().join("token");
    std::fs::write(&short, "abc").unwrap();
    let short = short.display().to_string();
    let rig = ["serve", "--port", "0", "--rig", "examples/mvball/rig.json"];
    for (args, said) in [
        (vec!["--model", "no/such"], "no/such"),
        (
            vec!["--rig", "rig=examples/ycbv4/rig.json"],
            "two rigs have the name `rig`",
        ),
        (
            vec!["--rig", "a b=examples/ycbv4/rig.json"],
            "letters, digits",
        ),
        (vec!["--token-file", &short], "at least 16"),
        (vec!["--host", "256.0.0.1"], "cannot listen"),
        (vec!["--record", "Cargo.toml"], "--record Cargo.toml"),
    ] {
        let ended = cli(&[&rig[..], &args].concat()).output().unwrap();
        let stderr = String::from_utf8_lossy(&ended.stderr);
        let last = stderr.lines().last().unwrap_or_default();
        assert_eq!(ended.status.code(), Some(2), "{stderr}");
        assert!(
            last.starts_with("error: ") && last.contains(said),
            "{stderr}"
        );
    }
}

#[test]
fn token_opens_what_is_not_for_everybody() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("token");
    std::fs::write(&file, "0123456789abcdef0123\n").unwrap();
    let server = Server::start(&[
        "--token-file",
        &file.display().to_string(),
        "--line-port",
        "0",
    ]);
    let right = "Authorization: Bearer 0123456789abcdef0123";
    for headers in [
        vec![],
        vec!["Authorization: Bearer 0123456789abcdef012"],
        vec!["Authorization: 0123456789abcdef0123"],
    ] {
        for path in ["/v1/info", "/metrics", "/v1/exposures"] {
            let got = server.get(path, &headers);
            assert_eq!((got.status, got.code().as_str()), (401, "unauthorized"));
        }
        assert_eq!(server.post("", &headers, &images()).status, 401);
    }
    for path in ["/", "/healthz", "/readyz", "/page.js"] {
        assert_eq!(server.get(path, &[]).status, 200, "{path}");
    }
    assert_eq!(server.get("/v1/info", &[right]).status, 200);
    assert_eq!(server.post("", &[right], &images()).status, 200);
    let said = server.ask(&["LAST", "TOKEN wrong", "TOKEN 0123456789abcdef0123", "LAST"]);
    assert!(said[0].starts_with("ERROR unauthorized") && said[1].starts_with("ERROR unauthorized"));
    assert!(
        said[2] == "OK\nEND\n" && said[3].starts_with("OK exposure=1 "),
        "{said:?}"
    );
}

#[test]
fn full_queue_says_when_to_come_again_and_loses_nothing() {
    let server = Server::start(&["--waiting", "1"]);
    let answers: Vec<(String, Answer)> = thread::scope(|scope| {
        let ask = |number: usize| {
            let server = &server;
            scope.spawn(move || {
                let id = format!("client-{number}");
                let answer = server.post("", &[&format!("X-Request-Id: {id}")], &images());
                (id, answer)
            })
        };
        let asked: Vec<_> = (0..8).map(ask).collect();
        asked.into_iter().map(|one| one.join().unwrap()).collect()
    });
    let mut answered = 0;
    for (id, answer) in &answers {
        assert!(
            answer.head.contains(&format!("x-request-id: {id}")),
            "{}",
            answer.head
        );
        match answer.status {
            200 => answered += 1,
            status => {
                assert_eq!((status, answer.code().as_str()), (503, "busy"));
                assert!(answer.head.contains("retry-after: 1"), "{}", answer.head);
            }
        }
    }
    assert!((2..8).contains(&answered), "{answered} of 8 answered");
}

#[test]
fn clients_that_vanish_are_not_waited_for() {
    let server = Server::start(&["--waiting", "20", "--body-seconds", "1"]);
    let bytes = server.posted("", &[], &images());
    for _ in 0..10 {
        let mut stream = server.connect();
        stream.write_all(&bytes).unwrap();
        thread::sleep(Duration::from_millis(20));
        drop(stream);
    }
    // In the middle of their images.
    for _ in 0..5 {
        server
            .connect()
            .write_all(&bytes[..bytes.len() / 2])
            .unwrap();
    }
    // And one that only seems to send.
    let mut slow = server.connect();
    slow.write_all(&bytes[..bytes.len() / 2]).unwrap();
    let slow = Answer::read(slow);
    assert_eq!((slow.status, slow.code().as_str()), (408, "too_slow"));
    assert_eq!(server.post("", &[], &images()).status, 200);
    let metrics = server.get("/metrics", &[]).text();
    let abandoned = metrics
        .lines()
        .find(|line| line.contains("abandoned"))
        .unwrap();
    let count: u32 = abandoned.rsplit(' ').next().unwrap().parse().unwrap();
    assert!(count >= 5, "{metrics}");
    assert!(metrics.contains("mvtop_queue_length 0"), "{metrics}");
}
