//! Images and their cameras: names, order, sizes.

use super::*;

#[test]
fn images_that_do_not_fit_the_rig_are_refused_before_anything_is_loaded() {
    let rig = sample("rig.json");
    // No library, no model: whatever is wrong with them must not come first.
    let infer = |images: &[&str]| {
        let fixed = [
            "infer",
            "--rig",
            &rig,
            "--ort-lib",
            "none.so",
            "--model",
            "none",
        ];
        refusal(&mvtop(&[&fixed, images].concat()))
    };
    let error = infer(&["a.png", "b.png"]);
    assert!(
        error.contains("expected 4 images") && error.contains("ID=PATH"),
        "{error}"
    );
    let error = infer(&["top=a.png"]);
    assert!(
        error.contains("no camera `top`") && error.contains("cam0, cam1"),
        "{error}"
    );
    let error = infer(&["cam0=a.png", "b.png"]);
    assert!(
        error.contains("some images are given as ID=PATH"),
        "{error}"
    );
    let error = infer(&["cam0=none.png"]);
    assert!(error.contains("cannot read none.png"), "{error}");
    let error = infer(&[&format!("cam0={rig}")]);
    assert!(error.contains("none of PNG, JPEG, TIFF and BMP"), "{error}");
    let error = infer(&["cam0=examples/mvball/cam0.png"]);
    assert!(
        error.contains("`cam0`: expected 160x120 px as in the rig, got 640x480"),
        "{error}"
    );
}

#[test]
fn images_that_are_named_after_cameras_are_of_these_whatever_their_order() {
    let by_id = infer(&IDS, &[]);
    let (rig, boxes) = (sample("rig.json"), sample("truth.json"));
    let paths = ["cam3", "cam0", "cam2", "cam1"].map(|id| sample(&format!("{id}.png")));
    let mut args = vec!["infer", "--rig", &rig, "--boxes", &boxes, "--json"];
    args.extend(paths.iter().map(String::as_str));
    let by_name: Value = serde_json::from_str(&stdout(&mvtop(&args))).unwrap();
    assert_eq!(by_name["objects"], by_id["objects"]);
}

/// A rig of eleven cameras whose images all have sizes of their own, and the images as the shell
/// sorts them: cam10 before cam2.
fn eleven(folder: &Path) -> (String, Vec<String>) {
    let mut cameras = Vec::new();
    let mut images = Vec::new();
    for number in 0..11 {
        let (id, width) = (format!("cam{number}"), 160 + 2 * number);
        cameras.push(serde_json::json!({
            "id": id, "width": width, "height": 120, "fx": 200, "fy": 200, "cx": 79.5, "cy": 59.5,
            "T_world_cam": {"t": [0.1 * f64::from(number), 0, 0], "q_wxyz": [1, 0, 0, 0]},
        }));
        let path = folder.join(format!("{id}.png"));
        image::RgbImage::new(width, 120).save(&path).unwrap();
        images.push(path.display().to_string());
    }
    let rig = serde_json::json!({
        "format": "mvtop-rig", "version": 1, "unit": "m", "reference": "cam0", "cameras": cameras,
    });
    let path = folder.join("rig.json");
    std::fs::write(&path, rig.to_string()).unwrap();
    images.sort();
    (path.display().to_string(), images)
}

#[test]
fn of_eleven_cameras_the_second_is_not_taken_for_the_tenth() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, images) = eleven(folder.path());
    assert!(images[2].ends_with("cam10.png"), "{images:?}");
    let infer = |images: &[String]| {
        let mut args = vec!["infer", "--rig", &rig, "--model", "none"];
        args.extend(images.iter().map(String::as_str));
        refusal(&mvtop(&args))
    };
    // All images have the size of their camera, so that what is refused is the model.
    let error = infer(&images);
    assert!(error.contains("model bundle none"), "{error}");
    // Of files that are named otherwise the order tells, as ever.
    let renamed: Vec<String> = images
        .iter()
        .map(|path| {
            let other = path.replace("cam", "frame");
            std::fs::copy(path, &other).unwrap();
            other
        })
        .collect();
    let error = infer(&renamed);
    assert!(
        error.contains("`cam2`: expected 164x120 px as in the rig, got 180x120"),
        "{error}"
    );
}

#[test]
fn images_only_some_of_which_are_named_after_cameras_are_refused() {
    let rig = sample("rig.json");
    let infer = |images: [&str; 4]| {
        let fixed = ["infer", "--rig", &rig, "--model", "none"];
        refusal(&mvtop(&[&fixed[..], &images].concat()))
    };
    let error = infer(["cam0.png", "x/cam1.png", "front.png", "cam3.png"]);
    assert!(
        error.contains("image `front.png`: expected a file that is named after a camera")
            && error.contains("(cam0, cam1, cam2, cam3), as `cam0.png` is")
            && error.contains("give each image as ID=PATH"),
        "{error}"
    );
    // In its own place or not.
    let error = infer(["front.png", "back.png", "cam0.png", "top.png"]);
    assert!(
        error.contains("image `front.png`") && error.contains("as `cam0.png` is"),
        "{error}"
    );
    let error = infer(["a/cam0.png", "cam1.png", "cam2.png", "b/cam0.png"]);
    assert!(
        error.contains("image `b/cam0.png`: expected one file that is named after camera `cam0`")
            && error.contains("got `a/cam0.png` as well"),
        "{error}"
    );
    let error = infer(["a.png", "b.png", "c.png", "d.png"]);
    assert!(error.contains("cannot read a.png"), "{error}");
}
