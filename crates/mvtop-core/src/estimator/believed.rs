//! Which of the objects that were found are there, by what the views show of them.

use super::pose::DecodedPose;
use super::sightings::Sighting;
use crate::prediction::Refinement;

/// Two objects whose origins are nearer than this share of their least half widths together are in
/// each other's place.
const APART: f64 = 0.5;

/// Without objects that the close-ups do not support, and of objects in each other's place without
/// the one that fewer views show, or that is supported less: a network that knows several classes may
/// take one thing for two.
///
/// Of objects without support (networks without object coordinates), what one view alone has found
/// in sight of another is dropped where views agree on an object: the rig is right then. Where they
/// agree on none it stays, as the rig may be what is wrong.
///
/// - `shares`: of the views that should show an object, those that do
/// - `least`: support, times that share, of an object that is kept
/// - `radii`: least and greatest half width of each class, metres
pub fn believed(
    mut found: Vec<(Sighting, DecodedPose)>,
    shares: &[f64],
    least: f64,
    radii: &[[f64; 2]],
) -> Vec<(Sighting, DecodedPose)> {
    for ((_, pose), share) in found.iter_mut().zip(shares) {
        pose.support = pose.support.map(|support| support * share);
    }
    let agreed = views_agree(&found);
    let standing = |(object, pose): &(Sighting, DecodedPose)| (object.views(), pose.support);
    let supported = |(_, pose): &(Sighting, DecodedPose)| pose.support >= Some(least);
    let gives_way = |one: &(Sighting, DecodedPose), other: &(Sighting, DecodedPose)| {
        supported(other) && together(one, other, radii) && standing(one) < standing(other)
    };
    let keeps = |(one, share): (&(Sighting, DecodedPose), &f64)| match one.1.support {
        Some(_) => supported(one) && !found.iter().any(|other| gives_way(one, other)),
        None => !agreed || *share == 1.0,
    };
    let kept: Vec<bool> = found.iter().zip(shares).map(keeps).collect();
    let pairs = found.into_iter().zip(kept);
    pairs
        .filter_map(|(one, kept)| kept.then_some(one))
        .collect()
}

/// Without objects that do not look like what is printed on them, where their refined poses put it.
///
/// - `refinements`: of each object
/// - `least`: correlation of an object that is kept; `None` keeps all
pub fn printed(
    found: Vec<(Sighting, DecodedPose)>,
    refinements: Vec<Option<Refinement>>,
    least: Option<f64>,
) -> (Vec<(Sighting, DecodedPose)>, Vec<Option<Refinement>>) {
    let print = |refinement: &Option<Refinement>| refinement.and_then(|of| of.print);
    let both = found.into_iter().zip(refinements);
    both.filter(|(_, refinement)| !differs(print(refinement), least))
        .unzip()
}

/// Whether what the views show correlates with a print by less than the least of an object.
pub fn differs(print: Option<f64>, least: Option<f64>) -> bool {
    print.zip(least).is_some_and(|(print, least)| print < least)
}

/// Of objects of a class that refinement has brought to each other's place, the one of which the
/// images show most: its boxes are the right ones.
///
/// Where views agree on no object, what different ones have found stays, however near: as the rig may
/// be what is wrong, and that they contradict each other is then what tells.
///
/// - `refinements`: of each object
/// - `radii`: least and greatest half width of each class, metres
pub fn once(
    found: Vec<(Sighting, DecodedPose)>,
    refinements: Vec<Option<Refinement>>,
    radii: &[[f64; 2]],
) -> (Vec<(Sighting, DecodedPose)>, Vec<Option<Refinement>>) {
    let supported = |index: usize| refinements[index].map(|of| of.supported);
    let agreed = views_agree(&found);
    let comparable = |a: &Sighting, b: &Sighting| {
        let mut both = a.boxes.iter().zip(&b.boxes);
        a.class == b.class && (agreed || both.any(|(a, b)| a.is_some() && b.is_some()))
    };
    let gives_way = |one: usize, other: usize| {
        let (a, b) = (&found[one], &found[other]);
        // Of two that the images show alike, the first.
        let shown_less = (supported(one), other) < (supported(other), one);
        comparable(&a.0, &b.0) && together(a, b, radii) && supported(one).is_some() && shown_less
    };
    let all = 0..found.len();
    let kept: Vec<bool> = (all.clone())
        .map(|one| {
            !all.clone()
                .any(|other| other != one && gives_way(one, other))
        })
        .collect();
    let both = found.into_iter().zip(refinements).zip(kept);
    both.filter_map(|(both, kept)| kept.then_some(both)).unzip()
}

/// Whether views agree on an object: the rig is right then.
fn views_agree(found: &[(Sighting, DecodedPose)]) -> bool {
    found.iter().any(|(object, _)| object.views() > 1)
}

/// Whether two objects are in each other's place.
fn together(
    one: &(Sighting, DecodedPose),
    other: &(Sighting, DecodedPose),
    radii: &[[f64; 2]],
) -> bool {
    let place = |(_, pose): &(Sighting, DecodedPose)| pose.world_from_obj.translation.vector;
    let reach = radii[one.0.class][0] + radii[other.0.class][0];
    (place(one) - place(other)).norm() < APART * reach
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::Sigma;
    use nalgebra::Isometry3;

    const SIGMA: Sigma = Sigma {
        rot_deg: 1.0,
        t_m: 0.01,
    };

    fn object(class: usize, x: f64, support: Option<f64>) -> (Sighting, DecodedPose) {
        let sighting = Sighting {
            class,
            score: 0.5,
            boxes: vec![None],
        };
        let pose = DecodedPose {
            world_from_obj: Isometry3::translation(x, 0.0, 1.0),
            sigma: SIGMA,
            support,
            hypotheses: Vec::new(),
        };
        (sighting, pose)
    }

    fn left(found: Vec<(Sighting, DecodedPose)>) -> Vec<(usize, f64)> {
        let radii = [[0.04, 0.08], [0.02, 0.05]];
        let shares = vec![1.0; found.len()];
        let left = believed(found, &shares, 0.3, &radii);
        let about = |(object, pose): (Sighting, DecodedPose)| {
            (object.class, pose.world_from_obj.translation.x)
        };
        left.into_iter().map(about).collect()
    }

    #[test]
    fn what_the_pictures_do_not_show_is_dropped() {
        let found = [(0.0, 0.2), (1.0, 0.3), (2.0, 0.9)];
        let found = found.map(|(x, support)| object(0, x, Some(support)));
        assert_eq!(left(found.into()), [(0, 1.0), (0, 2.0)]);
    }

    #[test]
    fn one_thing_is_one_object() {
        // 40 and 20 mm are the least half widths: 30 mm between the origins is their half.
        let beside = vec![object(0, 0.0, Some(0.5)), object(1, 0.031, Some(0.8))];
        assert_eq!(left(beside), [(0, 0.0), (1, 0.031)]);
        let within = vec![object(0, 0.0, Some(0.5)), object(1, 0.029, Some(0.8))];
        assert_eq!(left(within), [(1, 0.029)]);
        let alike = vec![object(0, 0.0, Some(0.8)), object(0, 0.03, Some(0.5))];
        assert_eq!(left(alike), [(0, 0.0)]);
        // What two views show stands above what one shows, however well.
        let mut witnessed = vec![object(0, 0.0, Some(0.5)), object(1, 0.0, Some(0.9))];
        witnessed[0].0.boxes = vec![Some([0., 0., 9., 9.].into()); 2];
        witnessed[1].0.boxes[0] = Some([0., 0., 9., 9.].into());
        assert_eq!(left(witnessed.clone()), [(0, 0.0)]);
        // But for what is no object.
        witnessed[0].1.support = Some(0.2);
        assert_eq!(left(witnessed), [(1, 0.0)]);
    }

    #[test]
    fn without_support_all_stay_that_no_view_contradicts() {
        let found = vec![object(0, 0.0, None), object(0, 0.001, None)];
        assert_eq!(left(found).len(), 2);
    }

    #[test]
    fn what_another_view_should_show_is_dropped_where_views_agree_on_something() {
        let bbox = Some([0., 0., 9., 9.].into());
        let seen = |x, boxes| {
            let (mut sighting, pose) = object(0, x, None);
            sighting.boxes = boxes;
            (sighting, pose)
        };
        let both = seen(0.0, vec![bbox; 2]);
        let (lone, hidden) = (seen(1.0, vec![bbox, None]), seen(2.0, vec![None, bbox]));
        let count = |found: &[(Sighting, DecodedPose)], shares: &[f64]| {
            believed(found.to_vec(), shares, 0.0, &[[0.04, 0.08]]).len()
        };
        let all = [both, lone, hidden];
        assert_eq!(count(&all, &[1.0, 0.5, 0.5]), 1);
        assert_eq!(count(&all, &[1.0, 0.5, 1.0]), 2, "beside the other's image");
        assert_eq!(count(&all[1..], &[0.5, 0.5]), 2, "the rig may be wrong");
    }

    #[test]
    fn objects_that_refinement_brings_together_are_one() {
        let refined = |supported: f64| {
            Some(Refinement {
                accepted: true,
                supported,
                residual_px: 0.5,
                overlap: 0.5,
                explained: 0.5,
                explained_least: 0.5,
                print: None,
                sigma_before: SIGMA,
            })
        };
        // 40 mm is the least half width of the first class, 20 mm of the second.
        let radii = [[0.04, 0.08], [0.02, 0.05]];
        // Of objects, each in some of three views: those that are left.
        let seen = |objects: &[(usize, f64, Option<Refinement>, [bool; 3])]| -> Vec<usize> {
            let found = objects.iter().enumerate();
            let found = found.map(|(index, &(class, x, _, views))| {
                let (mut sighting, pose) = object(class, x, None);
                sighting.boxes = views
                    .map(|shows| shows.then_some([0., 0., 9., 9.].into()))
                    .to_vec();
                sighting.score = index as f64;
                (sighting, pose)
            });
            let refinements = objects.iter().map(|(_, _, refinement, _)| *refinement);
            let (found, refinements) = once(found.collect(), refinements.collect(), &radii);
            assert_eq!(found.len(), refinements.len());
            found
                .iter()
                .map(|(object, _)| object.score as usize)
                .collect()
        };
        let one_view = [true, false, false];
        let left = |objects: [(usize, f64, Option<Refinement>); 2]| {
            seen(&objects.map(|(class, x, refinement)| (class, x, refinement, one_view)))
        };
        let (much, little) = (refined(0.9), refined(0.4));
        assert_eq!(left([(0, 0.0, little), (0, 0.001, much)]), [1]);
        assert_eq!(left([(0, 0.0, much), (0, 0.001, much)]), [0], "alike");
        assert_eq!(left([(0, 0.0, much), (0, 0.041, little)]), [0, 1], "apart");
        assert_eq!(
            left([(1, 0.0, much), (1, 0.021, little)]),
            [0, 1],
            "smaller"
        );
        assert_eq!(left([(0, 0.0, much), (1, 0.0, little)]), [0, 1], "unlike");
        assert_eq!(
            left([(0, 0.0, None), (0, 0.0, None)]),
            [0, 1],
            "not refined"
        );

        let elsewhere = [
            (0, 0.0, much, one_view),
            (0, 0.001, little, [false, true, false]),
        ];
        assert_eq!(seen(&elsewhere), [0, 1], "the rig may be wrong");
        let [first, second] = elsewhere;
        let agreed = [first, second, (0, 1.0, much, [true, true, false])];
        assert_eq!(seen(&agreed), [0, 2], "views agree on another");
        let twice = [
            (0, 0.0, much, [true, true, false]),
            (0, 0.001, little, [false, false, true]),
        ];
        assert_eq!(seen(&twice), [0], "they agree on one of the two");
    }

    #[test]
    fn what_does_not_look_like_its_print_is_dropped() {
        let refined = |print| Refinement {
            accepted: true,
            supported: 0.5,
            residual_px: 0.5,
            overlap: 0.5,
            explained: 0.5,
            explained_least: 0.5,
            print,
            sigma_before: SIGMA,
        };
        let found: Vec<_> = (0..4).map(|x| object(0, f64::from(x), None)).collect();
        let refinements = vec![
            Some(refined(Some(0.3))),
            Some(refined(Some(0.1))),
            Some(refined(None)),
            None,
        ];
        let left = |least| -> Vec<f64> {
            let (found, left) = printed(found.clone(), refinements.clone(), least);
            assert_eq!(found.len(), left.len());
            let place = |(_, pose): &(Sighting, DecodedPose)| pose.world_from_obj.translation.x;
            found.iter().map(place).collect()
        };
        assert_eq!(left(Some(0.2)), [0.0, 2.0, 3.0]);
        assert_eq!(left(None), [0.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn support_counts_for_the_views_that_show_it() {
        let found = vec![object(0, 0.0, Some(0.5)), object(0, 1.0, Some(0.5))];
        let left = believed(found, &[1.0, 0.5], 0.3, &[[0.04, 0.08]]);
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].1.support, Some(0.5));
    }
}
