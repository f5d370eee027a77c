//! The line protocol.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread;
use std::time::Duration;

use crate::client::{PATIENCE, Server, images, root};

#[test]
fn robots_ask_by_lines() {
    let server = Server::start(&["--line-port", "0", "--line-images", "examples/mvball"]);
    let nothing = server.ask(&["LAST"]).remove(0);
    assert!(
        nothing.starts_with("ERROR not_found LAST: no exposure yet"),
        "{nothing}"
    );

    let found = server.ask(&[
        "FIND min_confidence=0.5 frame=cam0",
        "LAST unit=mm rotation=abc",
    ]);
    let words = |answer: &str, line: usize| -> Vec<String> {
        let line = answer.lines().nth(line).unwrap();
        line.split(' ').map(str::to_owned).collect()
    };
    assert!(
        found[0].starts_with("OK exposure=1 poses=1 "),
        "{}",
        found[0]
    );
    assert!(
        found[0].contains(" frame=cam0 unit=m rotation=wxyz "),
        "{}",
        found[0]
    );
    let pose = words(&found[0], 1);
    assert_eq!(
        (pose[..3].join(" ").as_str(), pose[4].as_str(), pose.len()),
        ("POSE 0 mvball", "accept", 12)
    );
    let json = server.get("/v1/exposures/1", &[]).json();
    let object = &json["answer"]["objects"][0];
    let close = |word: &str, number: f64| (word.parse::<f64>().unwrap() - number).abs() < 1e-5;
    // cam0 is the reference camera.
    assert!(
        (0..3).all(|i| close(&pose[5 + i], object["t_m"][i].as_f64().unwrap())),
        "{pose:?}"
    );
    assert!(
        (0..4).all(|i| close(&pose[8 + i], object["q_wxyz"][i].as_f64().unwrap())),
        "{pose:?}"
    );
    let last = words(&found[1], 1);
    assert!(
        found[1].contains(" frame=world unit=mm rotation=abc "),
        "{}",
        found[1]
    );
    let x = object["T_world_obj"][0][3].as_f64().unwrap();
    assert!(
        (last[5].parse::<f64>().unwrap() - 1000.0 * x).abs() < 1e-2,
        "{last:?}"
    );
    assert_eq!(last.len(), 11);

    // What a program sends by HTTP is the last one, too.
    assert_eq!(server.post("", &[], &images()).status, 200);
    let said = server.ask(&[
        "LAST max_age_s=1000 region=5,5,5,6,6,6",
        "last most=1",
        "QUIT",
    ]);
    assert!(said[0].starts_with("OK exposure=2 poses=0 "), "{}", said[0]);
    assert!(
        said[1].starts_with("OK exposure=2 poses=1 ") && said[2] == "OK\nEND\n",
        "{said:?}"
    );

    for (line, said) in [
        ("GRAB", "expected FIND, LAST"),
        (
            "FIND nonsense=1",
            "one of: model, rig, stream, max_age_s, unit, rotation, reference,",
        ),
        ("FIND most", "NAME=VALUE"),
        ("FIND max_age_s=1", "look at the camera program"),
        ("FIND rig=nut", "no rig `nut`"),
        ("LAST refine=false", "ask for FIND"),
        ("LAST unit=inch", "expected m or mm"),
        ("LAST frame=base", "T_base_world"),
        ("LAST max_age_s=0", "old"),
        ("\u{1b}[31m", "\\u001b"),
    ] {
        let answer = server.ask(&[line]).remove(0);
        assert!(
            answer.starts_with("ERROR ") && answer.contains(said),
            "{line}: {answer}"
        );
        assert_eq!(answer.lines().count(), 2, "{answer}");
    }
    assert_eq!(server.stop(), Some(0));
}

#[test]
fn what_is_still_sent_after_the_last_answer_loses_none() {
    let server = Server::start(&["--line-port", "0"]);
    for (first, rest, said) in [
        ("x".repeat(10_000), "x\n", "4096 bytes"),
        ("QUIT\n".into(), "LAST\n", "OK\nEND\n"),
    ] {
        let mut stream = TcpStream::connect(server.lines.as_ref().unwrap()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(first.as_bytes()).unwrap();
        // The answer is there: a connection that is closed at once has been by now.
        thread::sleep(Duration::from_millis(300));
        stream.write_all(rest.as_bytes()).unwrap();
        thread::sleep(Duration::from_millis(300));
        stream.write_all(rest.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(
            answer.contains(said) && answer.ends_with("END\n"),
            "{answer}"
        );
    }
    assert_eq!(server.stop(), Some(0));
}

#[test]
fn plain_python_is_enough_for_a_robot() {
    let server = Server::start(&["--line-port", "0", "--line-images", "examples/mvball"]);
    let port = server.lines.as_ref().unwrap().rsplit(':').next().unwrap();
    let client = root().join("examples/robot_client.py");
    let ran = std::process::Command::new("python3")
        .args([
            &client.display().to_string(),
            "--port",
            port,
            "FIND",
            "most=1",
            "unit=mm",
            "min_confidence=0.5",
        ])
        .output()
        .unwrap();
    let (out, err) = (
        String::from_utf8_lossy(&ran.stdout),
        String::from_utf8_lossy(&ran.stderr),
    );
    assert!(ran.status.success(), "{err}");
    assert!(
        out.contains("name='mvball'") && out.contains("verdict='accept'"),
        "{out}"
    );
    let ran = std::process::Command::new("python3")
        .args([&client.display().to_string(), "--port", port, "GRAB"])
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&ran.stderr);
    assert!(
        !ran.status.success() && err.contains("expected FIND"),
        "{err}"
    );
}

/// The first pose of an answer, as words.
fn first_pose(answer: &str) -> Vec<&str> {
    let line = answer.lines().nth(1);
    line.unwrap_or_else(|| panic!("{answer}"))
        .split(' ')
        .collect()
}

#[test]
fn last_is_of_the_rig_that_is_asked_for_and_has_all_that_was_found() {
    let folder = tempfile::tempdir().unwrap();
    let example = std::fs::read(root().join("examples/mvball/rig.json")).unwrap();
    let mut rig: serde_json::Value = serde_json::from_slice(&example).unwrap();
    for camera in rig["cameras"].as_array_mut().unwrap() {
        // What lies at x in the world lies at x + 1 in the other one.
        for row in camera["T_cam_world"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .take(3)
        {
            let shift = row[3].as_f64().unwrap() - row[0].as_f64().unwrap();
            row[3] = shift.into();
        }
    }
    let moved = folder.path().join("moved.json");
    std::fs::write(&moved, rig.to_string()).unwrap();
    let moved = format!("moved={}", moved.display());
    let server = Server::start_with(
        "0",
        &["--rig", "first=examples/mvball/rig.json", "--rig", &moved],
        &["--line-port", "0", "--line-images", "examples/mvball"],
    );
    let said = server.ask(&[
        "FIND",
        "FIND rig=moved region=5,5,5,6,6,6",
        "LAST",
        "LAST rig=moved",
        "LAST rig=third",
        "LAST rig=moved rig=first",
    ]);
    assert!(said[1].contains(" poses=0 "), "{}", said[1]);
    assert_eq!(first_pose(&said[0])[5..8], first_pose(&said[2])[5..8]);
    let x = |answer: &str| first_pose(answer)[5].parse::<f64>().unwrap();
    // What the region left out is there.
    assert!((x(&said[3]) - x(&said[0]) - 1.0).abs() < 1e-3, "{said:?}");
    assert!(said[4].contains("no rig `third`"), "{}", said[4]);
    assert!(
        said[5].contains("expected it once, got it twice"),
        "{}",
        said[5]
    );
}

#[test]
fn images_of_a_folder_are_one_of_each_camera_and_of_a_known_age() {
    let folder = tempfile::tempdir().unwrap();
    let put = |camera: &str, name: &str| {
        let from = root().join(format!("examples/mvball/{camera}.png"));
        std::fs::copy(from, folder.path().join(name)).unwrap();
    };
    put("cam0", "cam0.PNG");
    put("cam1", "cam1.png");
    let images = folder.path().display().to_string();
    let server = Server::start(&["--line-port", "0", "--line-images", &images]);
    let found = server.ask(&["FIND max_age_s=100"]).remove(0);
    assert!(
        first_pose(&found)[3].parse::<f64>().unwrap() > 0.9,
        "{found}"
    );
    put("cam1", "cam1.Png");
    let twice = server.ask(&["FIND"]).remove(0);
    assert!(
        twice.contains("expected one image of each camera"),
        "{twice}"
    );
    std::fs::remove_file(folder.path().join("cam1.Png")).unwrap();
    let ahead = std::time::SystemTime::now() + Duration::from_secs(3600);
    let file = std::fs::File::options()
        .append(true)
        .open(folder.path().join("cam1.png"))
        .unwrap();
    file.set_modified(ahead).unwrap();
    let early = server.ask(&["FIND max_age_s=5"]).remove(0);
    assert!(
        early.contains("`cam1`") && early.contains("s ahead"),
        "{early}"
    );
    assert!(server.ask(&["FIND"]).remove(0).starts_with("OK "));
}
