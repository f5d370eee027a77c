//! Agisoft Metashape's cameras as XML ("Export Cameras").
//!
//! Source: the manual of Metashape, appendix "Camera models": u = w/2 + cx + f x' + b1 x' + b2 y',
//! v = h/2 + cy + f y', counted from the corner of the image, so half a pixel is taken off; its p2 and p1 are
//! OpenCV's p1 and p2. A fisheye's polynomial is that of OpenCV's. A camera's `transform` maps it to the chunk,
//! axes as OpenCV's; the `scale` of the chunk's or component's own `transform` is metres per unit.

use roxmltree::{Document, Node, ParsingOptions};

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::openmvg::left_out;
use crate::source::Source;
use crate::{Checked, Options};

/// Most elements that are read; a camera is about three.
const MOST_NODES: u32 = 1 << 20;

/// Whether the text is a document with a chunk.
pub fn is_it(text: &str) -> bool {
    text.contains("<document") && text.contains("<chunk")
}

pub fn read(sources: &[Source], _: &Options) -> Checked<Draft> {
    let [source] = sources else {
        let got = sources.len();
        return Err(format!("expected one file of Metashape, got {got}"));
    };
    let of = |problem: String| format!("{}: {problem}", source.name);
    let options = ParsingOptions {
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(source.text()?, options);
    let document = document.map_err(|error| of(format!("no XML: {error}")))?;
    let chunks: Vec<Node> = children(document.root_element(), "chunk").collect();
    let [chunk] = chunks.as_slice() else {
        return Err(of(format!("expected one `chunk`, got {}", chunks.len())));
    };
    let mut cameras = Vec::new();
    let mut unposed = Vec::new();
    let mut components = Vec::new();
    for camera in all(*chunk, "cameras", "camera") {
        let name = camera.attribute("label").unwrap_or("camera");
        let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
        let of = |problem: String| of(format!("camera `{name}`: {problem}"));
        let Some(transform) = child(camera, "transform") else {
            unposed.push(name.to_owned());
            continue;
        };
        components.push(camera.attribute("component_id"));
        let rows: [f64; 16] = numbers(transform).map_err(of)?;
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| rows[4 * i + j]));
        let sensor = camera.attribute("sensor_id");
        let sensor = all(*chunk, "sensors", "sensor").find(|one| one.attribute("id") == sensor);
        let sensor = sensor.ok_or_else(|| of("its sensor is not there".into()))?;
        let (size, plane, lens) = optics(sensor).map_err(of)?;
        cameras.push(DraftCamera {
            id: draft::id(stem),
            size: Some(size),
            plane,
            lens,
            pose: Some(Pose::world_from_cam(
                draft::rigid("transform", &rows).map_err(of)?,
            )),
        });
    }
    if cameras.is_empty() {
        return Err(of("expected aligned cameras, got none".into()));
    }
    components.dedup();
    let [component] = components.as_slice() else {
        return Err(of(
            "expected cameras of one component, got several, which have no frame in common; align them \
             together"
                .into(),
        ));
    };
    Ok(Draft {
        cameras,
        metres: scale(*chunk, *component).map_err(of)?,
        posing: "align it",
        notes: left_out(&unposed),
    })
}

/// Metres per unit, where the chunk or the component is referenced.
fn scale(chunk: Node, component: Option<&str>) -> Checked<Option<f64>> {
    let of_component = all(chunk, "components", "component")
        .find(|one| one.attribute("id") == component)
        .and_then(|one| child(one, "transform"));
    let transform = of_component.or_else(|| child(chunk, "transform"));
    let scale = transform.and_then(|transform| child(transform, "scale"));
    scale
        .map(|scale| numbers(scale).map(|[scale]: [f64; 1]| scale))
        .transpose()
}

fn optics(sensor: Node) -> Checked<([u32; 2], Plane, Lens)> {
    let mut calibrations: Vec<Node> = children(sensor, "calibration").collect();
    // The other one is what the adjustment started from.
    if calibrations
        .iter()
        .any(|one| one.attribute("class") == Some("adjusted"))
    {
        calibrations.retain(|one| one.attribute("class") == Some("adjusted"));
    }
    let calibration = calibrations
        .first()
        .ok_or("its sensor has no calibration")?;
    let resolution = child(*calibration, "resolution").or_else(|| child(sensor, "resolution"));
    let resolution = resolution.ok_or("its sensor has no resolution")?;
    let side = |key: &str| -> Checked<u32> {
        let side = resolution.attribute(key).and_then(|text| text.parse().ok());
        side.filter(|side| *side > 0)
            .ok_or_else(|| format!("its resolution has no `{key}`"))
    };
    let [width, height] = [side("width")?, side("height")?];
    let number = |key: &str| match child(*calibration, key) {
        Some(node) => numbers(node).map(|[number]: [f64; 1]| number),
        None => Ok(0.0),
    };
    for node in calibration.children().filter(Node::is_element) {
        let known = [
            "resolution",
            "f",
            "cx",
            "cy",
            "b1",
            "b2",
            "k1",
            "k2",
            "k3",
            "k4",
            "p1",
            "p2",
            "date",
            "covariance",
        ];
        let key = node.tag_name().name();
        if !known.contains(&key) && numbers::<1>(node) != Ok([0.0]) {
            return Err(format!(
                "the key `{key}` of its calibration is not known, and may be a part of its lens; fit it again \
                 without"
            ));
        }
    }
    let [k1, k2, k3, k4] = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
    let [p1, p2] = [number("p1")?, number("p2")?];
    let kind = calibration.attribute("type").or(sensor.attribute("type"));
    let lens = match kind {
        Some("frame") if k4 != 0.0 => Err(format!(
            "k4 of {k4} is of r⁸, which no rig file has; fit it again without k4"
        )),
        Some("frame") => Lens::brown_conrady(&[k1, k2, p2, p1, k3]),
        Some("fisheye" | "equidistant_fisheye") if [p1, p2] == [0.0; 2] => {
            Lens::kannala_brandt(&[k1, k2, k3, k4])
        }
        Some("fisheye" | "equidistant_fisheye") => {
            Err("a fisheye with p1 and p2 cannot be expressed; fit it again without".into())
        }
        other => Err(format!(
            "its type {other:?} is not known; expected frame or fisheye"
        )),
    }?;
    let f = number("f")?;
    let plane = Plane::from_corner([
        f + number("b1")?,
        f,
        f64::from(width) / 2.0 + number("cx")?,
        f64::from(height) / 2.0 + number("cy")?,
    ]);
    let skew = number("b2")?;
    Ok(([width, height], Plane { skew, ..plane }, lens))
}

fn children<'a>(node: Node<'a, 'a>, name: &str) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children()
        .filter(move |child| child.has_tag_name(name))
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    children(node, name).next()
}

/// Elements of a list, also where it is grouped.
fn all<'a>(chunk: Node<'a, 'a>, list: &str, name: &str) -> impl Iterator<Item = Node<'a, 'a>> {
    let list = child(chunk, list);
    let inner = list.into_iter().flat_map(|list| list.descendants());
    inner.filter(move |node| node.has_tag_name(name))
}

fn numbers<const N: usize>(node: Node) -> Checked<[f64; N]> {
    let words = node.text().unwrap_or_default().split_whitespace();
    let parsed = words.map(|word| word.parse::<f64>().ok().filter(|number| number.is_finite()));
    let all: Option<Vec<f64>> = parsed.collect();
    let name = node.tag_name().name();
    let all = all.ok_or_else(|| format!("`{name}`: expected finite numbers"))?;
    let count = all.len();
    all.try_into()
        .map_err(|_| format!("`{name}`: expected {N} numbers, got {count}"))
}
