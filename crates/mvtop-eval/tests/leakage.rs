//! Poses that recur in another split: all of them found, none invented.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use mvtop_core::mesh::Mesh;
use mvtop_eval::bop::{Model, load_models};
use mvtop_eval::leakage::{
    BINS, Counts, Files, Leakage, PoseRecord, Settings, Shape, Split, leakage,
};
use mvtop_eval::metrics::{Surface, Symmetries};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use proptest::prelude::*;
use tempfile::TempDir;

const WITHIN_MM: f64 = 0.01;

fn pose(translation_mm: [f64; 3], turn_deg: [f64; 3]) -> PoseRecord {
    let turn = Vector3::from(turn_deg.map(f64::to_radians));
    PoseRecord {
        scene: 0,
        image: 0,
        annotation: 0,
        rotation: Rotation3::new(turn).into_inner(),
        translation_mm: translation_mm.into(),
    }
}

fn split(objects: impl IntoIterator<Item = (u32, Vec<PoseRecord>)>) -> Split {
    Split {
        scenes: vec!["000000".into()],
        objects: objects.into_iter().collect(),
        ..Split::default()
    }
}

/// By rotation, up to 1 degree.
fn by_rotation(a: &Split, b: &Split) -> Leakage {
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: None,
    };
    leakage(a, b, &settings).unwrap()
}

/// An object of these points; all lengths are millimetres.
fn model(points: &[Point3<f64>], diameter: f64) -> Model {
    let points: Vec<_> = points.iter().map(|point| point * 1e-3).collect();
    Model {
        id: 1,
        name: None,
        diameter_m: diameter * 1e-3,
        symmetries: Symmetries::default(),
        surface: Surface::new(&points).unwrap(),
        path: "obj_000001.ply".into(),
        mesh: Mesh::new(points, vec![], vec![]).unwrap(),
    }
}

/// A box of 100 x 60 x 40 mm that is not about the origin, by its corners.
fn brick() -> Model {
    let corner = |i: usize| {
        let pick = |axis: usize, size: f64| if i >> axis & 1 == 1 { size } else { 0.0 };
        Point3::new(pick(0, 100.0) + 5.0, pick(1, 60.0) - 20.0, pick(2, 40.0))
    };
    let corners: Vec<_> = (0..8).map(corner).collect();
    model(&corners, (corners[7] - corners[0]).norm())
}

#[test]
fn translations_count_up_to_the_threshold_and_rotations_decide() {
    let b = split([(
        7,
        vec![
            pose([100., -50., 900.], [10., 20., 30.]),
            pose([5000., 0., 1.], [0.; 3]),
        ],
    )]);
    // (offset along x, further turn, same translation, recurs)
    let cases = [
        (0.0, 0.0, 1, 1),
        (0.0099, 0.0, 1, 1),
        (0.0101, 0.0, 0, 0),
        (0.0, 0.9, 1, 1),
        (0.0, 1.1, 1, 0),
        (0.0, 180.0, 1, 0),
    ];
    for (offset, turn, same_translation, recurring) in cases {
        let mut a = pose([100. + offset, -50., 900.], [10., 20., 30.]);
        a.rotation *= pose([0.; 3], [0., turn, 0.]).rotation;
        let found = by_rotation(&split([(7, vec![a])]), &b);
        let total = found.total();
        let expected = Counts {
            poses: 1,
            same_translation,
            recurring,
            repeated: 0,
        };
        assert_eq!(total.a, expected, "{offset} mm, {turn} deg");
        assert_eq!(
            total.b,
            Counts {
                poses: 2,
                ..expected
            }
        );
        assert_eq!(found.pairs.len() as u64, recurring);
    }
}

#[test]
fn another_object_at_the_same_place_is_no_twin() {
    let at = pose([1., 2., 3.], [0.; 3]);
    let far = pose([1., 2., 4.], [0.; 3]);
    let found = by_rotation(
        &split([(1, vec![at]), (2, vec![far]), (3, vec![at])]),
        &split([(1, vec![far]), (2, vec![at])]),
    );
    assert_eq!(found.total().a.same_translation, 0);
    let ids: Vec<_> = found
        .objects
        .iter()
        .map(|object| object.object_id)
        .collect();
    assert_eq!(ids, [1, 2, 3]);
    assert_eq!(found.total().histogram.beyond, 3);
}

#[test]
fn repeats_within_a_split_are_no_leak() {
    let there = pose([1., 2., 3.], [0.; 3]);
    let twice = [there, there, pose([9., 9., 9.], [0.; 3])];
    let found = by_rotation(
        &split([(1, twice.to_vec())]),
        &split([(1, vec![pose([50., 0., 0.], [0.; 3])])]),
    );
    let total = found.total();
    assert_eq!((total.a.repeated, total.a.recurring), (2, 0));
    assert_eq!((total.b.repeated, total.b.recurring), (0, 0));
}

#[test]
fn add_of_a_quarter_turn_and_a_shift_is_that_worked_by_hand() {
    let model = model(&[Point3::origin(), Point3::new(100., 0., 0.)], 100.);
    let model = Shape::new(&model).unwrap();
    let at = pose([0., 0., 500.], [0.; 3]);
    let turned = pose([0., 0., 500.], [0., 0., 90.]);
    // The origin stays, the other point moves by 100 √2.
    let add = model.add_mm(&at, &turned, 1e3).unwrap();
    assert!((add - 50. * 2f64.sqrt()).abs() < 1e-9, "{add}");
    assert_eq!(model.add_mm(&at, &turned, 70.7), None);
    let shifted = pose([3., 4., 500.], [0.; 3]);
    assert!((model.add_mm(&at, &shifted, 5.1).unwrap() - 5.).abs() < 1e-12);
    assert!((at.rotation_error_deg(&turned) - 90.).abs() < 1e-9);
    let slightly = pose([0., 0., 500.], [0., 7.4e-5, 0.]);
    assert!((at.rotation_error_deg(&slightly) - 7.4e-5).abs() < 1e-9);
}

#[test]
fn histogram_takes_the_nearest_of_all_poses_and_its_bins_end_at_whole_percents() {
    let model = model(&[Point3::origin(), Point3::new(100., 0., 0.)], 100.);
    let offsets = [0.0, 0.99, 1.01, 4.5, 9.99, 10.01, 300.];
    // Far apart along y, each has its own neighbour.
    let place = |i: usize, x: f64| pose([x, 1e3 * i as f64, 800.], [0.; 3]);
    let a = (0..offsets.len()).map(|i| place(i, 0.0)).collect();
    let mut b: Vec<_> = offsets
        .iter()
        .enumerate()
        .map(|(i, &x)| place(i, x))
        .collect();
    // Nearer in place than its neighbour at 4.5 mm, but turned over.
    b.push(pose([1., 3e3, 800.], [0., 0., 180.]));
    let models = BTreeMap::from([(1, model)]);
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: Some(&models),
    };
    let found = leakage(&split([(1, a)]), &split([(1, b)]), &settings).unwrap();
    let histogram = found.total().histogram;
    assert_eq!(histogram.bins, [2, 1, 0, 0, 1, 0, 0, 0, 0, 1]);
    assert_eq!(histogram.beyond, 2);
}

#[test]
fn splits_without_a_common_object_or_a_model_of_one_are_refused() {
    let of = |id| split([(id, vec![pose([0.; 3], [0.; 3])])]);
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: None,
    };
    let text = leakage(&of(1), &of(2), &settings).unwrap_err().to_string();
    assert!(text.contains("{1} and {2}"), "{text}");
    let none = BTreeMap::new();
    let settings = Settings {
        models: Some(&none),
        ..settings
    };
    let text = leakage(&of(3), &of(3), &settings).unwrap_err().to_string();
    assert!(text.contains("none of object 3"), "{text}");
    for within_mm in [0.0, -1.0, f64::NAN] {
        let settings = Settings {
            within_mm,
            ..settings
        };
        assert!(leakage(&of(3), &of(3), &settings).is_err());
    }
}

/// Poses on a lattice that is finer than the threshold, about few places and orientations: full of
/// repeats, near misses, and poses that coincide in translation alone.
fn any_poses() -> impl Strategy<Value = Vec<PoseRecord>> {
    let coordinate = (prop::sample::select(vec![-1000.0, 0.0, 899.99]), 0..4u8)
        .prop_map(|(base, step)| base + f64::from(step) * 0.006);
    let turn = prop::sample::select(vec![0.0, 0.4, 60.0, 180.0]);
    let one = (
        prop::array::uniform3(coordinate),
        prop::array::uniform3(turn),
    );
    prop::collection::vec(one.prop_map(|(t, turn)| pose(t, turn)), 0..40)
}

fn any_split() -> impl Strategy<Value = Split> {
    let mut objects = any_poses().prop_map(|poses| (1, poses)).boxed();
    objects = prop_oneof![objects, any_poses().prop_map(|poses| (2, poses))].boxed();
    // Object 1 is always there, so that two splits have one in common.
    (any_poses(), objects).prop_map(|(poses, more)| split([(1, poses), more]))
}

/// Checks what was found against a comparison of every pose with every other.
fn check(a: &Split, b: &Split, models: Option<&BTreeMap<u32, Model>>) {
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models,
    };
    let found = leakage(a, b, &settings).unwrap();
    let mut pairs = found.pairs.iter();
    for object in &found.objects {
        let id = object.object_id;
        let poses = |split: &Split| split.objects.get(&id).cloned().unwrap_or_default();
        let (in_a, in_b) = (poses(a), poses(b));
        let shape = models.map(|models| Shape::new(&models[&id]).unwrap());
        let difference = |p: &PoseRecord, q: &PoseRecord| match &shape {
            Some(shape) => 100.0 * shape.add_mm(p, q, f64::INFINITY).unwrap() / shape.diameter_mm(),
            None => p.rotation_error_deg(q),
        };
        let least =
            |differences: &mut dyn Iterator<Item = f64>| differences.fold(f64::INFINITY, f64::min);
        let twin = |p: &PoseRecord, among: &[PoseRecord], except: Option<usize>| {
            let near = among.iter().enumerate().filter(|&(i, q)| {
                except != Some(i) && (p.translation_mm - q.translation_mm).norm() <= WITHIN_MM
            });
            least(&mut near.map(|(_, q)| difference(p, q)))
        };
        let expected = |from: &[PoseRecord], to: &[PoseRecord]| {
            let twins: Vec<f64> = from.iter().map(|p| twin(p, to, None)).collect();
            let own = |(i, p)| twin(p, from, Some(i));
            Counts {
                poses: from.len() as u64,
                same_translation: twins.iter().filter(|d| d.is_finite()).count() as u64,
                recurring: twins.iter().filter(|d| **d <= 1.0).count() as u64,
                repeated: from
                    .iter()
                    .enumerate()
                    .map(own)
                    .filter(|d| *d <= 1.0)
                    .count() as u64,
            }
        };
        assert_eq!(object.a, expected(&in_a, &in_b));
        assert_eq!(object.b, expected(&in_b, &in_a));

        let mut bins = [0; BINS];
        for (i, p) in in_a.iter().enumerate() {
            let same = twin(p, &in_b, None);
            if same <= 1.0 {
                let pair = pairs.next().unwrap();
                assert_eq!((pair.object_id, pair.a, pair.difference), (id, i, same));
                let q = &in_b[pair.b];
                assert!((p.translation_mm - q.translation_mm).norm() <= WITHIN_MM);
                assert_eq!(difference(p, q), same);
            }
            let nearest = match models {
                Some(_) => least(&mut in_b.iter().map(|q| difference(p, q))),
                None => same,
            };
            if nearest <= BINS as f64 {
                bins[(nearest.ceil() as usize).max(1) - 1] += 1;
            }
        }
        assert_eq!(object.histogram.bins, bins);
        let beyond = in_a.len() as u64 - bins.iter().sum::<u64>();
        assert_eq!(object.histogram.beyond, beyond);
    }
    assert_eq!(pairs.next(), None, "none invented");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn audit_finds_what_comparing_all_with_all_finds(a in any_split(), b in any_split()) {
        check(&a, &b, None);
        check(&a, &b, Some(&BTreeMap::from([(1, brick()), (2, brick())])));
    }
}

fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

const QUARTER_TURN: &str = r#"{"3": [{"cam_R_m2c": [0,-1,0, 1,0,0, 0,0,1],
    "cam_t_m2c": [1.5, 2, 3], "obj_id": 4, "visib": {"of": [null]}}], "10": []}"#;

#[test]
fn split_scene_and_scene_of_sensors_are_read() {
    let folder = TempDir::new().unwrap();
    write(&folder.path().join("000002/scene_gt.json"), QUARTER_TURN);
    write(&folder.path().join("000002/scene_gt_info.json"), "not read");
    write(
        &folder.path().join("000007/scene_gt_cam1.json"),
        QUARTER_TURN,
    );
    write(
        &folder.path().join("000007/scene_gt_info_cam1.json"),
        "not read",
    );
    write(&folder.path().join("000009/scene_camera.json"), "not read");
    let files = Files::find(folder.path()).unwrap();
    assert_eq!(files.bytes, 2 * QUARTER_TURN.len() as u64);
    let split = files.read(|_| ()).unwrap();
    assert_eq!(split.scenes, ["000002", "000007/cam1"]);
    let expected = PoseRecord {
        scene: 0,
        image: 3,
        annotation: 0,
        rotation: Matrix3::new(0., -1., 0., 1., 0., 0., 0., 0., 1.),
        translation_mm: Vector3::new(1.5, 2., 3.),
    };
    let second = PoseRecord {
        scene: 1,
        ..expected
    };
    assert_eq!(split.objects, BTreeMap::from([(4, vec![expected, second])]));

    let scene = Files::find(&folder.path().join("000002")).unwrap();
    assert_eq!(scene.read(|_| ()).unwrap().objects[&4], [expected]);
    assert!(
        files
            .shared_with(&scene)
            .unwrap()
            .ends_with("000002/scene_gt.json")
    );
    let other = Files::find(&folder.path().join("000007")).unwrap();
    assert_eq!(scene.shared_with(&other), None);
}

#[test]
fn rotations_of_few_digits_are_made_exact() {
    let rounded = QUARTER_TURN.replace("0,-1,0, 1,0,0", "0.003,-0.998,0, 1.002,0.004,0.001");
    let folder = TempDir::new().unwrap();
    write(&folder.path().join("000000/scene_gt.json"), rounded);
    let files = Files::find(folder.path()).unwrap();
    let rotation = files.read(|_| ()).unwrap().objects[&4][0].rotation;
    let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    assert!(off < 1e-13, "{off:e}");
    let exact = Matrix3::new(0., -1., 0., 1., 0., 0., 0., 0., 1.);
    assert!((rotation - exact).amax() < 5e-3, "{rotation}");
    // No other rotation is nearer: what was taken off is symmetric.
    let read = Matrix3::new(0.003, -0.998, 0., 1.002, 0.004, 0.001, 0., 0., 1.);
    let stretch = rotation.transpose() * read;
    assert!((stretch - stretch.transpose()).amax() < 1e-12, "{stretch}");
}

#[test]
fn what_is_no_annotation_is_refused_in_one_sentence() {
    let turned_in = QUARTER_TURN.replace("0,0,1]", "0,0,-1]");
    let cases = [
        ("{", "expected {IMAGE: ["),
        ("[]", "expected {IMAGE: ["),
        (r#"{"0": [{"obj_id": 1}]}"#, "cam_R_m2c"),
        (
            &QUARTER_TURN.replace("0,0,1]", "0,0]"),
            "expected {IMAGE: [",
        ),
        (
            &QUARTER_TURN.replace("0,-1,0,", "0,-2,0,"),
            "expected a rotation",
        ),
        (&turned_in, "image 3, row 0"),
        (&QUARTER_TURN.replace("1.5", "1e99"), "millimetres"),
    ];
    for (text, expected) in cases {
        let folder = TempDir::new().unwrap();
        write(&folder.path().join("000000/scene_gt.json"), text);
        let files = Files::find(folder.path()).unwrap();
        let error = files.read(|_| ()).unwrap_err().to_string();
        let named = error.contains("000000/scene_gt.json");
        assert!(
            named && error.contains(expected) && !error.contains('\n'),
            "{error}"
        );
    }
    let empty = TempDir::new().unwrap();
    let error = Files::find(empty.path()).unwrap_err().to_string();
    assert!(error.contains("expected a split"), "{error}");
    let error = Files::find(&empty.path().join("none"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("cannot read"), "{error}");
}

const HEADER: &str = "element vertex 2\nproperty uchar red\nproperty float x\nproperty float y\n\
                      property double z\nelement face 1\nproperty list uchar int vertex_indices\n\
                      end_header\n";

#[test]
fn models_are_read_from_text_and_binary_meshes_alike() {
    let folder = TempDir::new().unwrap();
    let info = r#"{"1": {"diameter": 100, "size_x": 1}, "2": {"diameter": 100}}"#;
    write(&folder.path().join("models_info.json"), info);
    let text = format!("ply\nformat ascii 1.0\n{HEADER}255 0 0 0\n255 100 0 0\n3 0 1 1\n");
    write(&folder.path().join("obj_000001.ply"), text);
    let mut binary = format!("ply\nformat binary_little_endian 1.0\n{HEADER}").into_bytes();
    for x in [0f32, 100.] {
        binary.push(255);
        binary.extend(x.to_le_bytes());
        binary.extend(0f32.to_le_bytes());
        binary.extend(0f64.to_le_bytes());
    }
    binary.push(3);
    for vertex in [0i32, 1, 1] {
        binary.extend(vertex.to_le_bytes());
    }
    write(&folder.path().join("obj_000002.ply"), &binary);
    let models = load_models(folder.path(), |_| true).unwrap();
    let turned = pose([0.; 3], [0., 0., 90.]);
    for model in models.values() {
        let model = Shape::new(model).unwrap();
        assert_eq!(model.diameter_mm(), 100.);
        let add = model.add_mm(&pose([0.; 3], [0.; 3]), &turned, 1e3).unwrap();
        assert!((add - 50. * 2f64.sqrt()).abs() < 1e-9, "{add}");
    }

    binary.truncate(binary.len() - 1);
    let broken: [(&[u8], &str); 2] = [
        (&binary, "the end of the file"),
        (b"solid stl", "expected a PLY file"),
    ];
    for (bytes, expected) in broken {
        write(&folder.path().join("obj_000002.ply"), bytes);
        let error = load_models(folder.path(), |id| id == 2)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("obj_000002.ply") && error.contains(expected),
            "{error}"
        );
    }
    // What is not listed is not there, which the comparison says.
    let models = load_models(folder.path(), |id| id == 3).unwrap();
    let of = || split([(3, vec![pose([0.; 3], [0.; 3])])]);
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: Some(&models),
    };
    let error = leakage(&of(), &of(), &settings).unwrap_err().to_string();
    assert!(error.contains("object 3"), "{error}");
}
