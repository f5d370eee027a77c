//! Counts that are worked out by hand.

use std::collections::BTreeMap;

use mvtop_eval::leakage::{Counts, Leakage, Settings, Shape, Split, leakage};
use nalgebra::Point3;

use super::{WITHIN_MM, model, pose, split};

/// By rotation, up to 1 degree.
fn by_rotation(a: &Split, b: &Split) -> Leakage {
    let settings = Settings {
        within_mm: WITHIN_MM,
        limit: 1.0,
        models: None,
    };
    leakage(a, b, &settings).unwrap()
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
