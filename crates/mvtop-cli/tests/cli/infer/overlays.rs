//! Pictures of the result.

use super::*;

#[test]
fn overlays_are_drawn_and_never_replace_files_unasked() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("pictures");
    let out = out.to_str().unwrap();
    infer(&IDS[..2], &["--overlay", out]);
    let picture = |name: &str| image::open(Path::new(out).join(name)).unwrap().into_rgb8();
    for id in &IDS[..2] {
        let drawn = picture(&format!("{id}.png"));
        let plain = image::open(sample(&format!("{id}.png")))
            .unwrap()
            .into_rgb8();
        assert_eq!(drawn.dimensions(), plain.dimensions());
        assert_ne!(drawn, plain);
    }
    assert_eq!(picture("all_views.png").height(), 480);

    // The truth is drawn as well where it is known.
    let (rig, image, truth) = (sample("rig.json"), image_of("cam0"), sample("truth.json"));
    let mut pictures = Vec::new();
    for (folder, more) in [("plain", &[][..]), ("known", &["--truth", &truth][..])] {
        let dir = Path::new(out).join(folder);
        let dir = dir.to_str().unwrap();
        let args = [
            "infer",
            "--rig",
            &rig,
            &image,
            "--boxes",
            &truth,
            "--overlay",
            dir,
        ];
        stdout(&mvtop(&[&args[..], more].concat()));
        pictures.push(picture(&format!("{folder}/cam0.png")));
    }
    assert_ne!(pictures[0], pictures[1]);

    let again = ["infer", "--rig", &rig, &image, "--overlay", out];
    assert!(refusal(&mvtop(&again)).contains("exists already; give --force"));
    stdout(&mvtop(&[&again[..], &["--force"]].concat()));
    // There are no edges of classes without a mesh.
    let error = refusal(&mvtop(&[&again[..], &["--force", "--edges"]].concat()));
    assert!(
        error.contains("--edges: expected a model bundle with a mesh"),
        "{error}"
    );

    // Not even --force draws over the images that are looked at.
    let copy = folder.path().join("cam0.png");
    std::fs::copy(sample("cam0.png"), &copy).unwrap();
    let (image, dir) = (
        format!("cam0={}", copy.display()),
        folder.path().display().to_string(),
    );
    let onto = ["infer", "--rig", &rig, &image, "--overlay", &dir, "--force"];
    assert!(refusal(&mvtop(&onto)).contains("is one of the files that are read"));
    assert_eq!(
        std::fs::read(&copy).unwrap(),
        std::fs::read(sample("cam0.png")).unwrap()
    );
}

#[cfg(unix)]
#[test]
fn overlays_do_not_write_through_links_nor_onto_inputs_by_another_name() {
    use std::os::unix::fs::symlink;
    let (rig, folder) = (sample("rig.json"), tempfile::tempdir().unwrap());
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let dir = out.display().to_string();
    let input = folder.path().join("input.png");
    std::fs::copy(sample("cam0.png"), &input).unwrap();
    let image = format!("cam0={}", input.display());
    let draw = |more: &[&str]| {
        let args = ["infer", "--rig", &rig, &image, "--overlay", &dir];
        mvtop(&[&args[..], more].concat())
    };
    // A link that leads nowhere is there all the same; with --force it is replaced, not followed.
    let elsewhere = folder.path().join("elsewhere.png");
    symlink(&elsewhere, out.join("cam0.png")).unwrap();
    assert!(refusal(&draw(&[])).contains("exists already"));
    stdout(&draw(&["--force"]));
    assert!(!elsewhere.exists());
    assert!(out.join("cam0.png").symlink_metadata().unwrap().is_file());
    // An input by another name.
    let picture = out.join("cam0.png");
    for link in [symlink::<&Path, &Path>, std::fs::hard_link] {
        std::fs::remove_file(&picture).unwrap();
        link(&input, &picture).unwrap();
        let error = refusal(&draw(&["--force"]));
        assert!(
            error.contains("is one of the files that are read"),
            "{error}"
        );
    }
    let plain = std::fs::read(sample("cam0.png")).unwrap();
    assert_eq!(std::fs::read(&input).unwrap(), plain);
}
