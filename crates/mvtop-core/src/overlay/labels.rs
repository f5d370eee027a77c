//! Labels of objects, placed so that they do not cover each other.

use nalgebra::{Point2, distance};

use super::canvas::{Canvas, Color};
use super::text::Text;
use crate::BBox;

const TEXT: Color = [255; 3];
const GROUND: Color = [18, 20, 24];
const GROUND_ALPHA: f64 = 0.72;

/// Sizes for images of the nominal height, px: the font, the plate around the text, the gap between
/// plate and object.
const FONT: f64 = 14.0;
const PADDING: [f64; 2] = [6.0, 4.5];
const RADIUS: f64 = 4.0;
const GAP: f64 = 5.0;

/// Costs of a place: what it covers, as shares of the label's area, and its distance, in heights.
const ON_LABEL: f64 = 100.0;
const ON_OTHER: f64 = 3.0;
const ON_OWN: f64 = 4.0;
const FAR: f64 = 0.25;
/// Rings of places around an object.
const RINGS: usize = 16;

/// What is to be written beside an object.
pub struct Label {
    pub text: String,
    pub color: Color,
    /// What the object covers, px.
    pub object: BBox,
    /// Where a line to the label may end, px; its corners and middle where there are none.
    pub outline: Vec<Point2<f64>>,
}

/// Writes labels on dark plates, with lines to the objects that they do not touch.
///
/// - `taken`: plates that are drawn already
/// - `unit`: px for each px of an image of the nominal height
pub fn draw(canvas: &mut Canvas, labels: Vec<Label>, mut taken: Vec<BBox>, unit: f64) {
    let size = canvas.size().map(f64::from);
    let objects: Vec<BBox> = labels.iter().map(|label| label.object).collect();
    let mut placed = Vec::new();
    for (index, label) in labels.into_iter().enumerate() {
        let text = Text::new(&label.text, FONT * unit);
        let plate = place(
            plate_size(&text, unit),
            &objects,
            index,
            &taken,
            size,
            GAP * unit,
        );
        taken.push(plate);
        placed.push((label, text, plate));
    }
    // Lines first, so that no plate is crossed.
    for (label, _, plate) in &placed {
        if let Some(line) = leader(label, plate, 2.5 * GAP * unit) {
            canvas.polyline(&line, 3.5 * unit, GROUND, 0.5);
            canvas.polyline(&line, 1.5 * unit, label.color, 1.0);
            canvas.dot(line[1], 3.0 * unit, label.color, 1.0);
        }
    }
    for (label, text, plate) in placed {
        write(canvas, text, plate, Some(label.color), unit);
    }
}

/// Writes a text in the top left corner; returns its plate.
pub fn title(canvas: &mut Canvas, text: &str, unit: f64) -> BBox {
    let text = Text::new(text, FONT * unit);
    let [width, height] = plate_size(&text, unit);
    let at = GAP * unit;
    let plate = [at, at, at + width, at + height].into();
    write(canvas, text, plate, None, unit);
    plate
}

fn plate_size(text: &Text, unit: f64) -> [f64; 2] {
    [
        text.width + 2.0 * PADDING[0] * unit,
        text.height + 2.0 * PADDING[1] * unit,
    ]
}

fn write(canvas: &mut Canvas, text: Text, plate: BBox, frame: Option<Color>, unit: f64) {
    canvas.plate(plate, RADIUS * unit, GROUND, GROUND_ALPHA);
    if let Some(color) = frame {
        canvas.frame(plate, RADIUS * unit, 1.5 * unit, color, 1.0);
    }
    let (x, y) = (plate.x0 + PADDING[0] * unit, plate.y1 - PADDING[1] * unit);
    text.draw(canvas, x, y, TEXT);
}

/// The place of a label of `width` by `height` px that covers least: above, below or beside its
/// object, and farther off where that is taken.
///
/// - `objects`: of all labels; `own` is the index of this one's
/// - `taken`: what no label may cover
/// - `image`: width and height, px
fn place(
    [width, height]: [f64; 2],
    objects: &[BBox],
    own: usize,
    taken: &[BBox],
    image: [f64; 2],
    gap: f64,
) -> BBox {
    let object = objects[own];
    let [right, bottom] = [image[0] - gap - width, image[1] - gap - height];
    let at = |x: f64, y: f64| -> BBox {
        let (x, y) = (x.min(right).max(gap), y.min(bottom).max(gap));
        [x, y, x + width, y + height].into()
    };
    let cost = |plate: &BBox| {
        let share = |other: &BBox| overlap(plate, other) / (width * height);
        let on_labels: f64 = taken
            .iter()
            .map(|other| share(&grown(other, gap / 2.0)))
            .sum();
        let others = objects
            .iter()
            .enumerate()
            .filter(|(index, _)| *index != own);
        let on_others: f64 = others.map(|(_, other)| share(other)).sum();
        let far = apart(plate, &object) / height;
        ON_LABEL * on_labels + ON_OTHER * on_others + ON_OWN * share(&object) + FAR * far
    };
    let middle = object.center();
    let mut best = at(object.x0, object.y0 - gap - height);
    let mut least = cost(&best);
    for ring in 0..RINGS {
        let off = gap + ring as f64 * height / 2.0;
        let (above, below) = (object.y0 - off - height, object.y1 + off);
        let (before, behind) = (object.x0 - off - width, object.x1 + off);
        let (centered, centered_y) = (middle.x - width / 2.0, middle.y - height / 2.0);
        for (x, y) in [
            (object.x0, above),
            (centered, above),
            (object.x1 - width, above),
            (object.x0, below),
            (centered, below),
            (object.x1 - width, below),
            (behind, object.y0),
            (behind, centered_y),
            (behind, object.y1 - height),
            (before, object.y0),
            (before, centered_y),
            (before, object.y1 - height),
            (behind, above),
            (behind, below),
            (before, above),
            (before, below),
        ] {
            let plate = at(x, y);
            let cost = cost(&plate);
            // Not where it is equal, so that earlier places win.
            if cost < least - 1e-9 {
                (best, least) = (plate, cost);
            }
        }
    }
    best
}

/// From a plate to the nearest point of its object's outline, where they are farther apart than
/// `most` px.
fn leader(label: &Label, plate: &BBox, most: f64) -> Option<[Point2<f64>; 2]> {
    let BBox { x0, y0, x1, y1 } = label.object;
    let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
    let corners = corners.map(|(x, y)| Point2::new(x, y));
    let ends = if label.outline.is_empty() {
        &corners[..]
    } else {
        &label.outline
    };
    let onto = |p: &Point2<f64>| {
        // Not `clamp`, which panics where a side is not a number.
        Point2::new(
            p.x.max(plate.x0).min(plate.x1),
            p.y.max(plate.y0).min(plate.y1),
        )
    };
    let lines = ends.iter().map(|end| [onto(end), *end]);
    let length = |[from, to]: &[Point2<f64>; 2]| distance(from, to);
    let line = lines.min_by(|a, b| length(a).total_cmp(&length(b)))?;
    (length(&line) > most).then_some(line)
}

fn grown(bbox: &BBox, by: f64) -> BBox {
    [bbox.x0 - by, bbox.y0 - by, bbox.x1 + by, bbox.y1 + by].into()
}

/// Area that two boxes share, px².
fn overlap(a: &BBox, b: &BBox) -> f64 {
    let width = a.x1.min(b.x1) - a.x0.max(b.x0);
    let height = a.y1.min(b.y1) - a.y0.max(b.y0);
    width.max(0.0) * height.max(0.0)
}

/// Distance between two boxes, px; 0 where they touch.
fn apart(a: &BBox, b: &BBox) -> f64 {
    let gap = |a0: f64, a1: f64, b0: f64, b1: f64| (b0 - a1).max(a0 - b1).max(0.0);
    gap(a.x0, a.x1, b.x0, b.x1).hypot(gap(a.y0, a.y1, b.y0, b.y1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: [f64; 2] = [640.0, 480.0];

    /// Plates of labels of 100 by 20 px.
    fn placed(objects: &[BBox]) -> Vec<BBox> {
        let mut taken = Vec::new();
        for own in 0..objects.len() {
            taken.push(place([100.0, 20.0], objects, own, &taken, IMAGE, 5.0));
        }
        taken
    }

    #[test]
    fn label_of_a_lone_object_is_above_its_left_corner() {
        let plates = placed(&[[200.0, 200.0, 260.0, 300.0].into()]);
        assert_eq!(plates[0], [200.0, 175.0, 300.0, 195.0].into());
    }

    #[test]
    fn label_of_an_object_at_the_top_is_below_or_beside_it() {
        let object = [200.0, 0.0, 400.0, 100.0].into();
        let plate = placed(&[object])[0];
        assert_eq!(overlap(&plate, &object), 0.0);
        assert!(apart(&plate, &object) <= 8.0, "{plate:?}");
    }

    #[test]
    fn labels_of_objects_at_one_place_do_not_overlap() {
        let object: BBox = [300.0, 220.0, 340.0, 260.0].into();
        let plates = placed(&[object; 12]);
        for (index, plate) in plates.iter().enumerate() {
            assert!(plate.x0 >= 5.0 && plate.x1 <= 635.0, "{plate:?}");
            assert!(plate.y0 >= 5.0 && plate.y1 <= 475.0, "{plate:?}");
            for other in &plates[..index] {
                assert_eq!(overlap(plate, other), 0.0, "{plate:?} {other:?}");
            }
        }
    }

    #[test]
    fn labels_avoid_other_objects() {
        let below: BBox = [200.0, 200.0, 300.0, 300.0].into();
        let above: BBox = [200.0, 100.0, 300.0, 195.0].into();
        let plate = placed(&[below, above])[0];
        assert_eq!(overlap(&plate, &above), 0.0);
        assert_eq!(overlap(&plate, &below), 0.0);
    }

    #[test]
    fn label_of_what_fills_the_image_lies_within_it() {
        let plate = placed(&[[-50.0, -50.0, 700.0, 500.0].into()])[0];
        assert!(plate.x0 >= 5.0 && plate.y0 >= 5.0 && plate.x1 <= 635.0 && plate.y1 <= 475.0);
    }

    #[test]
    fn line_leads_from_the_plate_to_the_nearest_point() {
        let label = Label {
            text: String::new(),
            color: TEXT,
            object: [100.0, 100.0, 200.0, 200.0].into(),
            outline: vec![Point2::new(150.0, 100.0), Point2::new(150.0, 200.0)],
        };
        let plate = [140.0, 20.0, 240.0, 40.0].into();
        let line = leader(&label, &plate, 12.0).unwrap();
        assert_eq!(line, [Point2::new(150.0, 40.0), Point2::new(150.0, 100.0)]);
        let near = [140.0, 70.0, 240.0, 90.0].into();
        assert!(leader(&label, &near, 12.0).is_none());
    }
}
