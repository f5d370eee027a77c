//! Pictures of a prediction: each object's points and axes through the camera's true lens.

mod canvas;

use image::RgbImage;
use image::imageops::{FilterType, replace, resize};
use nalgebra::{Isometry3, Point2, Point3, Vector3};

use self::canvas::{Canvas, Color};
use crate::bundle::Class;
use crate::image::ViewImage;
use crate::prediction::{ObjectPose, Prediction};
use crate::refine::Edge;
use crate::{BBox, Camera, Estimator, Rig};

/// One color per object, in turn; none of them is one of the axes'.
const OBJECT_COLORS: [Color; 4] = [[0, 229, 255], [255, 64, 208], [255, 196, 0], [178, 255, 89]];
/// x, y and z.
const AXIS_COLORS: [Color; 3] = [[255, 40, 40], [40, 220, 40], [60, 110, 255]];
/// Colors of contour points with and without an edge in the image.
const INLIER: Color = [40, 220, 40];
const OUTLIER: Color = [255, 40, 40];
/// Straight lines of the scene are drawn in this many pieces, for lenses bend them.
const AXIS_PIECES: usize = 16;
/// As many of an object's points are drawn at most, evenly chosen.
const MAX_POINTS: usize = 1500;
/// Sizes are made for images of this height, px.
const NOMINAL_HEIGHT: f64 = 480.0;
/// Height of the views in a contact sheet, and the gap between them, px.
const SHEET_HEIGHT: u32 = 480;
const SHEET_GAP: u32 = 6;

/// An object to draw.
#[derive(Debug, Clone)]
pub struct Drawn<'a> {
    /// Object frame to camera frame, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// On the object's surface, in its frame, metres.
    pub points: &'a [Point3<f64>],
    /// The object's diameter, metres; the axes are a little longer than its radius.
    pub diameter_m: f64,
    /// In the camera's image.
    pub bbox: Option<BBox>,
    /// What is written above the box.
    pub label: String,
}

/// A copy of a camera's image with the objects drawn onto it and the camera's id in a corner.
pub fn draw(image: &RgbImage, camera: &Camera, objects: &[Drawn]) -> RgbImage {
    let Some(mut canvas) = Canvas::new(image) else {
        return image.clone();
    };
    let unit = f64::from(image.height()) / NOMINAL_HEIGHT;
    let text_scale = unit.round().clamp(1.0, 16.0) as u32 * 2;
    let colored = || objects.iter().zip(OBJECT_COLORS.iter().cycle());
    for (object, &color) in colored() {
        draw_points(&mut canvas, camera, object, unit, color);
    }
    for (object, &color) in colored() {
        if let Some(BBox { x0, y0, x1, y1 }) = object.bbox {
            let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
            let corners = corners.map(|(x, y)| Point2::new(x, y));
            canvas.polyline(&corners, 1.5 * unit, color, 0.9);
        }
        draw_axes(&mut canvas, camera, object, unit);
    }
    for (object, &color) in colored() {
        let beside = || {
            let reach = object.diameter_m / 2.0;
            let center = Point3::from(object.cam_from_obj.translation.vector);
            let corner = center - Vector3::new(reach, reach, 0.0);
            camera.intrinsics().project(&corner)
        };
        let corner = object.bbox.map(|bbox| Point2::new(bbox.x0, bbox.y0));
        if let Some(corner) = corner.or_else(beside) {
            let (_, height) = canvas::text_size(&object.label, text_scale);
            let above = corner.y - f64::from(height) - 2.0 * unit;
            canvas.text(&object.label, corner.x, above, text_scale, color);
        }
    }
    canvas.text(camera.id(), 0.0, 0.0, text_scale, [255; 3]);
    canvas.image()
}

/// [`draw`] for every image, with the objects as predicted.
///
/// - `classes`: of the bundle that the prediction was made with
/// - `images`: those that the prediction was made from
/// - returns: in the order of `images`
pub fn draw_prediction(
    prediction: &Prediction,
    classes: &[Class],
    rig: &Rig,
    images: &[ViewImage],
) -> Vec<RgbImage> {
    let points = |class: &Class| class.points.iter().map(|p| p.position.into()).collect();
    let points: Vec<Vec<Point3<f64>>> = classes.iter().map(points).collect();
    let drawn = |ViewImage { camera, image }: &ViewImage| {
        let in_camera = |object: &ObjectPose| {
            let mut names = classes.iter().map(|class| &class.name);
            let class = names.position(|name| *name == object.class)?;
            let seen = object.cameras.iter().find(|seen| seen.camera == *camera)?;
            Some(Drawn {
                cam_from_obj: seen.cam_from_obj,
                points: &points[class],
                diameter_m: classes[class].diameter_m,
                bbox: seen.bbox,
                label: format!("{} {:.2}", object.class, object.score),
            })
        };
        let objects: Vec<Drawn> = prediction.objects.iter().filter_map(in_camera).collect();
        let camera = rig.cameras().get(*camera);
        camera.map_or_else(|| image.clone(), |camera| draw(image, camera, &objects))
    };
    images.iter().map(drawn).collect()
}

/// A copy of a camera's image with the axes of the true pose: thin white lines that end in a dot of
/// the axis' color beyond the predicted ones, so that both can be seen where they agree.
pub fn draw_truth(
    image: &RgbImage,
    camera: &Camera,
    world_from_obj: &Isometry3<f64>,
    diameter_m: f64,
) -> RgbImage {
    let Some(mut canvas) = Canvas::new(image) else {
        return image.clone();
    };
    let unit = f64::from(image.height()) / NOMINAL_HEIGHT;
    let cam_from_obj = camera.world_from_cam().inv_mul(world_from_obj);
    for (pixels, color) in axes(camera, &cam_from_obj, 0.85 * diameter_m) {
        canvas.polyline(&pixels, 3.0 * unit, [16, 16, 16], 0.6);
        canvas.polyline(&pixels, 1.5 * unit, [255; 3], 1.0);
        if let Some(end) = pixels.last() {
            canvas.dot(*end, 4.5 * unit, [255; 3], 1.0);
            canvas.dot(*end, 3.0 * unit, color, 1.0);
        }
    }
    canvas.image()
}

/// [`draw_edges`] for every image, with the objects as predicted.
///
/// - `images`: those that the prediction was made from
/// - returns: in the order of `images`
pub fn draw_prediction_edges(
    prediction: &Prediction,
    estimator: &Estimator,
    rig: &Rig,
    images: &[ViewImage],
) -> Vec<RgbImage> {
    let mut edges = vec![Vec::new(); images.len()];
    for object in &prediction.objects {
        for (all, own) in edges.iter_mut().zip(estimator.edges(rig, images, object)) {
            all.extend(own);
        }
    }
    let drawn = |(ViewImage { camera, image }, edges): (&ViewImage, &Vec<Edge>)| {
        let camera = rig.cameras().get(*camera);
        camera.map_or_else(|| image.clone(), |camera| draw_edges(image, camera, edges))
    };
    images.iter().zip(&edges).map(drawn).collect()
}

/// A copy of a camera's image with edges of a mesh: green where it shows them, else red.
pub fn draw_edges(image: &RgbImage, camera: &Camera, edges: &[Edge]) -> RgbImage {
    let Some(mut canvas) = Canvas::new(image) else {
        return image.clone();
    };
    let unit = f64::from(image.height()) / NOMINAL_HEIGHT;
    for edge in edges {
        let in_camera = camera.world_from_cam().inverse_transform_point(&edge.point);
        if let Some(pixel) = camera.intrinsics().project(&in_camera) {
            let color = if edge.is_inlier { INLIER } else { OUTLIER };
            canvas.dot(pixel, 1.2 * unit, color, 1.0);
        }
    }
    canvas.image()
}

/// The images side by side, at one height; empty without images.
pub fn contact_sheet(images: &[RgbImage]) -> RgbImage {
    let width = |image: &RgbImage| {
        let (width, height) = (u64::from(image.width()), u64::from(image.height().max(1)));
        // No view may be wider than sixteen times its height.
        (width * u64::from(SHEET_HEIGHT) / height).clamp(1, 16 * u64::from(SHEET_HEIGHT)) as u32
    };
    if images.is_empty() {
        return RgbImage::new(0, 0);
    }
    let gaps = SHEET_GAP * (images.len() as u32 - 1);
    let mut sheet = RgbImage::new(images.iter().map(width).sum::<u32>() + gaps, SHEET_HEIGHT);
    let mut left = 0;
    for image in images {
        let view = resize(image, width(image), SHEET_HEIGHT, FilterType::Triangle);
        replace(&mut sheet, &view, i64::from(left), 0);
        left += view.width() + SHEET_GAP;
    }
    sheet
}

/// Dots where the camera sees the object's surface.
fn draw_points(canvas: &mut Canvas, camera: &Camera, object: &Drawn, unit: f64, color: Color) {
    let in_camera: Vec<(Point3<f64>, Point2<f64>)> = object
        .points
        .iter()
        .step_by(object.points.len().div_ceil(MAX_POINTS).max(1))
        .map(|point| object.cam_from_obj * point)
        .filter_map(|point| Some((point, camera.intrinsics().project(&point)?)))
        .collect();
    for (point, pixel) in &in_camera {
        // Hidden where a point nearby in the image lies clearly nearer to the camera.
        let distance = point.coords.norm();
        let nearby = 0.06 * object.diameter_m / distance;
        let hidden = in_camera.iter().any(|(other, _)| {
            distance - other.coords.norm() > 0.15 * object.diameter_m
                && point.coords.angle(&other.coords) < nearby
        });
        if !hidden {
            canvas.dot(*pixel, 1.3 * unit, color, 0.6);
        }
    }
}

fn draw_axes(canvas: &mut Canvas, camera: &Camera, object: &Drawn, unit: f64) {
    let length = 0.65 * object.diameter_m;
    for (pixels, color) in axes(camera, &object.cam_from_obj, length) {
        canvas.polyline(&pixels, 5.5 * unit, [16, 16, 16], 0.6);
        canvas.polyline(&pixels, 3.5 * unit, color, 1.0);
    }
}

/// Lines of the axes in the image, with their colors; far ones first, so that near ones cover
/// them.
fn axes(
    camera: &Camera,
    cam_from_obj: &Isometry3<f64>,
    length: f64,
) -> Vec<(Vec<Point2<f64>>, Color)> {
    let at = |axis: usize, piece: usize| {
        let mut point = Point3::origin();
        point[axis] = length * piece as f64 / AXIS_PIECES as f64;
        cam_from_obj * point
    };
    let mut axes = [0, 1, 2];
    axes.sort_by(|&a, &b| at(b, AXIS_PIECES).z.total_cmp(&at(a, AXIS_PIECES).z));
    let line = |axis: usize| {
        let pixel = |piece| camera.intrinsics().project(&at(axis, piece));
        let pixels: Option<Vec<_>> = (0..=AXIS_PIECES).map(pixel).collect();
        Some((pixels?, AXIS_COLORS[axis]))
    };
    axes.into_iter().filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Intrinsics, Projection};
    use image::Rgb;

    fn camera() -> Camera {
        Camera::new(
            "left",
            [640, 480],
            Intrinsics::new(500., 500., 320., 240., Projection::Pinhole).unwrap(),
            Isometry3::identity(),
        )
        .unwrap()
    }

    #[test]
    fn axes_start_at_the_object_and_point_along_the_image_axes() {
        let object = Drawn {
            cam_from_obj: Isometry3::translation(0.0, 0.0, 1.0),
            points: &[],
            diameter_m: 0.2,
            bbox: None,
            label: "ball".into(),
        };
        let image = RgbImage::new(640, 480);
        let drawn = draw(&image, &camera(), &[object]);
        assert_eq!(drawn.dimensions(), (640, 480));
        // 0.13 m at 1 m and 500 px: 65 px to the right and down.
        assert_eq!(drawn.get_pixel(380, 240), &Rgb(AXIS_COLORS[0]));
        assert_eq!(drawn.get_pixel(320, 300), &Rgb(AXIS_COLORS[1]));
        assert_eq!(drawn.get_pixel(390, 240), &Rgb([0; 3]));
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
        let edges = [edge(0.1, true), edge(-0.1, false), edge(5.0, true)];
        let drawn = draw_edges(&RgbImage::new(640, 480), &camera, &edges);
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
        let drawn = draw_truth(&RgbImage::new(640, 480), &camera, &world_from_obj, 0.2);
        // 0.17 m at 1 m and 500 px: 85 px to the right and down.
        assert_eq!(drawn.get_pixel(360, 240), &Rgb([255; 3]));
        assert_eq!(drawn.get_pixel(405, 240), &Rgb(AXIS_COLORS[0]));
        assert_eq!(drawn.get_pixel(320, 325), &Rgb(AXIS_COLORS[1]));
        assert_eq!(drawn.get_pixel(415, 240), &Rgb([0; 3]));
        let behind = Isometry3::translation(1.0, 0.0, -1.0);
        let untouched = draw_truth(&RgbImage::new(640, 480), &camera, &behind, 0.2);
        assert_eq!(untouched, RgbImage::new(640, 480));
    }

    #[test]
    fn points_behind_the_surface_are_not_drawn() {
        let points = [Point3::new(0.0, 0.0, -0.1), Point3::new(0.0, 0.0, 0.1)];
        let shown = |pose: Isometry3<f64>, points: &[Point3<f64>]| {
            let object = Drawn {
                cam_from_obj: pose,
                points,
                diameter_m: 0.2,
                bbox: None,
                label: "".into(),
            };
            let mut canvas = Canvas::new(&RgbImage::new(640, 480)).unwrap();
            draw_points(&mut canvas, &camera(), &object, 1.0, [100; 3]);
            canvas.image().get_pixel(320, 240).0[0]
        };
        let ahead = Isometry3::translation(0.0, 0.0, 1.0);
        assert_eq!(shown(ahead, &points), 60, "one dot, not two on each other");
        assert_eq!(
            shown(ahead, &points[1..]),
            60,
            "the far point, alone, is seen"
        );
        assert_eq!(
            shown(Isometry3::translation(0.0, 0.0, -1.0), &points),
            0,
            "behind the camera"
        );
    }

    #[test]
    fn sheet_has_all_views_at_one_height() {
        let sheet = contact_sheet(&[RgbImage::new(640, 480), RgbImage::new(960, 960)]);
        assert_eq!(sheet.dimensions(), (640 + SHEET_GAP + 480, 480));
        assert_eq!(contact_sheet(&[]).dimensions(), (0, 0));
    }

    #[test]
    fn wild_poses_and_tiny_images_do_not_panic() {
        let points = [Point3::new(f64::NAN, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0)];
        for z in [0.0, 1e-9, 1e12, f64::NAN] {
            let object = Drawn {
                cam_from_obj: Isometry3::translation(1.0, -3.0, z),
                points: &points,
                diameter_m: 0.2,
                bbox: Some([f64::NAN, -1e9, 1e9, 3.0].into()),
                label: "ball".into(),
            };
            draw(&RgbImage::new(2, 1), &camera(), &[object]);
        }
    }
}
