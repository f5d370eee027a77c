//! The Gauss-Newton step and the observable subspace, worked by hand.

use nalgebra::Matrix6;

use super::edge_search::EdgeMatch;
use super::*;

/// Lines of a view that each measure one of the six motions.
///
/// - `lines`: index of the motion, and displacement of the line
fn residuals(lines: &[(usize, f64)]) -> Vec<Residual> {
    let one = |&(index, displacement): &(usize, f64)| Residual {
        jacobian: Vector6::ith(index, 1000.0),
        edge: EdgeMatch {
            displacement,
            variance: 1.0,
        },
    };
    lines.iter().map(one).collect()
}

#[test]
fn unobservable_directions_are_projected_out() {
    // A diameter of 4 m makes the lever 1 m, so that the projector is orthogonal.
    let refiner = Refiner::new(&cuboid(), 4.0);
    // 0.002 of the largest eigenvalue is 2: motions 1 and 5 lie below.
    let information = Vector6::new(1000.0, 1.9, 2.1, 500.0, 10.0, 0.0);
    let projector = refiner.observable_projector(&Matrix6::from_diagonal(&information));
    let expected = Matrix6::from_diagonal(&Vector6::new(1.0, 0.0, 1.0, 1.0, 1.0, 0.0));
    assert!((projector.unwrap() - expected).abs().max() < 1e-9);
    let nan = Matrix6::repeat(f64::NAN);
    assert!(refiner.observable_projector(&nan).is_none());
}

#[test]
fn step_is_the_mean_of_lines_and_prior_by_their_information() {
    let refiner = Refiner::new(&cuboid(), 4.0);
    let sigma = Sigma {
        rot_deg: 10.0,
        t_m: 0.001,
    };
    let prior = Prior::new(Isometry3::identity(), sigma);
    // Eight lines of variance 1 that move by 1000 px per metre, four of which count as one: 2e6. The
    // prior has 1 / 0.001^2 = 1e6. So two thirds of 0.3 px are 0.2 mm. Displacements far below the
    // robust scale keep their weight: (1 + (0.1 / 2.5)^2)^-2 = 0.997.
    let lines = residuals(&[(3, 0.3); 8]);
    let found = refiner
        .gauss_newton(&[&lines], &prior, &Isometry3::identity(), 1.0)
        .unwrap();
    assert!((found.motion[3] - 0.0002).abs() < 2e-6, "{}", found.motion);
    let moved = found.world_from_obj.translation.vector;
    assert!((moved - Vector3::x() * 0.0002).norm() < 2e-6);
    // A quarter of the lines' information, and the prior's.
    let information = found.information[(3, 3)];
    assert!((information / 1.5e6 - 1.0).abs() < 0.01, "{information}");
    assert_eq!(found.information[(4, 4)], 1e6);
    assert!((found.moved_px - 0.2).abs() < 2e-3, "{}", found.moved_px);
}

#[test]
fn outliers_and_views_that_contradict_the_others_lose_their_weight() {
    let refiner = Refiner::new(&cuboid(), 4.0);
    let sigma = Sigma {
        rot_deg: 10.0,
        t_m: 1.0,
    };
    let prior = Prior::new(Isometry3::identity(), sigma);
    let step = |views: &[&[Residual]]| {
        let found = refiner.gauss_newton(views, &prior, &Isometry3::identity(), 1.0);
        found.unwrap().motion[3] * 1000.0
    };
    let (most, few) = (residuals(&[(3, 0.5); 40]), residuals(&[(3, 8.0); 10]));
    // The mean of all lines would be 2 px.
    let together = [&most[..], &few[..]].concat();
    let by_lines = step(&[&together]);
    let by_views = step(&[&most, &few]);
    assert!((by_lines - 0.5).abs() < 0.3, "{by_lines}");
    assert!(
        (by_views - 0.5).abs() < (by_lines - 0.5).abs(),
        "{by_views}"
    );
}
