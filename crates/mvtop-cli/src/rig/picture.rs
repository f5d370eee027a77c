//! A drawing of a rig from above and from the side: frustums, axes, distances.

use std::fmt::Write;

use mvtop_core::{Camera, Rig};
use nalgebra::{Point2, Point3, Vector3};

const PANEL: f64 = 560.0;
const MARGIN: f64 = 60.0;
/// Colors of x, y and z.
const AXES: [&str; 3] = ["#d62728", "#2ca02c", "#1f77b4"];
/// Up to so many cameras, every distance is written; of more, those to the reference.
const MOST_CAMERAS: usize = 5;

/// One way of looking at the rig, orthographically.
struct Panel {
    title: &'static str,
    /// World directions to the right and down in the drawing.
    right: Vector3<f64>,
    down: Vector3<f64>,
}

/// Frustum corners of a camera in the world, at a depth.
fn frustum(camera: &Camera, depth: f64) -> Vec<Point3<f64>> {
    let (w, h) = (f64::from(camera.width()), f64::from(camera.height()));
    let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
    let ray = |[u, v]: [f64; 2]| {
        camera
            .intrinsics()
            .unproject(&Point2::new(u - 0.5, v - 0.5))
    };
    let rays = corners.into_iter().filter_map(ray);
    rays.map(|ray| {
        // A fisheye's corners may look sideways: those rays are cut at their length.
        let scale = depth / ray.z.max(0.5);
        camera.world_from_cam() * Point3::from(ray.scale(scale))
    })
    .collect()
}

/// The picture, as SVG.
pub fn svg(rig: &Rig) -> String {
    let cameras = rig.cameras();
    let centers: Vec<Point3<f64>> = cameras
        .iter()
        .map(|camera| Point3::from(camera.world_from_cam().translation.vector))
        .collect();
    // The rig's own up, as its images have it; from above, the first camera looks up the page.
    let turned = |axis: Vector3<f64>| -> Vector3<f64> {
        cameras
            .iter()
            .map(|camera| camera.world_from_cam().rotation * axis)
            .sum()
    };
    let down = turned(Vector3::y())
        .try_normalize(1e-6)
        .unwrap_or_else(Vector3::y);
    let ahead = rig.reference_camera().world_from_cam().rotation * Vector3::z();
    let ahead = (ahead - down * down.dot(&ahead)).try_normalize(1e-3);
    let ahead = ahead.unwrap_or_else(|| {
        let x = Vector3::x() - down * down.x;
        x.try_normalize(1e-3)
            .unwrap_or_else(|| Vector3::z().cross(&down).normalize())
    });
    let right = down.cross(&ahead);
    let panels = [
        Panel {
            title: "from above",
            right,
            down: -ahead,
        },
        Panel {
            title: "from the side",
            right: ahead,
            down,
        },
    ];
    let spread = centers
        .iter()
        .flat_map(|a| centers.iter().map(move |b| (a - b).norm()))
        .fold(0.0, f64::max);
    let depth = if spread > 0.0 { 0.4 * spread } else { 0.3 };
    let width = 2.0 * PANEL;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{PANEL}\" viewBox=\"0 0 {width} \
         {PANEL}\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" \
         fill=\"white\"/>\n"
    );
    for (index, panel) in panels.iter().enumerate() {
        let _ = writeln!(
            out,
            "<g transform=\"translate({},0)\">",
            index as f64 * PANEL
        );
        draw(&mut out, panel, rig, &centers, depth);
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

fn draw(out: &mut String, panel: &Panel, rig: &Rig, centers: &[Point3<f64>], depth: f64) {
    let flat = |point: &Point3<f64>| {
        Point2::new(
            point.coords.dot(&panel.right),
            point.coords.dot(&panel.down),
        )
    };
    let cameras = rig.cameras();
    let frustums: Vec<_> = cameras
        .iter()
        .map(|camera| frustum(camera, depth))
        .collect();
    let all: Vec<_> = centers
        .iter()
        .chain(frustums.iter().flatten())
        .map(flat)
        .collect();
    let bound = |pick: fn(&Point2<f64>) -> f64, fold: fn(f64, f64) -> f64| {
        all.iter().map(pick).reduce(fold).unwrap_or(0.0)
    };
    let (x0, x1) = (bound(|p| p.x, f64::min), bound(|p| p.x, f64::max));
    let (y0, y1) = (bound(|p| p.y, f64::min), bound(|p| p.y, f64::max));
    let room = PANEL - 2.0 * MARGIN;
    let scale = room / (x1 - x0).max(y1 - y0).max(1e-9);
    let at = |point: &Point3<f64>| {
        let p = flat(point);
        Point2::new(
            PANEL / 2.0 + (p.x - (x0 + x1) / 2.0) * scale,
            PANEL / 2.0 + (p.y - (y0 + y1) / 2.0) * scale,
        )
    };
    let mut line = |a: Point2<f64>, b: Point2<f64>, style: &str| {
        let _ = writeln!(
            out,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" {style}/>",
            a.x, a.y, b.x, b.y
        );
    };
    let mut labels = vec![(Point2::new(12.0, 20.0), panel.title.to_owned())];
    for b in 1..cameras.len() {
        for a in 0..b {
            if cameras.len() > MOST_CAMERAS && ![a, b].contains(&rig.reference()) {
                continue;
            }
            let (from, to) = (at(&centers[a]), at(&centers[b]));
            line(from, to, "stroke=\"#bbbbbb\" stroke-dasharray=\"4 3\"");
            let metres = (centers[a] - centers[b]).norm();
            labels.push((nalgebra::center(&from, &to), format!("{metres:.3} m")));
        }
    }
    for (camera, (center, corners)) in cameras.iter().zip(centers.iter().zip(&frustums)) {
        let eye = at(center);
        for (i, corner) in corners.iter().enumerate() {
            line(eye, at(corner), "stroke=\"#555555\" stroke-width=\"0.8\"");
            line(
                at(corner),
                at(&corners[(i + 1) % corners.len()]),
                "stroke=\"#555555\" stroke-width=\"0.8\"",
            );
        }
        for (axis, color) in [Vector3::x(), Vector3::y(), Vector3::z()].iter().zip(AXES) {
            let tip = center + camera.world_from_cam().rotation * axis * depth * 0.35;
            line(
                eye,
                at(&tip),
                &format!("stroke=\"{color}\" stroke-width=\"2\""),
            );
        }
        labels.push((
            Point2::new(eye.x + 6.0, eye.y - 6.0),
            camera.id().to_owned(),
        ));
    }
    // A bar of a round length, about a quarter of the drawing.
    let length = 10f64.powf((room / 4.0 / scale).log10().floor());
    let (left, low) = (12.0, PANEL - 16.0);
    line(
        Point2::new(left, low),
        Point2::new(left + length * scale, low),
        "stroke=\"black\" stroke-width=\"2\"",
    );
    labels.push((
        Point2::new(left, low - 6.0),
        format!("{length} m; x red, y green, z (forward) blue"),
    ));
    for (at, text) in labels {
        // Ids are letters, digits and `_-.`, so nothing needs escaping.
        let _ = writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\">{text}</text>",
            at.x, at.y
        );
    }
}
