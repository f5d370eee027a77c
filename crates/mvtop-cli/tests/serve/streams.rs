//! Objects that keep their numbers over time.

use std::io::Write;
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use crate::client::{Answer, Part, Server, images, root};

/// The image of `cam0`, with all that it shows moved to the right.
fn moved(by: u32) -> Vec<Part<'static>> {
    let (name, kind, png) = images().remove(0);
    let image = image::load_from_memory(&png).unwrap().into_rgb8();
    let width = image.width();
    let moved = image::RgbImage::from_fn(width, image.height(), |x, y| {
        *image.get_pixel((x + width - by) % width, y)
    });
    let mut png = std::io::Cursor::new(Vec::new());
    moved.write_to(&mut png, image::ImageFormat::Png).unwrap();
    vec![(name, kind, png.into_inner())]
}

fn ids(answer: &Answer) -> Vec<Value> {
    let objects = answer.json()["objects"].as_array().unwrap().clone();
    objects.iter().map(|one| one["track_id"].clone()).collect()
}

/// Which exposure of its stream it is.
fn count(answer: &Answer) -> Option<u64> {
    let mut lines = answer.head.lines();
    let count = lines.find_map(|line| line.strip_prefix("x-mvtop-stream-exposures: "))?;
    Some(count.parse().unwrap())
}

#[test]
fn objects_of_a_stream_keep_their_numbers() {
    let server = Server::start(&[]);
    let first = server.post("?stream=a", &[], &moved(0));
    assert_eq!(
        (ids(&first), count(&first)),
        (vec![json!(1)], Some(1)),
        "{}",
        first.text()
    );
    let second = server.post("?stream=a", &[], &images());
    assert_eq!((ids(&second), count(&second)), (vec![json!(1)], Some(2)));
    // Farther than half its diameter.
    let elsewhere = server.post("?stream=a", &[], &moved(100));
    assert_eq!(ids(&elsewhere), [json!(2)]);
    // What is not wanted keeps its number, too.
    let unwanted = server.post("?stream=a&region=5,5,5,6,6,6", &[], &images());
    assert_eq!(
        (ids(&unwanted), count(&unwanted)),
        (Vec::new(), Some(4)),
        "{}",
        unwanted.text()
    );
    assert_eq!(ids(&server.post("?stream=a", &[], &images())), [json!(1)]);

    let other = server.post("?stream=b", &[], &moved(100));
    assert_eq!((ids(&other), count(&other)), (vec![json!(1)], Some(1)));
    let without = server.post("", &[], &images());
    assert_eq!((ids(&without), count(&without)), (vec![Value::Null], None));

    let metrics = server.get("/metrics", &[]).text();
    assert!(metrics.contains("mvtop_streams 2"), "{metrics}");
    let listed = server.get("/v1/exposures/1", &[]).json();
    assert_eq!(listed["stream"], "a");
    let api = server.get("/openapi.json", &[]).json();
    let parameters = &api["paths"]["/v1/predict"]["post"]["parameters"];
    let mut parameters = parameters.as_array().unwrap().iter();
    assert!(parameters.any(|one| one["name"] == "stream"));

    // An exposure that fails is none of the stream.
    let broken = vec![("cam0", "image/png", b"no image".to_vec())];
    assert_eq!(server.post("?stream=a", &[], &broken).status, 400);
    assert_eq!(count(&server.post("?stream=a", &[], &images())), Some(6));
    for name in ["", "a%20b", &"x".repeat(65)] {
        let refused = server.post(&format!("?stream={name}"), &[], &images());
        assert_eq!(
            (refused.status, refused.code().as_str()),
            (400, "bad_request")
        );
        assert!(
            refused.text().contains("stream: expected a name"),
            "{}",
            refused.text()
        );
    }
}

#[test]
fn requests_of_a_stream_are_answered_in_their_order() {
    let server = Server::start(&[]);
    let send = |query: &str, parts: &[Part]| {
        let mut stream = server.connect();
        stream.write_all(&server.posted(query, &[], parts)).unwrap();
        thread::sleep(Duration::from_millis(100));
        stream
    };
    // What the others wait for. Those with one image are decoded sooner.
    let before = send("", &images());
    let of_stream: Vec<_> = (0..4)
        .map(|number| match number % 2 {
            0 => send("?stream=a", &images()),
            _ => send("?stream=a", &moved(0)),
        })
        .collect();
    let other = send("?stream=b", &images());
    // One that has gone stops nobody.
    drop(send("?stream=a", &images()));
    let last = send("?stream=a", &images());
    for (at, stream) in of_stream.into_iter().enumerate() {
        let answer = Answer::read(stream);
        assert_eq!(count(&answer), Some(at as u64 + 1), "{}", answer.text());
        assert_eq!(ids(&answer), [json!(1)]);
    }
    assert_eq!(count(&Answer::read(other)), Some(1));
    assert!(count(&Answer::read(last)) >= Some(5));
    assert_eq!(Answer::read(before).status, 200);
}

#[test]
fn robots_are_told_the_numbers() {
    let server = Server::start(&["--line-port", "0", "--line-images", "examples/mvball"]);
    let said = server.ask(&[
        "FIND stream=a",
        "FIND",
        "LAST stream=a",
        "LAST",
        "LAST stream=b",
        "FIND stream=/",
    ]);
    let pose = |at: usize| said[at].lines().nth(1).unwrap();
    for (at, told) in [(0, true), (1, false), (2, true), (3, false)] {
        assert_eq!(pose(at).ends_with(" id=1"), told, "{}", said[at]);
    }
    assert!(said[2].starts_with("OK exposure=1 "), "{}", said[2]);
    assert!(
        said[4].starts_with("ERROR not_found LAST: no exposure of stream `b`"),
        "{}",
        said[4]
    );
    assert!(said[5].contains("stream: expected a name"), "{}", said[5]);

    let port = server.lines.as_ref().unwrap().rsplit(':').next().unwrap();
    let client = root().join("examples/robot_client.py");
    let ran = std::process::Command::new("python3")
        .arg(client)
        .args(["--port", port, "FIND", "stream=a"])
        .output()
        .unwrap();
    let out = String::from_utf8_lossy(&ran.stdout);
    assert!(out.contains("id=1"), "{out}");
}
