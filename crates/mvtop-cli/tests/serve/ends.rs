//! How work and the service itself end: at their time, with their clients, told to, and killed.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread;
use std::time::Duration;

use crate::client::{Answer, Server, images, images_with_boxes};
use crate::strangers::stalled;

/// Objects with boxes in a request that takes a minute or so.
const MANY: usize = 100;
/// By when work that nobody waits for has ended, which is long before it is done.
const SOON: Duration = Duration::from_secs(30);

#[test]
fn work_ends_with_its_time() {
    let server = Server::start(&["--request-seconds", "3"]);
    let late = server.post("", &[], &images_with_boxes(MANY));
    assert_eq!((late.status, late.code().as_str()), (504, "timed_out"));
    assert!(server.comes_to_queue(0, SOON));
    // The list of the last exposures has it.
    let told = server.get("/v1/exposures/1", &[]).json();
    let told = told["error"].as_str().unwrap().to_owned();
    assert!(told.contains("ended before it was done"), "{told}");
}

#[test]
fn work_ends_with_its_client() {
    let server = Server::start(&["--line-port", "0", "--line-images", "examples/mvball"]);
    let mut stream = server.connect();
    stream
        .write_all(&server.posted("", &[], &images_with_boxes(MANY)))
        .unwrap();
    assert!(server.comes_to_queue(1, SOON));
    // Some of the work is done.
    thread::sleep(Duration::from_secs(2));
    // A robot that goes while it waits leaves its place as well.
    let mut robot = TcpStream::connect(server.lines.as_ref().unwrap()).unwrap();
    robot.write_all(b"FIND\n").unwrap();
    assert!(server.comes_to_queue(2, SOON));
    drop(robot);
    drop(stream);
    assert!(server.comes_to_queue(0, SOON));
    assert_eq!(server.post("", &[], &images()).status, 200);
    let metrics = server.get("/metrics", &[]).text();
    let abandoned = "mvtop_requests_total{outcome=\"abandoned\"} 2";
    assert!(metrics.contains(abandoned), "{metrics}");
}

#[test]
fn told_to_end_it_finishes_what_runs() {
    let mut server = Server::start(&[]);
    let mut asked: Vec<_> = (0..3).map(|_| server.connect()).collect();
    for stream in &mut asked {
        stream
            .write_all(&server.posted("", &[], &images()))
            .unwrap();
    }
    // They are in the queue before SIGTERM.
    while server.get("/v1/exposures", &[]).json()["exposures"]
        .as_array()
        .unwrap()
        .is_empty()
    {
        thread::sleep(Duration::from_millis(5));
    }
    server.terminate();
    for stream in asked {
        assert_eq!(Answer::read(stream).status, 200);
    }
    assert_eq!(server.child.wait().unwrap().code(), Some(0));
}

#[test]
fn told_to_end_it_waits_for_no_client_that_does_not_read() {
    let mut server = Server::start(&[]);
    let _stalled = stalled(&server);
    let _silent = server.connect();
    // One that has begun to send images, which would not be looked at any more.
    let bytes = server.posted("", &[], &images());
    let mut sending = server.connect();
    sending.write_all(&bytes[..bytes.len() / 2]).unwrap();
    server.terminate();
    assert_eq!(server.ends_within(Duration::from_secs(15)), Some(0));
    let mut rest = Vec::new();
    let _ = sending.read_to_end(&mut rest);
}
