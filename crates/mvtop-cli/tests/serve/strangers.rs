//! Clients that have not shown that the service is for them, or do not read what they asked for.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::thread;
use std::time::{Duration, Instant};

use crate::client::Server;

/// Connections at once by HTTP and by lines, as the service has them.
const PLACES: usize = 256;
const LINE_PLACES: usize = 16;
/// By when those who hold all places have lost them: twice the time of a stranger.
const SOON: Duration = Duration::from_secs(20);
/// Longer than a stranger may stay.
const LONG: Duration = Duration::from_secs(13);

const TOKEN: &str = "0123456789abcdef0123";

/// A client that asks for more than it reads.
pub fn stalled(server: &Server) -> TcpStream {
    let mut stream = server.connect();
    let ask = format!(
        "GET /openapi.json HTTP/1.1\r\nHost: {}\r\n\r\n",
        server.address
    );
    stream.write_all(ask.repeat(400).as_bytes()).unwrap();
    stream
}

/// A service with a token and lines, and the folder of the token.
fn with_token() -> (Server, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("token");
    std::fs::write(&file, TOKEN).unwrap();
    let file = file.display().to_string();
    let server = Server::start(&["--token-file", &file, "--line-port", "0"]);
    (server, folder)
}

fn robot(server: &Server) -> TcpStream {
    TcpStream::connect(server.lines.as_ref().unwrap()).unwrap()
}

#[test]
fn clients_that_do_not_read_lock_nobody_out() {
    let server = Server::start(&[]);
    let all: Vec<TcpStream> = (0..PLACES + 4).map(|_| stalled(&server)).collect();
    let began = Instant::now();
    assert_eq!(server.get("/healthz", &[]).status, 200);
    assert!(began.elapsed() < SOON, "{:?}", began.elapsed());
    drop(all);
}

#[test]
fn connections_without_a_token_do_not_stay() {
    let (server, _folder) = with_token();
    let ask = |stream: &mut TcpStream, asked: &str, end: &str| -> std::io::Result<()> {
        let host = &server.address;
        let text = format!("GET {asked}\r\nHost: {host}\r\n\r\n");
        stream.write_all(text.as_bytes())?;
        let mut got = Vec::new();
        while !got.ends_with(end.as_bytes()) {
            let mut some = [0; 4096];
            match stream.read(&mut some)? {
                0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
                count => got.extend(&some[..count]),
            }
        }
        Ok(())
    };
    let info = format!("/v1/info HTTP/1.1\r\nAuthorization: Bearer {TOKEN}");
    let (mut stranger, mut known) = (server.connect(), server.connect());
    ask(&mut known, &info, "}").unwrap();
    let began = Instant::now();
    let mut stays = true;
    while began.elapsed() < LONG {
        stays = stays && ask(&mut stranger, "/healthz HTTP/1.1", "alive\n").is_ok();
        thread::sleep(Duration::from_millis(500));
    }
    assert!(!stays);
    ask(&mut known, &info, "}").unwrap();
}

#[test]
fn silent_robots_lock_nobody_out() {
    let server = Server::start(&["--line-port", "0"]);
    let all: Vec<TcpStream> = (0..LINE_PLACES).map(|_| robot(&server)).collect();
    let began = Instant::now();
    assert!(server.ask(&["LAST"])[0].starts_with("ERROR not_found"));
    assert!(began.elapsed() < SOON, "{:?}", began.elapsed());
    drop(all);
}

#[test]
fn robots_without_the_token_lock_nobody_out() {
    let (server, _folder) = with_token();
    let known = robot(&server);
    let mut answers = BufReader::new(known.try_clone().unwrap()).lines();
    let mut ask = |line: &str| {
        writeln!(&known, "{line}").unwrap();
        let answer = answers.next().unwrap().unwrap();
        assert_eq!(answers.next().unwrap().unwrap(), "END");
        answer
    };
    assert_eq!(ask(&format!("TOKEN {TOKEN}")), "OK");
    let mut all: Vec<TcpStream> = (1..LINE_PLACES).map(|_| robot(&server)).collect();
    thread::scope(|scope| {
        scope.spawn(|| {
            let began = Instant::now();
            while began.elapsed() < LONG {
                // Half of them are not silent.
                for stream in all.iter_mut().step_by(2) {
                    let _ = stream.write_all(b"TOKEN wrong\n");
                }
                thread::sleep(Duration::from_secs(1));
            }
        });
        let began = Instant::now();
        let said = server.ask(&[&format!("TOKEN {TOKEN}"), "LAST"]);
        assert_eq!(said[0], "OK\nEND\n");
        assert!(began.elapsed() < SOON, "{:?}", began.elapsed());
    });
    // Who has shown it may be silent.
    assert!(ask("LAST").starts_with("ERROR not_found"));
}

#[test]
fn names_that_others_may_have_led_here_are_refused() {
    let local = Server::start(&[]);
    let here = format!("Host: {}", local.address);
    let own = format!("http://{}/v1/info", local.address);
    for (path, headers, code) in [
        // What reads one of them may be another program than the one that is asked.
        (
            "/v1/info",
            vec![here.as_str(), "Host: 127.0.0.1"],
            "bad_request",
        ),
        ("/v1/info", vec!["Host: \u{e9}"], "bad_request"),
        ("http://example.org/v1/info", vec![], "bad_request"),
        ("http://127.0.0.1/v1/info", vec![], "bad_request"),
        ("/v1/info", vec!["Origin: http://\u{e9}"], "bad_request"),
        ("/v1/info", vec!["Origin: null"], "forbidden"),
        (&own, vec!["Host: example.org"], "bad_request"),
    ] {
        let got = local.get(path, &headers);
        assert_eq!(got.code(), code, "{path} {headers:?}");
    }
    assert_eq!(local.get(&own, &[]).status, 200);

    let open = Server::start(&["--host", "0.0.0.0"]);
    for (host, status) in [
        ("192.168.0.7:8080", 200),
        ("[fd00::7]:8080", 200),
        ("cell-7:8080", 200),
        ("localhost", 200),
        ("example.org:8080", 403),
        ("192.168.0.7.example.org", 403),
        ("", 403),
    ] {
        let got = open.get("/v1/info", &[&format!("Host: {host}")]);
        assert_eq!(got.status, status, "{host}: {}", got.text());
    }
    let (guarded, _folder) = with_token();
    let token = format!("Authorization: Bearer {TOKEN}");
    let got = guarded.get("/v1/info", &["Host: cell.example.org", &token]);
    assert_eq!(got.status, 200);
}
