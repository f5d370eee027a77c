use mvtop_geometry::{Camera, Error, Intrinsics, Projection, Rig};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use serde_json::json;

use super::examples::{lenses, pinhole};

fn at(id: &str, x: f64) -> Camera {
    let pose = Isometry3::translation(x, 0.0, 0.0);
    Camera::new(id, [640, 480], pinhole(500.0, 320.0, 240.0), pose).unwrap()
}

fn rig(ids: &[&str]) -> Vec<Camera> {
    let places = (0..).map(f64::from);
    ids.iter().zip(places).map(|(id, x)| at(id, x)).collect()
}

/// The sentence of numbers must be that of the same numbers in a file, but for what precedes it.
fn assert_like_the_file(error: &Error, camera: serde_json::Value) {
    let file = json!({"format": "mvtop-rig", "version": 1, "unit": "m", "cameras": [camera]});
    let by_file = Rig::from_json(&file.to_string()).unwrap_err().to_string();
    assert!(
        by_file.ends_with(&error.to_string()),
        "`{by_file}` does not end in `{error}`"
    );
    assert!(matches!(error, Error::Camera(_)), "{error:?}");
}

#[test]
fn cameras_refuse_what_files_may_not_say() {
    // The change of a good camera, and what is said of it.
    for (key, number, fact) in [
        (
            "width",
            0.0,
            "camera `left`: `width` must be a whole number of pixels from 1 to 20000, got 0",
        ),
        (
            "height",
            20001.0,
            "camera `left`: `height` must be a whole number of pixels from 1 to 20000, got 20001",
        ),
        (
            "fx",
            6.3,
            "camera `left`: the focal length `fx` of 6.3 px is too short for an image of 640 px",
        ),
        (
            "fy",
            4.7,
            "camera `left`: the focal length `fy` of 4.7 px is too short for an image of 480 px",
        ),
        (
            "cx",
            -640.5,
            "camera `left`: the principal point `cx` of -640.5 px lies more than one image size outside",
        ),
        (
            "cy",
            960.5,
            "camera `left`: the principal point `cy` of 960.5 px lies more than one image size outside",
        ),
        ("fx", 0.0, "the focal length `fx` must be above 0 px, got 0"),
        (
            "fy",
            -500.0,
            "the focal length `fy` must be above 0 px, got -500",
        ),
    ] {
        let mut camera = json!({
            "id": "left", "width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240,
            "T_world_cam": {"t": [0, 0, 0], "q_wxyz": [1, 0, 0, 0]},
        });
        camera[key] = match key {
            "width" | "height" => json!(number as u32),
            _ => json!(number),
        };
        let n = |key: &str| camera[key].as_f64().unwrap();
        let error = Intrinsics::new(n("fx"), n("fy"), n("cx"), n("cy"), Projection::Pinhole)
            .and_then(|intrinsics| {
                let size = [n("width") as u32, n("height") as u32];
                Camera::new("left", size, intrinsics, Isometry3::identity())
            })
            .unwrap_err();
        assert!(error.to_string().starts_with(fact), "{error}");
        assert_like_the_file(&error, camera);
    }
    for bad in [f64::NAN, f64::INFINITY] {
        for i in 0..4 {
            let mut numbers = [500.0, 500.0, 320.0, 240.0];
            numbers[i] = bad;
            let [fx, fy, cx, cy] = numbers;
            let error = Intrinsics::new(fx, fy, cx, cy, Projection::Pinhole).unwrap_err();
            let key = ["fx", "fy", "cx", "cy"][i];
            assert_eq!(
                error.to_string(),
                format!("`{key}` must be a finite number, got {bad}")
            );
        }
    }
}

#[test]
fn ids_must_be_part_of_a_file_name() {
    let named = |id: &str| {
        let pose = Isometry3::identity();
        Camera::new(id, [640, 480], pinhole(500.0, 320.0, 240.0), pose)
    };
    let long = "x".repeat(101);
    for (id, fact) in [
        ("", "the id \"\" is empty"),
        (
            "cam1/000012",
            "the id \"cam1/000012\" cannot be part of a file name",
        ),
        ("..", "the id \"..\" cannot be part of a file name"),
        ("-left", "cannot be part of a file name"),
        (long.as_str(), "is longer than 100 bytes"),
    ] {
        let error = named(id).unwrap_err();
        assert!(error.to_string().contains(fact), "{error}");
        assert!(matches!(error, Error::Camera(_)), "{error:?}");
    }
    for id in ["cam1_000012", "000012", "links-vorn.2", "_", "Kamera_ä"] {
        assert_eq!(named(id).unwrap().id(), id);
    }
}

#[test]
fn poses_must_be_rigid_and_finite() {
    let camera = at("left", 0.0);
    let turned = |w: f64| UnitQuaternion::new_unchecked(Quaternion::new(w, 0.0, 0.0, 0.0));
    for (translation, rotation, fact) in [
        ([f64::NAN, 0.0, 0.0], turned(1.0), "must be finite, got NaN"),
        ([0.0; 3], turned(f64::INFINITY), "must be finite, got inf"),
        ([0.0; 3], turned(1.1), "must have the norm 1, got 1.1000"),
        ([0.0, 1e8, 0.0], turned(1.0), "of 1.0e8 m is not credible"),
    ] {
        let pose = Isometry3::from_parts(Vector3::from(translation).into(), rotation);
        let error = camera.moved_to(pose).unwrap_err().to_string();
        assert!(
            error.starts_with("camera `left`: its pose: ") && error.contains(fact),
            "{error}"
        );
    }
    let place = Isometry3::translation(1.0, 2.0, 3.0);
    assert_eq!(*camera.moved_to(place).unwrap().world_from_cam(), place);
}

#[test]
fn rigs_refuse_what_is_no_rig() {
    let many: Vec<String> = (0..1001).map(|i| i.to_string()).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    for (ids, reference, fact) in [
        (&[][..], 0, "`cameras` must list 1 to 1000 cameras, got 0"),
        (&many, 0, "`cameras` must list 1 to 1000 cameras, got 1001"),
        (
            &["a", "b", "a"],
            0,
            "two cameras have the id `a`; ids must differ",
        ),
        (
            &["a", "b"],
            9,
            "the reference must be the index of one of the 2 cameras, got 9",
        ),
        (
            &["a"],
            1,
            "the reference must be the index of one of the 1 cameras, got 1",
        ),
    ] {
        let error = Rig::new(rig(ids), reference).unwrap_err();
        assert_eq!(error.to_string(), format!("rig: {fact}"));
        assert!(matches!(error, Error::Rig { .. }), "{error:?}");
    }
    let rig = Rig::new(rig(&["a", "b"]), 1).unwrap();
    assert_eq!((rig.reference(), rig.reference_camera().id()), (1, "b"));
    assert_eq!((rig.index_of("b"), rig.index_of("c")), (Some(1), None));
}

#[test]
fn a_wrong_unit_is_found_in_numbers_as_in_files() {
    let apart = |x: f64| Rig::new(vec![at("a", 0.0), at("b", x)], 0).unwrap();
    for (x, fact) in [
        (
            800.0,
            "`a` and `b`, are 800.0000 m apart, expected 0.002 to 100 m; the unit looks like mm, so convert \
             it to m, or set `trust_unit` to true",
        ),
        (
            0.0008,
            "are 0.0008 m apart, expected 0.002 to 100 m; check the translations, or set `trust_unit`",
        ),
    ] {
        let error = apart(x).check_spread().unwrap_err().to_string();
        assert!(error.contains(fact), "{error}");
    }
    apart(0.4).check_spread().unwrap();
    // A file says that it is meant so.
    let far = apart(800.0).to_json();
    assert_eq!(Rig::from_json(&far).unwrap(), apart(800.0));
    for (from, to, fact) in [
        (
            "\"trust_unit\": true",
            "\"trust_unit\": false",
            "set `unit` to \"mm\"",
        ),
        (
            "\"trust_unit\": true",
            "\"trust_unit\": 1",
            "`trust_unit` must be true or false, got 1",
        ),
    ] {
        assert!(far.contains(from));
        let error = Rig::from_json(&far.replace(from, to))
            .unwrap_err()
            .to_string();
        assert!(error.contains(fact), "{error}");
    }
    assert!(!apart(0.4).to_json().contains("trust_unit"));
}

#[test]
fn no_distortion_is_a_pinhole_whoever_builds_it() {
    use mvtop_geometry::camera::{BrownConrady, ProjectionModel};
    for zeros in [0, 4, 5, 8, 12, 14] {
        let params = vec![0.0; zeros];
        let by_name = Projection::from_params("pinhole", Some("brown_conrady"), &params);
        let by_family = Projection::from_params("pinhole", None, &params);
        assert_eq!(by_name.unwrap(), Projection::Pinhole);
        assert_eq!(by_family.unwrap(), Projection::Pinhole);
        let by_hand = Projection::BrownConrady(BrownConrady::new(&params).unwrap());
        let intrinsics = Intrinsics::new(500.0, 500.0, 320.0, 240.0, by_hand).unwrap();
        assert!(intrinsics.is_pinhole());
    }
    // A fisheye without coefficients is still none.
    let fisheye = Projection::from_params("fisheye", None, &[0.0; 4]).unwrap();
    assert_eq!(
        (fisheye.family(), fisheye.params()),
        ("fisheye", &[0.0; 4][..])
    );
}

#[test]
fn projections_of_unknown_names_are_refused() {
    for (family, distortion, params, fact) in [
        (
            "omni",
            None,
            &[][..],
            "`model` must be \"pinhole\" or \"fisheye\", got \"omni\"",
        ),
        (
            "pinhole",
            Some("radtan"),
            &[],
            "must be \"brown_conrady\" or \"kannala_brandt\", got \"radtan\"",
        ),
        (
            "pinhole",
            Some("kannala_brandt"),
            &[0.1; 4],
            "kannala_brandt needs `model` \"fisheye\", got \"pinhole\"",
        ),
        (
            "fisheye",
            Some("kannala_brandt"),
            &[],
            "kannala_brandt takes 4 coefficients (k1 k2 k3 k4), got 0",
        ),
        (
            "pinhole",
            None,
            &[0.1; 3],
            "brown_conrady takes 0, 4, 5, 8, 12 or 14 coefficients (k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty), got 3",
        ),
        (
            "fisheye",
            None,
            &[0.1, f64::NAN, 0.0, 0.0],
            "kannala_brandt coefficients must be finite, got NaN",
        ),
    ] {
        let error = Projection::from_params(family, distortion, params).unwrap_err();
        assert!(error.to_string().contains(fact), "{error}");
    }
}

proptest! {
    /// Whatever cameras can be built, the rig's text is read back as the same rig.
    #[test]
    fn every_rig_survives_writing(
        cameras in prop::collection::vec(
            (
                0..lenses().len(),
                prop::array::uniform4(any::<f64>()),
                [1..=20_000u32, 1..=20_000u32],
                prop::array::uniform3(prop_oneof![-3.0..3.0, -1e7..1e7f64, Just(0.0), any::<f64>()]),
                prop::array::uniform3(-4.0..4.0f64),
            ),
            1..5,
        ),
        reference in any::<prop::sample::Index>(),
        scale in 0.01..40.0f64,
    ) {
        let mut built = Vec::new();
        for (i, (lens, numbers, size, t, axis)) in cameras.into_iter().enumerate() {
            let lens = &lenses()[lens];
            let pose = Isometry3::new(Vector3::from(t), Vector3::from(axis));
            let [fx, fy, cx, cy] = numbers;
            let usual = [lens.fx(), lens.fy(), lens.cx(), lens.cy()].map(|x| x * scale);
            for [fx, fy, cx, cy] in [[fx, fy, cx, cy], usual] {
                let camera = Intrinsics::new(fx, fy, cx, cy, lens.projection().clone())
                    .and_then(|lens| Camera::new(format!("cam{i}"), size, lens, pose));
                // A rig asks for more than a camera: that it sees something.
                let sees = |camera: &Camera| Rig::new(vec![camera.clone()], 0).is_ok();
                if let Some(camera) = camera.ok().filter(sees) {
                    built.push(camera);
                    break;
                }
            }
        }
        prop_assume!(!built.is_empty());
        let reference = reference.index(built.len());
        super::rigs::assert_survives_writing(&Rig::new(built, reference).unwrap());
    }
}

#[test]
fn rigs_of_more_pixels_than_memory_holds_are_refused() {
    let camera = |id: &str| {
        let intrinsics = Intrinsics::new(9e3, 9e3, 8e3, 8e3, Projection::Pinhole).unwrap();
        Camera::new(id, [16_384; 2], intrinsics, Isometry3::identity()).unwrap()
    };
    let rig = |count: usize| Rig::new((0..count).map(|i| camera(&i.to_string())).collect(), 0);
    assert!(rig(4).is_ok());
    let error = rig(5).unwrap_err().to_string();
    assert!(
        error.contains("1073 million pixels together at most, got 1342"),
        "{error}"
    );
}
