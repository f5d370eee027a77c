//! Poses refined in one view alone.

use super::*;

/// The pose of a box at the origin by the first camera, from some starts beside its true pose.
///
/// - `shifts_m`: of the starts, along the image's x
fn found(shifts_m: &[f64], enough: f64) -> ByOneView {
    let refiner = Refiner::new(&cuboid(), 0.15);
    let camera = camera(0.0);
    let mut draw = Draw(5);
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(1.0));
    let image = seen(&cuboid(), &camera, &truth, &mut draw);
    let view = View {
        camera: &camera,
        image: &Pyramid::new(&image),
    };
    let right = camera.world_from_cam().rotation * Vector3::x();
    let start = |shift: &f64| Translation3::from(right * *shift) * truth;
    let starts: Vec<Isometry3<f64>> = shifts_m.iter().map(start).collect();
    let sigma = Sigma {
        rot_deg: 10.0,
        t_m: 0.02,
    };
    refiner
        .refine_in_one_view(&view, &starts, sigma, enough)
        .unwrap()
}

#[test]
fn the_start_whose_edges_fit_best_is_kept() {
    // 0.12 m are more than the box is wide: no edge is within reach.
    let (near, far) = (0.003, 0.12);
    let alone = found(&[near], 1.0);
    assert!(alone.contour_inliers > 0.7, "{alone:?}");
    assert!(alone.world_from_obj.translation.vector.norm() < 0.02);
    for starts in [[near, far], [far, near]] {
        let best = found(&starts, 1.0);
        assert_eq!(best.world_from_obj, alone.world_from_obj);
    }
}

#[test]
fn no_other_start_is_tried_once_one_has_enough() {
    let (near, far) = (0.003, 0.12);
    let first = found(&[far, near], 0.0);
    assert_eq!(first.world_from_obj, found(&[far], 0.0).world_from_obj);
    assert!(first.contour_inliers < found(&[near], 0.0).contour_inliers);
}

#[test]
fn starts_that_share_a_crop_tell_the_same() {
    // 4 mm are a twentieth of the box: the second start reads the first one's crop.
    let [own, shared] = [found(&[0.004], 1.0), found(&[-0.004, 0.004], 1.0)];
    let between = own.world_from_obj.translation.vector - shared.world_from_obj.translation.vector;
    assert!(between.norm() < 0.003, "{between}");
    let turn = own
        .world_from_obj
        .rotation
        .angle_to(&shared.world_from_obj.rotation);
    assert!(turn.to_degrees() < 0.7, "{turn}");
}
