use super::*;
use crate::prediction::Hypothesis;
use nalgebra::Isometry3;
use proptest::prelude::*;

const SIGMA: Sigma = Sigma {
    rot_deg: 5.0,
    t_m: 0.005,
};

/// Log-odds 0 but for the views.
const POSE: PoseEvidence = PoseEvidence {
    prior: 1.0,
    sigma: SIGMA,
    initial_sigma: SIGMA,
    residual_px: 0.0,
    views: 1,
    object_deviation: 0.0,
    rig_deviation: 0.0,
};

fn shown(view: usize, contour: f64) -> ViewEvidence {
    ViewEvidence {
        view,
        visible: 1.0,
        detector: 0.0,
        coordinates: 0.0,
        contour,
        color: 0.0,
        mutual_information: 0.0,
        texture: 0.0,
    }
}

fn scorer(correlation: f64, bound: f64) -> Scorer {
    let weights = Weights {
        bias: 0.5,
        view_bias: -2.0,
        view: [("contour".to_owned(), 6.0)].into(),
        pose: POSE_TERMS.map(|name| (name.to_owned(), -1.5)).into(),
        bound,
        correlation,
    };
    Scorer {
        within_deg: 5.0,
        within_m: 0.005,
        refined: weights.clone(),
        unrefined: Weights {
            bias: -7.0,
            ..weights
        },
    }
}

#[test]
fn views_add_up_if_they_err_by_themselves_and_are_averaged_if_they_err_together() {
    let log_odds = |correlation: f64, views: &[ViewEvidence]| {
        scorer(correlation, 20.0)
            .score(true, views.to_vec(), POSE)
            .log_odds
            - 0.5
    };
    let each = [0.2, 0.9, 0.7].map(|contour| bounded(-2.0 + 6.0 * contour, 20.0));
    let views = [shown(0, 0.2), shown(1, 0.9), shown(2, 0.7)];
    let sum: f64 = each.iter().sum();
    assert!((log_odds(0.0, &views) - sum).abs() < 1e-12);
    assert!((log_odds(1.0, &views) - sum / 3.0).abs() < 1e-12);
    assert!((log_odds(0.5, &views) - sum / 3f64.sqrt()).abs() < 1e-12);
    // Of one view correlation says nothing, and of none there is nothing.
    for correlation in [0.0, 0.5, 1.0] {
        assert!((log_odds(correlation, &views[..1]) - each[0]).abs() < 1e-12);
        assert_eq!(log_odds(correlation, &[]), 0.0);
    }
    // What is half hidden counts half.
    let half = ViewEvidence {
        visible: 0.5,
        ..shown(0, 0.9)
    };
    assert!((log_odds(0.0, &[half]) - each[1] / 2.0).abs() < 1e-12);
}

#[test]
fn refined_and_unrefined_poses_have_weights_of_their_own() {
    let scorer = scorer(1.0, 20.0);
    let views = [shown(0, 0.5)];
    let [refined, unrefined] =
        [true, false].map(|refined| scorer.score(refined, views.to_vec(), POSE));
    assert!((refined.log_odds - unrefined.log_odds - 7.5).abs() < 1e-12);
    assert_eq!(
        (refined.terms, refined.views),
        (unrefined.terms, unrefined.views)
    );
}

#[test]
fn deviations_count_by_their_logarithm_up_to_a_bound() {
    let scorer = scorer(0.3, 20.0);
    let views = vec![shown(0, 0.5), shown(1, 0.8)];
    let log_odds = |object_deviation, rig_deviation| {
        let pose = PoseEvidence {
            object_deviation,
            rig_deviation,
            ..POSE
        };
        scorer.score(true, views.clone(), pose).log_odds
    };
    let expected = bounded(-1.5 * 4f64.ln(), 20.0) + bounded(-1.5 * 2.5f64.ln(), 20.0);
    assert!((log_odds(3.0, 1.5) - log_odds(0.0, 0.0) - expected).abs() < 1e-12);
    assert_eq!(log_odds(50.0, 0.0), log_odds(f64::INFINITY, 0.0));
}

#[test]
fn evidence_is_a_number_whatever_was_measured() {
    let pose = PoseEvidence {
        prior: 0.0,
        sigma: Sigma {
            rot_deg: 0.0,
            t_m: 0.0,
        },
        views: 0,
        object_deviation: f64::INFINITY,
        rig_deviation: 1e300,
        ..POSE
    };
    let scored = scorer(1.0, 20.0).score(true, Vec::new(), pose);
    assert!(scored.log_odds.is_finite(), "{scored:?}");
    assert!(scored.terms.iter().all(|x| x.is_finite()), "{scored:?}");
}

proptest! {
    #[test]
    fn no_view_and_no_term_outweighs_its_bound(
        bound in 0.5..30.0,
        correlation in 0.0..=1.0,
        contours in prop::collection::vec(-1e6..1e6, 1..8),
        other in -1e6..1e6,
        visible in 0.0..=1.0,
        term in prop::array::uniform2(-1e6..1e6),
    ) {
        let scorer = scorer(correlation, bound);
        let views = |first: f64| {
            let each = contours.iter().enumerate().map(|(view, contour)| shown(view, *contour));
            let mut views: Vec<ViewEvidence> = each.collect();
            views[0] = ViewEvidence { visible, ..shown(0, first) };
            views
        };
        let score = |first, residual_px| {
            let pose = PoseEvidence { residual_px, ..POSE };
            scorer.score(true, views(first), pose).log_odds
        };
        // Between both bounds.
        let by_view = score(contours[0], 0.0) - score(other, 0.0);
        prop_assert!(by_view.abs() <= 2.0 * bound + 1e-9, "{by_view}");
        let by_term = score(other, term[0]) - score(other, term[1]);
        prop_assert!(by_term.abs() <= 2.0 * bound + 1e-9, "{by_term}");
        let without = scorer.score(true, Vec::new(), POSE).log_odds;
        let most = bound * (contours.len() as f64).powf(1.0 - correlation);
        prop_assert!((score(other, 0.0) - without).abs() <= most + 1e-9);
    }

    #[test]
    fn more_of_what_speaks_for_a_pose_makes_it_no_worse(
        contours in prop::collection::vec(0.0..1.0, 1..8),
        more in 0.0..1.0,
        correlation in 0.0..=1.0,
    ) {
        let scorer = scorer(correlation, 20.0);
        let views = |first: f64| {
            let each = contours.iter().enumerate().map(|(view, contour)| shown(view, *contour));
            let mut views: Vec<ViewEvidence> = each.collect();
            views[0].contour += first;
            views
        };
        let [less, more] = [0.0, more].map(|by| scorer.score(true, views(by), POSE).log_odds);
        prop_assert!(more >= less);
    }
}

#[test]
fn impossible_scorers_are_refused() {
    fn add(weights: &mut BTreeMap<String, f64>, name: &str, weight: f64) {
        weights.insert(name.to_owned(), weight);
    }
    assert_eq!(Scorer::default().check(), Ok(()));
    type Change = fn(&mut Scorer);
    let cases: [(Change, &str); 11] = [
        (|s| add(&mut s.refined.view, "smell", 1.0), "\"smell\""),
        (|s| add(&mut s.unrefined.pose, "age", 1.0), "\"age\""),
        // Of a view, not of the pose as a whole.
        (|s| add(&mut s.refined.pose, "contour", 1.0), "\"contour\""),
        (
            |s| add(&mut s.refined.view, "color", f64::NAN),
            "weights of",
        ),
        (|s| s.refined.bias = 1e5, "weights of"),
        (|s| s.unrefined.view_bias = f64::NEG_INFINITY, "weights of"),
        (|s| s.refined.bound = 0.0, "a bound above 0"),
        (|s| s.refined.correlation = 1.1, "correlation from 0 to 1"),
        (
            |s| s.refined.correlation = f64::NAN,
            "correlation from 0 to 1",
        ),
        (|s| s.within_deg = 0.0, "bounds above 0"),
        (|s| s.within_m = f64::INFINITY, "bounds above 0"),
    ];
    for (change, part) in cases {
        let mut scorer = Scorer::default();
        change(&mut scorer);
        let problem = scorer.check().unwrap_err();
        assert!(problem.contains(part), "{problem}");
    }
    let text = serde_json::to_string(&Scorer::default()).unwrap();
    assert_eq!(
        serde_json::from_str::<Scorer>(&text).unwrap(),
        Scorer::default()
    );
    let extra = text.replacen('{', "{\"more\": 1, ", 1);
    assert!(serde_json::from_str::<Scorer>(&extra).is_err());
}

#[test]
fn verdict_asks_for_another_view_where_that_could_tell() {
    let hypothesis = |probability| Hypothesis {
        world_from_obj: Isometry3::identity(),
        sigma: SIGMA,
        probability,
    };
    let object = |confidence, first: f64, views: usize| ObjectPose {
        sigma: SIGMA,
        confidence,
        hypotheses: vec![hypothesis(first), hypothesis(1.0 - first)],
        cameras: (0..3)
            .map(|camera| crate::prediction::CameraPose {
                camera,
                cam_from_obj: Isometry3::identity(),
                bbox: (camera < views).then_some([0., 0., 9., 9.].into()),
            })
            .collect(),
        ..ObjectPose::new("ball", 1, 0.9, Isometry3::identity(), Isometry3::identity())
    };
    for (confidence, first, views, least, expected) in [
        (Some(0.8), 0.5, 1, 0.8, Verdict::Accept),
        (Some(0.7), 0.95, 2, 0.8, Verdict::Reject),
        (Some(0.7), 0.85, 2, 0.8, Verdict::Reject),
        (Some(0.7), 0.85, 2, 0.9, Verdict::NeedAnotherView),
        (Some(0.7), 0.5, 2, 0.8, Verdict::NeedAnotherView),
        (Some(0.7), 0.95, 1, 0.8, Verdict::NeedAnotherView),
        (None, 0.95, 2, 0.0, Verdict::Accept),
        (None, 0.95, 2, 0.1, Verdict::Reject),
    ] {
        assert_eq!(
            Verdict::of(&object(confidence, first, views), least),
            expected
        );
    }
}
