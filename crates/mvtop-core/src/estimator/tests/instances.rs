//! Candidates of an instance, duplicates in space, and projections.

use super::doubts::sphere;
use super::*;
use crate::consistency::extent;
use crate::detect::Detection;
use crate::estimator::instance::{Candidate, Instance};
use crate::estimator::pipeline::Pipeline;
use crate::estimator::view::View;
use crate::estimator::wanted::Wanted;
use crate::estimator::{nms, reprojection};
use crate::prediction::Sigma;
use crate::request::Prior;
use crate::scorer::Scored;
use crate::symmetry::Axis;
use nalgebra::Unit;

pub(super) fn candidate(world_from_obj: Isometry3<f64>, log_odds: f64) -> Candidate {
    let sigma = Sigma {
        rot_deg: 5.0,
        t_m: 0.002,
    };
    Candidate {
        world_from_obj,
        sigma,
        initial_sigma: sigma,
        prior: 1.0,
        rois: Vec::new(),
        correspondences: None,
        refinement: None,
        scored: Scored {
            log_odds,
            ..Scored::default()
        },
    }
}

fn instance(log_odds: &[f64]) -> Instance {
    let each = log_odds.iter().enumerate();
    Instance {
        class: 0,
        detections: Vec::new(),
        candidates: each
            .map(|(n, odds)| candidate(turned(30.0 * n as f64), *odds))
            .collect(),
        excluded: Vec::new(),
    }
}

fn turned(degrees: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::identity(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), degrees.to_radians()),
    )
}

fn class_with(symmetry: Symmetry) -> Class {
    Class {
        symmetry,
        ..bundle().classes.remove(0)
    }
}

fn angles(instance: &Instance) -> Vec<f64> {
    let each = instance.candidates.iter();
    each.map(|one| {
        one.world_from_obj
            .rotation
            .scaled_axis()
            .z
            .to_degrees()
            .round()
    })
    .collect()
}

#[test]
fn of_candidates_near_each_other_the_better_one_stays() {
    let class = class_with(Symmetry::default());
    let mut one = instance(&[]);
    let new = [(0.0, 1.0), (20.0, 2.0), (90.0, 0.5), (46.0, 0.0)];
    let new = new
        .map(|(degrees, odds)| candidate(turned(degrees), odds))
        .to_vec();
    one.add(new, &class, 25.0, 6);
    // 20 degrees is best; 0 is 20 away, 46 is 26.
    assert_eq!(angles(&one), [20.0, 90.0, 46.0]);
    // A better one replaces what is near it, and comes first.
    one.add(vec![candidate(turned(70.0), 3.0)], &class, 25.0, 6);
    assert_eq!(angles(&one), [70.0, 20.0]);
    // At most so many, the best.
    let new = [(-60.0, 5.0), (-90.0, 4.0), (180.0, 1.0)];
    let new = new
        .map(|(degrees, odds)| candidate(turned(degrees), odds))
        .to_vec();
    one.add(new, &class, 25.0, 3);
    assert_eq!(angles(&one), [-60.0, -90.0, 70.0]);
    // Of equally good ones the first.
    one.add(vec![candidate(turned(-55.0), 5.0)], &class, 25.0, 3);
    assert_eq!(angles(&one), [-60.0, -90.0, 70.0]);
}

#[test]
fn candidates_that_look_alike_are_one() {
    let discrete = vec![turned(90.0), turned(180.0), turned(270.0)];
    let square = class_with(Symmetry {
        discrete,
        axis: None,
    });
    let round = class_with(Symmetry {
        discrete: Vec::new(),
        axis: Some(Axis {
            direction: Unit::new_normalize(Vector3::z()),
            point: Point3::origin(),
        }),
    });
    let tilted =
        turned(120.0) * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 60f64.to_radians());
    for (class, kept) in [(square, 2), (round, 2)] {
        let mut one = instance(&[]);
        let new = vec![
            candidate(turned(5.0), 1.0),
            candidate(turned(100.0), 2.0),
            candidate(turned(-170.0), 0.0),
            candidate(tilted, 0.5),
        ];
        one.add(new, &class, 25.0, 6);
        let odds: Vec<f64> = one
            .candidates
            .iter()
            .map(|one| one.scored.log_odds)
            .collect();
        assert_eq!(odds[..], [2.0, 0.5][..kept]);
    }
}

#[test]
fn probabilities_exclude_each_other_and_leave_room_for_none_of_them() {
    let of = |log_odds: &[f64]| instance(log_odds).probabilities();
    assert_eq!(of(&[]), Vec::<f64>::new());
    assert_eq!(instance(&[]).confidence(), 0.0);
    assert_eq!(of(&[0.0]), [0.5]);
    let all = of(&[2f64.ln(), 0.0]);
    assert!(
        (all[0] - 0.5).abs() < 1e-12 && (all[1] - 0.25).abs() < 1e-12,
        "{all:?}"
    );
    // Logistic of one, whatever its size.
    for odds in [-3.0, 4.0, 30.0] {
        let expected = 1.0 / (1.0 + f64::exp(-odds));
        assert!((instance(&[odds]).confidence() - expected).abs() < 1e-12);
    }
    for log_odds in [
        &[1e4, 1e4 - 1.0, -1e4][..],
        &[-1e4, -2e4],
        &[800.0, 0.0],
        &[-800.0; 5],
        &[709.0; 6],
    ] {
        let all = of(log_odds);
        assert!(all.iter().all(|one| (0.0..=1.0).contains(one)), "{all:?}");
        assert!(all.iter().sum::<f64>() <= 1.0 + 1e-12, "{all:?}");
        assert!(all.is_sorted_by(|a, b| a >= b), "{all:?}");
        let shares: f64 = instance(log_odds)
            .hypotheses()
            .iter()
            .map(|one| one.probability)
            .sum();
        assert!((shares - 1.0).abs() < 1e-12, "{shares}");
    }
    assert_eq!(of(&[800.0, 0.0]), [1.0, 0.0]);
    // Hypotheses of negligible probability are not reported.
    assert_eq!(instance(&[5.0, 0.0]).hypotheses().len(), 1);
    assert_eq!(instance(&[5.0, 2.0]).hypotheses().len(), 2);
}

/// Objects in the true rig's views, of classes 0 and 1, both balls.
struct Scene {
    rig: Rig,
    images: Vec<ViewImage>,
    bundle: Bundle,
}

impl Scene {
    fn new() -> Self {
        let rig = rig();
        let mut bundle = bundle();
        bundle.classes[0].points = sphere();
        let mut other = bundle.classes[0].clone();
        (other.id, other.name) = (8, "other".into());
        bundle.classes.push(other);
        let images = images(&rig, &[0, 1, 2]);
        Self {
            rig,
            images,
            bundle,
        }
    }

    fn views(&self) -> Vec<View<'_>> {
        view::gather(&self.bundle, None, &self.rig, &self.images).unwrap()
    }

    /// Posed at one place, detected at another in some views.
    fn object(
        &self,
        class: usize,
        at: [f64; 3],
        boxed: [f64; 3],
        seen: [bool; 3],
        odds: f64,
    ) -> Instance {
        let boxed = Isometry3::from(boxed);
        let detection = |(seen, camera): (bool, &Camera)| {
            let bbox = extent(&self.bundle.classes[class].points, camera, &boxed).unwrap();
            let score = 0.9;
            seen.then_some(Detection { class, score, bbox })
        };
        Instance {
            class,
            detections: seen
                .into_iter()
                .zip(self.rig.cameras())
                .map(detection)
                .collect(),
            candidates: vec![candidate(Isometry3::from(at), odds)],
            excluded: Vec::new(),
        }
    }

    /// Numbers of views of the instances that remain.
    fn kept(&self, instances: Vec<Instance>) -> Vec<(usize, Vec<bool>)> {
        let config = InferenceConfig::default().search;
        let classes = &self.bundle.classes;
        let radii: Vec<_> = classes.iter().map(Class::half_widths).collect();
        let kept = nms::suppress(&config, classes, &self.views(), &radii, instances).kept;
        let seen = |one: &Instance| one.detections.iter().map(Option::is_some).collect();
        kept.iter().map(|one| (one.class, seen(one))).collect()
    }
}

const PLACE: [f64; 3] = [0.0, 0.0, 1.0];

fn beside(by: f64) -> [f64; 3] {
    [PLACE[0] + by, PLACE[1], PLACE[2]]
}

#[test]
fn things_nearer_than_half_their_size_are_one() {
    let scene = Scene::new();
    // Radii of 70 mm: 69 mm apart they are one, 71 mm apart two.
    for (class, by, count) in [(0, 0.069, 1), (0, 0.0715, 2), (1, 0.069, 1), (1, 0.0715, 2)] {
        let at = beside(by);
        let all = vec![
            scene.object(0, PLACE, PLACE, [true, true, false], 1.0),
            scene.object(class, at, at, [true, true, true], 2.0),
        ];
        let kept = scene.kept(all);
        assert_eq!(kept.len(), count, "class {class}, {by} m");
        // The better one, by its log-odds and not by its views.
        assert_eq!(kept[0], (class, vec![true; 3]));
    }
}

#[test]
fn a_duplicate_of_the_same_class_leaves_its_boxes() {
    let scene = Scene::new();
    for (class, expected) in [(0, [true, true, true]), (1, [true, true, false])] {
        let all = vec![
            scene.object(0, PLACE, PLACE, [true, true, false], 2.0),
            scene.object(class, PLACE, PLACE, [false, false, true], 1.0),
        ];
        assert_eq!(scene.kept(all), [(0, expected.to_vec())]);
    }
}

#[test]
fn boxes_that_a_better_pose_explains_are_of_the_same_thing() {
    let scene = Scene::new();
    let far = [0.5, 0.5, 2.0];
    let better = || scene.object(0, PLACE, PLACE, [true, true, false], 2.0);
    // Posed far off by its one box, which is where the better one projects.
    let kept = |class, boxed, seen| {
        let one = scene.object(class, far, boxed, seen, 1.0);
        scene.kept(vec![better(), one]).len()
    };
    assert_eq!(kept(0, PLACE, [false, false, true]), 1);
    assert_eq!(kept(0, beside(0.04), [false, false, true]), 1);
    assert_eq!(kept(0, beside(0.3), [false, false, true]), 2);
    // Another class is explained by its position alone.
    assert_eq!(kept(1, PLACE, [false, false, true]), 2);
    // A view that has a box of both shows two things.
    assert_eq!(kept(0, PLACE, [false, true, true]), 2);
}

#[test]
fn views_that_did_not_match_may_show_one_thing() {
    let scene = Scene::new();
    let one = |seen, odds| scene.object(0, PLACE, PLACE, seen, odds);
    let all = vec![
        one([true, false, false], 1.0),
        one([false, false, true], 2.0),
    ];
    assert_eq!(scene.kept(all), [(0, vec![true, false, true])]);
    // In one view they are duplicates as well.
    let all = vec![
        one([true, false, false], 1.0),
        one([true, false, false], 2.0),
    ];
    assert_eq!(scene.kept(all), [(0, vec![true, false, false])]);
}

#[test]
fn views_are_expected_to_show_what_is_inside_their_image() {
    let scene = Scene::new();
    let (class, views) = (&scene.bundle.classes[0], scene.views());
    let shown = |at: [f64; 3], least: f64| {
        reprojection::expected(class, &views, &Isometry3::from(at), least)
    };
    for (one, camera) in shown(PLACE, 0.6).iter().zip(scene.rig.cameras()) {
        let one = one.unwrap();
        assert!((one.share - 1.0).abs() < 1e-12);
        let expected = extent(&class.points, camera, &Isometry3::from(PLACE)).unwrap();
        assert_eq!(one.bbox, expected);
    }
    // Behind all cameras, and far beside.
    assert!(shown([0.0, -9.0, 1.0], 0.0).iter().all(Option::is_none));
    assert!(shown([30.0, 30.0, 1.0], 0.0).iter().all(Option::is_none));
    // Across the border of the middle camera's image, 200 px at 260 px.
    let camera = &scene.rig.cameras()[1];
    let edge = camera.intrinsics().unproject(&[-0.5, 99.5].into()).unwrap();
    let at = camera.world_from_cam() * Point3::from(edge.into_inner() * 1.5);
    let half = shown(at.coords.into(), 0.0)[1].unwrap();
    assert!((half.share - 0.5).abs() < 0.05, "{}", half.share);
    assert_eq!(half.bbox.x0, -0.5);
    assert!(shown(at.coords.into(), 0.6)[1].is_none());

    let rois = |boxes: [Option<[f64; 4]>; 2]| boxes.map(|one| one.map(BBox::from));
    let a = rois([Some([0., 0., 100., 100.]), None]);
    let same = |boxes| reprojection::same_rois(&a, &rois(boxes), 0.9);
    assert!(same([Some([0., 0., 100., 95.]), None]));
    assert!(!same([Some([0., 0., 100., 85.]), None]));
    assert!(!same([Some([0., 0., 100., 100.]); 2]));
    assert!(!same([None, None]));
}

#[test]
fn detector_speaks_for_what_it_shows_near_the_middle_of_a_projection() {
    let scene = Scene::new();
    let (views, balls) = ([0, 1, 2], &BALLS[..1]);
    let at = BALLS[0];
    // The third view's detector is too faint to count, and lies beside the middle.
    let detector = |cell: [usize; 2], score: f32| {
        let seen: [(usize, &[[f64; 3]]); 3] = [(0, balls), (1, balls), (2, &[])];
        let network = Geometry::new(&scene.rig, &seen);
        let bundle = bundle();
        let bundle = Bundle {
            classes: vec![Class {
                points: sphere(),
                ..bundle.classes[0].clone()
            }],
            ..bundle
        };
        let estimator = Estimator::new(bundle, Box::new(network));
        let (images, options) = (images(&scene.rig, &views), PredictOptions::default());
        let network = estimator.network.as_ref();
        let mut pipeline =
            Pipeline::new(&estimator, network, &scene.rig, &images, &options).unwrap();
        let tensor = view::tensor(&pipeline.views, &estimator.bundle.input).unwrap();
        let mut maps = network.detect(tensor.view()).unwrap();
        let bbox = extent(&sphere(), &scene.rig.cameras()[2], &Isometry3::from(at)).unwrap();
        let net = pipeline.views[2].letterbox.net_box(bbox);
        let middle = [net.center().y, net.center().x].map(|x| ((x + 0.5) / STRIDE as f64) as usize);
        maps.scores[(2, 0, middle[0] + cell[0], middle[1] + cell[1])] = score;
        pipeline.maps = Some(maps);
        let object = scene.object(0, at, at, [true, true, false], 0.0);
        let proposed = vec![candidate(Isometry3::from(at), 0.0)];
        let rois = object.boxes();
        let proposed = proposed.into_iter().map(|one| Candidate {
            rois: rois.clone(),
            ..one
        });
        let scored = pipeline.refine_and_score(&[&object], vec![proposed.collect()]);
        scored[0][0]
            .scored
            .views
            .iter()
            .map(|one| one.detector)
            .collect::<Vec<f64>>()
    };
    let near = |a: &[f64], b: [f64; 3]| {
        assert!(
            a.len() == 3 && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6),
            "{a:?}, {b:?}"
        );
    };
    near(&detector([0, 0], 0.2), [0.9, 0.9, 0.2]);
    near(&detector([0, 0], 0.0), [0.9, 0.9, 0.0]);
    // Two cells of 8 px on: the ball's box is 21 px of the input wide.
    near(&detector([0, 2], 0.2), [0.9, 0.9, 0.0]);
}

#[test]
fn excluded_candidates_speak_against_the_others_by_a_twentieth_of_their_odds() {
    let mut one = instance(&[2.0_f64.ln()]);
    assert!((one.confidence() - 2.0 / 3.0).abs() < 1e-12);
    one.excluded = vec![candidate(turned(180.0), 60.0_f64.ln())];
    // Odds of 2 against 1 for nothing, and 60 / 20.
    assert!((one.confidence() - 2.0 / 6.0).abs() < 1e-12);
}

#[test]
fn candidates_outside_their_prior_are_excluded_where_others_are_inside() {
    let mut bundle = bundle();
    bundle.classes.truncate(1);
    let prior = Prior::new("ball", &turned(0.0), 0.01, 10.0).unwrap();
    let options = PredictOptions {
        priors: vec![prior],
        ..PredictOptions::default()
    };
    let wanted = Wanted::new(&bundle, &options).unwrap();
    let (class, search) = (&bundle.classes[0], InferenceConfig::default().search);
    // 90 and 60 degrees from the prior, none inside: they stay.
    let mut one = instance(&[]);
    let mut new = vec![candidate(turned(90.0), 3.0), candidate(turned(60.0), 2.0)];
    wanted.narrow(&mut one, &mut new, class, &search);
    assert_eq!((new.len(), one.excluded.len()), (2, 0));
    one.add(new, class, search.merge_deg, search.max_candidates);
    // One of lower odds that is inside, 20 degrees away, and one beside it that is not.
    let mut new = vec![candidate(turned(20.0), 1.0), candidate(turned(31.0), 1.5)];
    wanted.narrow(&mut one, &mut new, class, &search);
    one.add(new, class, search.merge_deg, search.max_candidates);
    assert_eq!(angles(&one), [20.0]);
    // The best first.
    let odds: Vec<f64> = one.excluded.iter().map(|one| one.scored.log_odds).collect();
    assert_eq!(odds, [3.0, 2.0, 1.5]);
}
