//! Texture correlation, and alignment of round parts.

use super::*;
use crate::bundle::SurfacePoint;

/// The can, with squares of four colors around it.
pub(super) fn printed(colors: [[u8; 3]; 4], draw: &mut Draw) -> Mesh {
    let plain = can();
    let lids = plain.triangles()[2 * 72..].to_vec();
    let lids = Mesh::new(plain.vertices().to_vec(), plain.colors().to_vec(), lids).unwrap();
    let mut parts = vec![lids];
    let (rows, columns) = (8, 24);
    for row in 0..rows {
        for column in 0..columns {
            let color = colors[(draw.number() * 4.0) as usize];
            parts.push(surface(1, 3, color, |u, v| {
                let turn = (f64::from(column) + v) / f64::from(columns) * std::f64::consts::TAU;
                let z = 0.1 * (f64::from(row) + u) / f64::from(rows) - 0.05;
                Point3::new(0.033 * turn.cos(), 0.033 * turn.sin(), z)
            }));
        }
    }
    united(&parts)
}

/// The middle of each triangle.
pub(super) fn points(mesh: &Mesh) -> Vec<SurfacePoint> {
    let middle = |triangle: &[u32; 3]| {
        let corners = triangle.map(|v| mesh.vertices()[v as usize].coords);
        SurfacePoint {
            position: ((corners[0] + corners[1] + corners[2]) / 3.0).into(),
            color: mesh.colors()[triangle[0] as usize],
        }
    };
    mesh.triangles().iter().map(middle).collect()
}

#[test]
fn texture_aligns_a_round_part() {
    let mut draw = Draw(6);
    let colors = [[170, 20, 25], [200, 195, 190], [180, 150, 60], [60, 50, 50]];
    let mesh = printed(colors, &mut draw);
    let refiner = Refiner::new(&mesh, 0.12).with_texture(&points(&mesh));
    let cameras = [0.0, 70.0].map(camera);
    let mut near = 0;
    for _ in 0..40 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let images = [0, 1].map(|view| seen(&mesh, &cameras[view], &truth, &mut draw));
        let pyramids = images.each_ref().map(Pyramid::new);
        let views = views_of(&cameras, &pyramids);
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let off = about(Vector3::z_axis(), 0.2) * about(Vector3::x_axis(), 0.08);
        let sigma = Sigma {
            rot_deg: 12.0,
            t_m: 0.01,
        };
        let found = refiner.refine(&views, &(truth * off), sigma).unwrap();
        let left = rotation_error_deg(&found.world_from_obj.rotation, &truth.rotation);
        near += u32::from(found.accepted && left < 1.0);
        // The angle is known, unlike that of a plain can, where it is right and nowhere else.
        assert_eq!(found.sigma.rot_deg < 5.0, left < 1.5, "{left} {found:?}");
    }
    assert!(near >= 38, "{near} of 40 within a degree");
}

#[test]
fn plain_parts_have_no_texture_and_only_round_ones_an_axis() {
    let mut draw = Draw(7);
    // Whether there is a texture, and whether the part is round.
    let print = |mesh: &Mesh, diameter: f64| {
        let refiner = Refiner::new(mesh, diameter).with_texture(&points(mesh));
        refiner.texture.map(|texture| texture.is_round())
    };
    let colors = [[170, 20, 25], [200, 195, 190], [180, 150, 60], [60, 50, 50]];
    assert_eq!(print(&printed(colors, &mut draw), 0.12), Some(true));
    assert_eq!(print(&printed([[90, 120, 170]; 4], &mut draw), 0.12), None);
    assert_eq!(print(&can(), 0.12), None);
    // Round about every axis but for its knobs, and these tell its turn.
    assert_eq!(print(&ball(), 0.13), Some(false));
    assert_eq!(print(&box_of_colors(colors), 0.15), Some(false));
}

#[test]
fn texture_correlates_with_its_own_object_alone() {
    let mut draw = Draw(8);
    let colors = [[170, 20, 25], [200, 195, 190], [180, 150, 60], [60, 50, 50]];
    let (known, other) = (printed(colors, &mut draw), printed(colors, &mut draw));
    let refiner = Refiner::new(&known, 0.12).with_texture(&points(&known));
    let cameras = [0.0, 70.0].map(camera);
    for _ in 0..10 {
        let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
        let mut alike = |mesh: &Mesh| {
            let images = [0, 1].map(|view| seen(mesh, &cameras[view], &truth, &mut draw));
            let pyramids = images.each_ref().map(Pyramid::new);
            let views = views_of(&cameras, &pyramids);
            refiner
                .quality(&views, &truth)
                .unwrap()
                .texture_correlation()
                .unwrap()
        };
        let (same, unlike) = (alike(&known), alike(&other));
        assert!(same > unlike + 0.2, "{same} and {unlike}");
    }
}

/// The cuboid, its sides in turn of four colors.
pub(super) fn box_of_colors(colors: [[u8; 3]; 4]) -> Mesh {
    let sides = cuboid();
    let each = (0..sides.colors().len()).map(|corner| colors[(corner + 1) / 4 % 4]);
    Mesh::new(
        sides.vertices().to_vec(),
        each.collect(),
        sides.triangles().to_vec(),
    )
    .unwrap()
}
