use super::*;
use crate::{Intrinsics, Projection};
use image::Rgb;

fn camera() -> Camera {
    let pinhole = Intrinsics::new(500., 500., 320., 240., Projection::Pinhole).unwrap();
    Camera::new("left", [640, 480], pinhole, Isometry3::identity()).unwrap()
}

fn black() -> RgbImage {
    RgbImage::new(640, 480)
}

/// A square of 0.2 m a side, across the line of sight.
fn square() -> Mesh {
    let corners = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]];
    let vertices = corners.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
    Mesh::new(vertices, Vec::new(), vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

fn at<'a>(z: f64, shape: Shape<'a>) -> Drawn<'a> {
    Drawn {
        cam_from_obj: Isometry3::translation(0.0, 0.0, z),
        shape,
        diameter_m: 0.2,
        bbox: None,
        label: "ball".into(),
        instance: 0,
    }
}

#[test]
fn axes_start_at_the_object_and_point_along_the_image_axes() {
    let drawn = draw(&black(), &camera(), &[at(1.0, Shape::Points(&[]))]);
    assert_eq!(drawn.dimensions(), (640, 480));
    // 0.06 m at 1 m and 500 px: 30 px to the right and down.
    assert_eq!(drawn.get_pixel(345, 240), &Rgb(axes::COLORS[0]));
    assert_eq!(drawn.get_pixel(320, 265), &Rgb(axes::COLORS[1]));
    assert_eq!(drawn.get_pixel(354, 240), &Rgb([0; 3]));
}

#[test]
fn outline_of_a_mesh_has_the_color_of_its_instance() {
    let mesh = square();
    let object = |instance| Drawn {
        instance,
        ..at(1.0, Shape::Mesh(&mesh))
    };
    for instance in 0..2 * OBJECT_COLORS.len() {
        let drawn = draw(&black(), &camera(), &[object(instance)]);
        // 0.1 m at 1 m and 500 px: 50 px from the middle.
        let color = Rgb(OBJECT_COLORS[instance % OBJECT_COLORS.len()]);
        assert_eq!(drawn.get_pixel(270, 240), &color);
        assert_eq!(drawn.get_pixel(264, 240), &Rgb([0; 3]));
    }
}

#[test]
fn near_objects_cover_far_ones() {
    let mesh = square();
    let near = at(1.0, Shape::Mesh(&mesh));
    let far = Drawn {
        // Its left side is that of the near one.
        cam_from_obj: Isometry3::translation(0.0, 0.0, 1.001),
        instance: 1,
        ..near.clone()
    };
    for objects in [[near.clone(), far.clone()], [far, near]] {
        let drawn = draw(&black(), &camera(), &objects);
        assert_eq!(drawn.get_pixel(270, 250), &Rgb(OBJECT_COLORS[0]));
    }
}

#[test]
fn sizes_scale_with_the_image() {
    for (size, expected) in [
        ([640, 480], 1.0),
        ([2560, 1920], 4.0),
        ([1440, 1920], 2.25),
        ([64, 48], LEAST_UNIT),
    ] {
        assert_eq!(unit(&RgbImage::new(size[0], size[1])), expected);
    }
}

#[test]
fn labels_say_the_class_and_the_confidence_or_the_score() {
    assert_eq!(label("mug", Some(0.934), 0.5), "mug 93%");
    assert_eq!(label("mug", Some(0.9999), 0.5), "mug >99%");
    assert_eq!(label("mug", None, 0.876), "mug 0.88");
}

#[test]
fn edges_are_green_where_they_are_seen_else_red() {
    let camera = camera()
        .moved_to(Isometry3::translation(1.0, 0.0, 0.0))
        .unwrap();
    let edge = |x: f64, is_inlier| Edge {
        point: Point3::new(1.0 + x, 0.0, 1.0),
        is_inlier,
    };
    let object = DrawnEdges {
        edges: vec![edge(0.1, true), edge(-0.1, false), edge(5.0, true)],
        label: "ball".into(),
        instance: 0,
    };
    let drawn = draw_edges(&black(), &camera, &[object]);
    assert_eq!(drawn.get_pixel(370, 240), &Rgb(INLIER));
    assert_eq!(drawn.get_pixel(270, 240), &Rgb(OUTLIER));
    assert_eq!(drawn.get_pixel(320, 240), &Rgb([0; 3]));
}

#[test]
fn true_axes_are_white_and_end_in_their_color() {
    // The camera stands at x = 1 m; the object is a metre before it.
    let camera = camera()
        .moved_to(Isometry3::translation(1.0, 0.0, 0.0))
        .unwrap();
    let world_from_obj = Isometry3::translation(1.0, 0.0, 1.0);
    let drawn = draw_truth(&black(), &camera, &world_from_obj, 0.2);
    // 0.09 m at 1 m and 500 px: 45 px to the right and down.
    assert_eq!(drawn.get_pixel(365, 240), &Rgb(axes::COLORS[0]));
    assert_eq!(drawn.get_pixel(320, 285), &Rgb(axes::COLORS[1]));
    assert!(drawn.get_pixel(350, 240).0.iter().all(|&value| value > 200));
    assert_eq!(drawn.get_pixel(372, 240), &Rgb([0; 3]));
    let behind = Isometry3::translation(1.0, 0.0, -1.0);
    let untouched = draw_truth(&black(), &camera, &behind, 0.2);
    assert_eq!(untouched, black());
}

#[test]
fn wild_poses_and_tiny_images_do_not_panic() {
    let points = [Point3::new(f64::NAN, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0)];
    let mesh = square();
    for z in [0.0, 1e-9, 1e12, f64::NAN] {
        for shape in [Shape::Points(&points), Shape::Mesh(&mesh)] {
            let object = Drawn {
                cam_from_obj: Isometry3::translation(1.0, -3.0, z),
                bbox: Some([f64::NAN, -1e9, 1e9, 3.0].into()),
                ..at(z, shape)
            };
            for [width, height] in [[2, 1], [640, 480]] {
                let image = RgbImage::new(width, height);
                draw(&image, &camera(), std::slice::from_ref(&object));
            }
        }
    }
}
