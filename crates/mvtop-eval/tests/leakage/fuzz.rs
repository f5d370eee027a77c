//! Against a comparison of every pose with every other.

use std::collections::BTreeMap;

use mvtop_eval::bop::Model;
use mvtop_eval::leakage::{BINS, Counts, PoseRecord, Settings, Shape, Split, leakage};
use nalgebra::Point3;
use proptest::prelude::*;

use super::{WITHIN_MM, model, pose, split};

/// A box of 100 x 60 x 40 mm that is not about the origin, by its corners.
fn brick() -> Model {
    let corner = |i: usize| {
        let pick = |axis: usize, size: f64| if i >> axis & 1 == 1 { size } else { 0.0 };
        Point3::new(pick(0, 100.0) + 5.0, pick(1, 60.0) - 20.0, pick(2, 40.0))
    };
    let corners: Vec<_> = (0..8).map(corner).collect();
    model(&corners, (corners[7] - corners[0]).norm())
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
