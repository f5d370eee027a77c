//! Pictures of triangles and of closed surfaces.

use super::*;
use crate::mesh::Mesh;
use crate::refine::RefineConfig;
use crate::{Intrinsics, Projection};

type Triangle = [[f64; 2]; 3];

fn model(mesh: &Mesh) -> MeshModel {
    MeshModel::new(mesh, &RefineConfig::default())
}

fn pinhole(focal: f64, middle: f64, size: u32) -> Camera {
    let pinhole = Intrinsics::new(focal, focal, middle, middle, Projection::Pinhole);
    Camera::new("a", [size; 2], pinhole.unwrap(), Isometry3::identity()).unwrap()
}

/// Labels of a square picture of 8 px that shows triangles, one color each, whose corners lie at
/// these pixels, so far away.
fn drawn(triangles: &[(Triangle, f64)]) -> Vec<String> {
    let camera = pinhole(1.0, 0.0, 8);
    let (mut vertices, mut colors, mut indices) = (Vec::new(), Vec::new(), Vec::new());
    for (i, (corners, z)) in (0..).zip(triangles) {
        vertices.extend(corners.map(|[u, v]| Point3::new(u * z, v * z, *z)));
        colors.extend([[100 * i as u8; 3]; 3]);
        indices.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let mesh = Mesh::new(vertices, colors, indices).unwrap();
    let mut raster = Raster::default();
    assert!(raster.render(&model(&mesh), &camera, &Isometry3::identity()));
    let row = |row: &[u8]| row.iter().map(u8::to_string).collect();
    raster.labels().chunks(8).map(row).collect()
}

#[test]
fn triangle_covers_the_pixels_within_it() {
    let corners = [[1.0, 1.0], [7.5, 1.0], [1.0, 4.25]];
    let mut expected = ["00000000"; 8];
    expected[1..5].copy_from_slice(&["01111111", "01111100", "01110000", "01000000"]);
    let [a, b, c] = corners;
    for corners in [[a, b, c], [a, c, b], [c, b, a]] {
        assert_eq!(drawn(&[(corners, 2.0)]), expected, "{corners:?}");
    }
}

#[test]
fn triangle_beyond_the_picture_covers_what_it_reaches_of_it() {
    let all = [[-100.0, -100.0], [300.0, -100.0], [-100.0, 300.0]];
    assert_eq!(drawn(&[(all, 1.0)]), ["11111111"; 8]);
    for [right, down] in [[-30.0, 0.0], [30.0, 0.0], [0.0, -30.0], [0.0, 30.0]] {
        let beside = all.map(|[u, v]| [u / 100.0 + right, v / 100.0 + down]);
        assert_eq!(drawn(&[(beside, 1.0)]), ["00000000"; 8]);
    }
    // Its lower side is the picture's first row, to within a hair.
    let above = [[-0.5, -3.0], [7.5, -3.0], [3.5, -1e-9]];
    assert_eq!(drawn(&[(above, 1.0)]), ["00000000"; 8]);
}

#[test]
fn nearest_triangle_is_shown() {
    let upper = [[-100.0, 4.5], [100.0, 4.5], [0.0, -300.0]];
    let lower = [[-100.0, 2.5], [100.0, 2.5], [0.0, 300.0]];
    for (z, shown) in [(1.0, "11111111"), (3.0, "22222222")] {
        let rows = drawn(&[(upper, z), (lower, 2.0)]);
        assert_eq!([&rows[0], &rows[7]], ["11111111", "22222222"]);
        assert_eq!(rows[3], shown, "{z}");
    }
}

#[test]
fn backs_of_closed_surfaces_are_not_drawn_and_the_picture_is_the_same() {
    let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|x| x as f64 - 0.5);
    let corners: Vec<Point3<f64>> = (0..8).map(|i| corner(i).into()).collect();
    // Counterclockwise as seen from outside, two for each side.
    let sides = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let cube: Vec<[u32; 3]> = sides
        .iter()
        .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
        .collect();
    let part = |triangles: &[[u32; 3]]| {
        let colors = (0..8)
            .map(|i| [0, 100, 200][i % 3])
            .map(|x| [x; 3])
            .collect();
        model(&Mesh::new(corners.clone(), colors, triangles.to_vec()).unwrap())
    };
    let closed = part(&cube);
    assert!(closed.closed);
    assert!(!part(&cube[1..]).closed, "with a hole");
    let inwards: Vec<[u32; 3]> = cube.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    assert!(!part(&inwards).closed, "inside out");
    let mut one = cube.clone();
    one[5] = inwards[5];
    assert!(!part(&one).closed, "one is turned");

    let open = MeshModel {
        closed: false,
        ..part(&cube)
    };
    let camera = pinhole(60.0, 31.5, 64);
    for turn in 0..40 {
        let turn = f64::from(turn);
        let axis = nalgebra::Vector3::new(turn.sin(), (2.0 * turn).cos(), 0.3) * turn;
        let pose = Isometry3::new(nalgebra::Vector3::new(0.1, -0.2, 2.5), axis);
        let drawn = |part: &MeshModel| {
            let mut raster = Raster::default();
            assert!(raster.render(part, &camera, &pose));
            raster
        };
        let (one, other) = (drawn(&closed), drawn(&open));
        let differ = one.labels.iter().zip(&other.labels).filter(|(a, b)| a != b);
        // A pixel whose center lies on an edge may show either side.
        assert!(differ.count() <= 3);
        let shown = one.labels.iter().filter(|label| **label != BACKGROUND);
        assert!(shown.count() > 300);
    }
}

#[test]
fn hidden_backs_change_nothing() {
    let mesh = crate::refine::tests::ball();
    let closed = model(&mesh);
    let count = closed.labels.len();
    let open = |labels: Vec<u8>| MeshModel {
        closed: false,
        labels,
        ..model(&mesh)
    };
    // The second one is drawn in the order of its triangles, as its labels differ.
    let each = (0..count).map(|i| 1 + (i % 2) as u8).collect();
    let (one, other) = (open(vec![1; count]), open(each));
    let camera = pinhole(300.0, 99.5, 200);
    let mut raster = [Raster::default(), Raster::default()];
    for turn in 0..20 {
        let turn = f64::from(turn);
        let axis = nalgebra::Vector3::new(turn.sin(), (2.0 * turn).cos(), 0.3) * turn;
        let at = nalgebra::Vector3::new(0.02 * turn.sin(), 0.1 * turn.cos(), 0.3);
        let pose = Isometry3::new(at, axis);
        for (raster, part) in raster.iter_mut().zip([&one, &other]) {
            assert!(raster.render(part, &camera, &pose));
        }
        let [one, other] = &raster;
        assert_eq!(one.nearness, other.nearness);
        let shown = |raster: &Raster| raster.labels().iter().map(|label| *label > 0).collect();
        let (one, other): (Vec<bool>, Vec<bool>) = (shown(one), shown(other));
        assert!(one == other && one.contains(&true));
    }
}
