//! Pictures of a prediction, through each camera's true lens: outlines of the objects' meshes in a
//! color for each object, axes of the poses, and labels that do not cover each other.

mod axes;
mod canvas;
mod contour;
mod labels;
mod points;
mod sheet;
mod text;

use image::RgbImage;
use nalgebra::{Isometry3, Point2, Point3};

use self::canvas::{Canvas, Color};
use self::labels::Label;
pub use self::sheet::contact_sheet;
use crate::bundle::Class;
use crate::image::ViewImage;
use crate::mesh::Mesh;
use crate::prediction::{ObjectPose, Prediction};
use crate::refine::Edge;
use crate::{BBox, Camera, Estimator, Rig};

/// One color per object, in turn: those of Okabe and Ito, which people with any color vision can
/// tell apart.
const OBJECT_COLORS: [Color; 7] = [
    [86, 180, 233],
    [230, 159, 0],
    [204, 121, 167],
    [240, 228, 66],
    [0, 158, 115],
    [213, 94, 0],
    [0, 114, 178],
];
/// Beside lines, so that they are seen on any background.
const DARK: Color = [16, 16, 16];
/// Colors of contour points with and without an edge in the image.
const INLIER: Color = [40, 220, 40];
const OUTLIER: Color = [255, 40, 40];
/// Sizes are made for images of this height, px.
const NOMINAL_HEIGHT: f64 = 480.0;
/// They shrink no further than to this share of it: text would not be readable.
const LEAST_UNIT: f64 = 0.75;

/// An object to draw.
#[derive(Debug, Clone)]
pub struct Drawn<'a> {
    /// Object frame to camera frame, metres.
    pub cam_from_obj: Isometry3<f64>,
    /// Its surface.
    pub shape: Shape<'a>,
    /// The object's diameter, metres: axes are a share of it.
    pub diameter_m: f64,
    /// In the camera's image, px; drawn only where there is no mesh.
    pub bbox: Option<BBox>,
    /// What is written beside it.
    pub label: String,
    /// Chooses its color: the same in all views.
    pub instance: usize,
}

/// The surface of an object to draw, in its frame, metres.
#[derive(Debug, Clone, Copy)]
pub enum Shape<'a> {
    /// Its outline is drawn.
    Mesh(&'a Mesh),
    /// Those that the camera sees are drawn.
    Points(&'a [Point3<f64>]),
}

/// Contour points of an object to draw.
#[derive(Debug, Clone)]
pub struct DrawnEdges {
    /// Of the object's mesh.
    pub edges: Vec<Edge>,
    /// What is written beside it.
    pub label: String,
    /// Chooses the color of its label: the same in all views.
    pub instance: usize,
}

/// A copy of a camera's image with the objects drawn onto it and the camera's id in a corner.
pub fn draw(image: &RgbImage, camera: &Camera, objects: &[Drawn]) -> RgbImage {
    let Some(mut canvas) = Canvas::new(image) else {
        return image.clone();
    };
    let unit = unit(image);
    // Far ones first, so that near ones cover them.
    let mut sorted: Vec<&Drawn> = objects.iter().collect();
    let depth = |object: &&Drawn| object.cam_from_obj.translation.z;
    sorted.sort_by(|a, b| depth(b).total_cmp(&depth(a)));
    let outlines = sorted
        .iter()
        .map(|object| draw_shape(&mut canvas, camera, object, unit));
    let outlines: Vec<Vec<Point2<f64>>> = outlines.collect();
    for object in &sorted {
        axes::draw(
            &mut canvas,
            camera,
            &object.cam_from_obj,
            object.diameter_m,
            unit,
        );
    }
    let labels = sorted.iter().zip(outlines).filter_map(|(object, outline)| {
        let around = BBox::around(outline.iter().copied().map(Some)).or(object.bbox)?;
        Some(Label {
            text: object.label.clone(),
            color: color(object.instance),
            object: around.clip(image.width(), image.height())?,
            outline,
        })
    });
    write(&mut canvas, camera, labels.collect(), unit);
    canvas.image()
}

/// [`draw`] for every image, with the objects as predicted: outlines of classes with a mesh, points
/// and boxes of others.
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
        let in_camera = |(instance, object): (usize, &ObjectPose)| {
            let mut names = classes.iter().map(|class| &class.name);
            let index = names.position(|name| *name == object.class)?;
            let seen = object.cameras.iter().find(|seen| seen.camera == *camera)?;
            let class = &classes[index];
            Some(Drawn {
                cam_from_obj: seen.cam_from_obj,
                shape: match &class.mesh {
                    Some(mesh) => Shape::Mesh(mesh),
                    None => Shape::Points(&points[index]),
                },
                diameter_m: class.diameter_m,
                bbox: seen.bbox,
                label: label(&object.class, object.confidence, object.score),
                instance,
            })
        };
        let objects = prediction.objects.iter().enumerate();
        let objects: Vec<Drawn> = objects.filter_map(in_camera).collect();
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
    let cam_from_obj = camera.world_from_cam().inv_mul(world_from_obj);
    axes::draw_true(&mut canvas, camera, &cam_from_obj, diameter_m, unit(image));
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
    let mut drawn: Vec<Vec<DrawnEdges>> = vec![Vec::new(); images.len()];
    for (instance, object) in prediction.objects.iter().enumerate() {
        for (drawn, edges) in drawn.iter_mut().zip(estimator.edges(rig, images, object)) {
            let label = label(&object.class, object.confidence, object.score);
            drawn.push(DrawnEdges {
                edges,
                label,
                instance,
            });
        }
    }
    let draw = |(ViewImage { camera, image }, drawn): (&ViewImage, &Vec<DrawnEdges>)| {
        let camera = rig.cameras().get(*camera);
        camera.map_or_else(|| image.clone(), |camera| draw_edges(image, camera, drawn))
    };
    images.iter().zip(&drawn).map(draw).collect()
}

/// A copy of a camera's image with edges of meshes, green where it shows them, else red, and the
/// camera's id in a corner.
pub fn draw_edges(image: &RgbImage, camera: &Camera, objects: &[DrawnEdges]) -> RgbImage {
    let Some(mut canvas) = Canvas::new(image) else {
        return image.clone();
    };
    let unit = unit(image);
    let mut labels = Vec::new();
    for object in objects {
        let pixels = object.edges.iter().filter_map(|edge| {
            let in_camera = camera.world_from_cam().inverse_transform_point(&edge.point);
            let color = if edge.is_inlier { INLIER } else { OUTLIER };
            Some((camera.intrinsics().project(&in_camera)?, color))
        });
        let pixels: Vec<(Point2<f64>, Color)> = pixels.collect();
        for (pixel, _) in &pixels {
            canvas.dot(*pixel, 2.0 * unit, DARK, 0.4);
        }
        for (pixel, color) in &pixels {
            canvas.dot(*pixel, 1.3 * unit, *color, 1.0);
        }
        let outline: Vec<Point2<f64>> = pixels.into_iter().map(|(pixel, _)| pixel).collect();
        let around = BBox::around(outline.iter().copied().map(Some));
        if let Some(around) = around.and_then(|a| a.clip(image.width(), image.height())) {
            labels.push(Label {
                text: object.label.clone(),
                color: color(object.instance),
                object: around,
                outline,
            });
        }
    }
    write(&mut canvas, camera, labels, unit);
    canvas.image()
}

/// Px of an image for each px of one of the nominal height.
fn unit(image: &RgbImage) -> f64 {
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    (height.min(0.75 * width) / NOMINAL_HEIGHT).max(LEAST_UNIT)
}

fn color(instance: usize) -> Color {
    OBJECT_COLORS[instance % OBJECT_COLORS.len()]
}

/// Class and confidence, or score where the model is not calibrated.
fn label(class: &str, confidence: Option<f64>, score: f64) -> String {
    match confidence {
        // No pose is certain.
        Some(confidence) if confidence >= 0.995 => format!("{class} >99%"),
        Some(confidence) => format!("{class} {:.0}%", 100.0 * confidence),
        None => format!("{class} {score:.2}"),
    }
}

/// Draws an object's surface; returns points of its outline, px.
fn draw_shape(canvas: &mut Canvas, camera: &Camera, object: &Drawn, unit: f64) -> Vec<Point2<f64>> {
    let (pose, color) = (&object.cam_from_obj, color(object.instance));
    match object.shape {
        Shape::Mesh(mesh) => {
            let lines = contour::outline(mesh, camera, pose, 4.0 * unit);
            canvas.area(&lines, color, 0.08);
            canvas.loops(&lines, 4.0 * unit, DARK, 0.5);
            canvas.loops(&lines, 2.0 * unit, color, 1.0);
            lines.into_iter().flatten().collect()
        }
        Shape::Points(points) => {
            if let Some(bbox) = object.bbox {
                canvas.frame(bbox, 0.0, 3.5 * unit, DARK, 0.5);
                canvas.frame(bbox, 0.0, 1.5 * unit, color, 1.0);
            }
            points::draw(canvas, camera, pose, points, object.diameter_m, color, unit)
        }
    }
}

fn write(canvas: &mut Canvas, camera: &Camera, labels: Vec<Label>, unit: f64) {
    let title = labels::title(canvas, camera.id(), unit);
    labels::draw(canvas, labels, vec![title], unit);
}

#[cfg(test)]
mod tests;
