//! A service to test, and the plainest client of it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longer than any answer takes.
pub const PATIENCE: Duration = Duration::from_secs(120);

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

pub fn cli(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mvtop-cli"));
    command.args(args).current_dir(root());
    command
        .env("MVTOP_MODEL", "models/mvball")
        .env_remove("MVTOP_TOKEN");
    command
}

/// A process that serves the example, ended with the test.
pub struct Server {
    pub child: Child,
    pub address: String,
    pub lines: Option<String>,
    log: Mutex<Receiver<String>>,
}

impl Server {
    /// On a port that is free.
    ///
    /// - `args`: beside the rig and the port
    pub fn start(args: &[&str]) -> Self {
        Self::start_at("0", args)
    }

    pub fn start_at(port: &str, args: &[&str]) -> Self {
        Self::start_with(port, &["--rig", "examples/mvball/rig.json"], args)
    }

    pub fn start_with(port: &str, rigs: &[&str], args: &[&str]) -> Self {
        let mut command = cli(&[&["serve", "--port", port], rigs, args].concat());
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        let (said, log) = channel();
        thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                let _ = said.send(line);
            }
        });
        let (mut address, mut lines) = (None, None);
        loop {
            let line = log
                .recv_timeout(PATIENCE)
                .expect("the service is ready before long");
            if let Some(at) = line.strip_prefix("listening on http://") {
                address = Some(at.trim_end_matches('/').to_owned());
            } else if let Some(at) = line.strip_prefix("lines on ") {
                lines = Some(at.to_owned());
            } else if line == "ready" {
                break;
            } else {
                assert!(!line.starts_with("error"), "{line}");
            }
        }
        let (address, log) = (address.unwrap(), Mutex::new(log));
        Self {
            child,
            address,
            lines,
            log,
        }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    pub fn get(&self, path: &str, headers: &[&str]) -> Answer {
        let mut stream = self.connect();
        stream
            .write_all(&head("GET", path, &self.address, headers))
            .unwrap();
        Answer::read(stream)
    }

    pub fn post(&self, query: &str, headers: &[&str], parts: &[Part]) -> Answer {
        let mut stream = self.connect();
        stream
            .write_all(&self.posted(query, headers, parts))
            .unwrap();
        Answer::read(stream)
    }

    /// Waits until as many exposures are worked on or wait; `false` where that takes longer.
    pub fn comes_to_queue(&self, length: usize, within: Duration) -> bool {
        let line = format!("mvtop_queue_length {length}.0");
        let began = Instant::now();
        while !self.get("/metrics", &[]).text().contains(&line) {
            if began.elapsed() > within {
                return false;
            }
            thread::sleep(Duration::from_millis(50));
        }
        true
    }

    /// The bytes of a request.
    pub fn posted(&self, query: &str, headers: &[&str], parts: &[Part]) -> Vec<u8> {
        let body = multipart(parts);
        let length = format!("Content-Length: {}", body.len());
        let mut all = vec![
            "Content-Type: multipart/form-data; boundary=frontier",
            &length,
        ];
        all.extend(headers);
        let mut bytes = head("POST", &format!("/v1/predict{query}"), &self.address, &all);
        bytes.extend(body);
        bytes
    }

    /// Sends lines to the line protocol, and reads as many answers.
    pub fn ask(&self, lines: &[&str]) -> Vec<String> {
        let stream = TcpStream::connect(self.lines.as_ref().unwrap()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut read = BufReader::new(stream.try_clone().unwrap());
        let answered = |line: &&str| {
            writeln!(&stream, "{line}").unwrap();
            let mut answer = String::new();
            while !answer.ends_with("END\n") {
                assert_ne!(read.read_line(&mut answer).unwrap(), 0, "{answer}");
            }
            answer
        };
        lines.iter().map(answered).collect()
    }

    /// Tells the process to end.
    #[cfg(unix)]
    pub fn terminate(&self) {
        let id = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args(["-TERM", &id])
                .status()
                .unwrap()
                .success()
        );
    }

    /// Its exit code, once it has ended by itself; `None` where that takes longer.
    pub fn ends_within(&mut self, time: Duration) -> Option<i32> {
        let began = Instant::now();
        while began.elapsed() < time {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            thread::sleep(Duration::from_millis(50));
        }
        None
    }

    /// Ends it, and returns its exit code.
    #[cfg(unix)]
    pub fn stop(mut self) -> Option<i32> {
        self.terminate();
        self.child.wait().unwrap().code()
    }

    /// Its log so far holds no sign of a panic.
    fn is_sound(&self) -> bool {
        let log = self.log.lock().unwrap();
        log.try_iter().all(|line| !line.contains("panicked"))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if !thread::panicking() {
            assert!(self.is_sound());
        }
    }
}

/// A part of a body: its name, its content type, its bytes.
pub type Part<'a> = (&'a str, &'a str, Vec<u8>);

fn multipart(parts: &[Part]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, kind, bytes) in parts {
        let disposition =
            format!("Content-Disposition: form-data; name=\"{name}\"; filename=\"a\"");
        body.extend(format!("--frontier\r\n{disposition}\r\nContent-Type: {kind}\r\n\r\n").bytes());
        body.extend(bytes);
        body.extend(b"\r\n");
    }
    body.extend(b"--frontier--\r\n");
    body
}

fn head(method: &str, path: &str, host: &str, headers: &[&str]) -> Vec<u8> {
    let mut head = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\n");
    if !headers.iter().any(|header| header.starts_with("Host:")) {
        head.push_str(&format!("Host: {host}\r\n"));
    }
    for header in headers {
        head.push_str(&format!("{header}\r\n"));
    }
    head.push_str("\r\n");
    head.into_bytes()
}

/// The example's images.
pub fn images() -> Vec<Part<'static>> {
    let image = |name: &'static str| {
        let bytes = std::fs::read(root().join(format!("examples/mvball/{name}.png"))).unwrap();
        (name, "image/png", bytes)
    };
    vec![image("cam0"), image("cam1")]
}

/// The example's images, and boxes of as many objects: each takes its time.
pub fn images_with_boxes(objects: usize) -> Vec<Part<'static>> {
    let boxes = serde_json::json!({"cam0": [10, 10, 160, 160], "cam1": [10, 10, 160, 160]});
    let one = serde_json::json!({"class": "mvball", "boxes": boxes});
    let request = serde_json::json!({"boxes": vec![one; objects]}).to_string();
    let mut parts = images();
    parts.push(("request", "application/json", request.into_bytes()));
    parts
}

pub struct Answer {
    pub status: u16,
    /// In lower case.
    pub head: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn read(mut stream: TcpStream) -> Self {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("no answer: {}", String::from_utf8_lossy(&bytes)));
        let head = String::from_utf8(bytes[..end].to_vec())
            .unwrap()
            .to_lowercase();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let body = bytes[end + 4..].to_vec();
        Self { status, head, body }
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}", self.text()))
    }

    /// The code of an error, whose body has the documented form.
    pub fn code(&self) -> String {
        let error = &self.json()["error"];
        let message = error["message"].as_str().unwrap();
        assert!(!message.is_empty() && !message.contains('\n'), "{message}");
        assert!(error["request_id"].is_string());
        error["code"].as_str().unwrap().to_owned()
    }
}

/// A document without what differs from run to run.
pub fn timeless(text: &str) -> Value {
    let mut document: Value = serde_json::from_str(text).unwrap();
    document["timings_ms"] = Value::Null;
    document
}
