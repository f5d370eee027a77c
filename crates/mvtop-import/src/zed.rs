//! ZED's factory calibration, `SN12345678.conf`: both cameras at each resolution, and `STEREO`.
//!
//! Source: <https://github.com/stereolabs/zed-open-capture>, `examples/include/calibration.hpp`, and Stereolabs'
//! tool for pairs of ZED X One, which writes it from OpenCV's `stereoCalibrate`: x_right = R x_left + T, with
//! R = Rodrigues(RX, CV, RZ) and T = (-Baseline, TY, TZ) in mm. Keys end in the resolution where they
//! depend on it. `LEFT_DISTO` holds the lens where the sections of the resolutions do not.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Map, Value};

use crate::draft::{Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread};

/// Resolutions by the ends of their sections' names.
const SIZES: [(&str, [u32; 2]); 8] = [
    ("4K", [3840, 2160]),
    ("QHDPLUS", [3200, 1800]),
    ("2K", [2208, 1242]),
    ("FHD1200", [1920, 1200]),
    ("FHD", [1920, 1080]),
    ("HD", [1280, 720]),
    ("SVGA", [960, 600]),
    ("VGA", [672, 376]),
];
const PLANE: [&str; 4] = ["FX", "FY", "CX", "CY"];
/// Of the pair; a resolution may follow.
const STEREO: [&str; 6] = ["BASELINE", "TY", "TZ", "CV", "RX", "RZ"];
const BROWN_CONRADY: [&str; 8] = ["K1", "K2", "P1", "P2", "K3", "K4", "K5", "K6"];
const KANNALA_BRANDT: [&str; 4] = ["K1", "K2", "K3", "K4"];

/// Whether a file has a line that starts a camera's section.
pub fn is_it(text: &str) -> bool {
    text.lines()
        .any(|line| line.trim().to_uppercase().starts_with("[LEFT_CAM_"))
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        return Err(format!("expected one file of a ZED, got {}", sources.len()));
    };
    let sections = sections(source)?;
    let top = Node::new(&sections, &source.name);
    let (resolution, size) = resolution(&top, options)?;
    let camera = |side: &str, pose| -> Checked<DraftCamera> {
        let section = top.get(&[&format!("{side}_CAM_{resolution}")])?;
        let [fx, fy, cx, cy] = PLANE.map(|key| section.get(&[key])?.number());
        Ok(DraftCamera {
            id: side.to_lowercase(),
            size: Some(size),
            plane: Plane::new([fx?, fy?, cx?, cy?]),
            lens: lens(&section, top.find(&[&format!("{side}_DISTO")]), options)?,
            pose: Some(Pose::cam_from_world(pose)),
        })
    };
    let right_from_left = right_from_left(&top.get(&["STEREO"])?, resolution, options)?;
    Ok(Draft {
        cameras: vec![
            camera("LEFT", Isometry3::identity())?,
            camera("RIGHT", right_from_left)?,
        ],
        metres: Some(1e-3),
        posing: "give its section `STEREO`",
        notes: vec![format!(
            "of images of {} x {}, as they come from the cameras, not rectified",
            size[0], size[1]
        )],
    })
}

/// Sections and keys in upper case, as they are read without case.
fn sections(source: &Source) -> Checked<Value> {
    let mut sections = Map::new();
    let mut name = String::new();
    for line in source.text()?.lines() {
        let line = line.split([';', '#']).next().unwrap_or_default().trim();
        if let Some(inner) = line
            .strip_prefix('[')
            .and_then(|line| line.strip_suffix(']'))
        {
            name = inner.trim().to_uppercase();
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let (key, value) = (key.trim().to_uppercase(), value.trim());
        let number = value
            .parse::<f64>()
            .ok()
            .filter(|number| number.is_finite());
        let value = number.map_or_else(|| value.into(), Value::from);
        let section = sections
            .entry(name.clone())
            .or_insert_with(|| Map::new().into());
        let section = section.as_object_mut().into_iter().next();
        if section.is_some_and(|section| section.insert(key.clone(), value).is_some()) {
            return Err(format!("{}: [{name}] has `{key}` twice", source.name));
        }
    }
    Ok(sections.into())
}

/// The resolution of the images, by name and size: the one that was said, or the only one.
fn resolution(top: &Node, options: &Options) -> Checked<(&'static str, [u32; 2])> {
    let had = SIZES
        .into_iter()
        .filter(|(name, _)| top.has(&format!("LEFT_CAM_{name}")));
    let had: Vec<_> = had.collect();
    let wanted = options.size_of("left").or(options.size_of("right"));
    let found: Vec<_> = had
        .iter()
        .filter(|(_, size)| wanted.is_none_or(|wanted| wanted == *size))
        .collect();
    if let [found] = found[..] {
        return Ok(*found);
    }
    let names = had
        .iter()
        .map(|(_, [width, height])| format!("{width}x{height}"));
    let names = names.collect::<Vec<_>>().join(", ");
    Err(match (wanted, had.is_empty()) {
        (_, true) => format!("{}: no section [LEFT_CAM_...] of a known size", top.place),
        (Some([width, height]), _) => format!(
            "{}: has images of {names}, got {width}x{height} as `image_size` (--image-size)",
            top.place
        ),
        (None, _) => format!(
            "{}: has images of {names}; give the size of yours as `image_size` (--image-size WxH)",
            top.place
        ),
    })
}

/// The lens, from the camera's section or from that of all resolutions.
fn lens(section: &Node, for_all: Option<Node>, options: &Options) -> Checked<Lens> {
    let stated = match for_all {
        Some(_) if section.has("K1") => {
            return Err(format!(
                "{}: expected its lens in one section, got two; take the wrong one out",
                section.place
            ));
        }
        Some(lens) => lens,
        None => section.clone(),
    };
    let fisheye = !stated.has("P1") && stated.has("K4");
    let keys: &[&str] = match fisheye {
        true => &KANNALA_BRANDT,
        false => &BROWN_CONRADY,
    };
    let known: Vec<&str> = PLANE.iter().chain(keys).copied().collect();
    unread::refuse(section, &known, options)?;
    unread::refuse(&stated, &known, options)?;
    let of = |key: &&str| stated.find(&[*key]).map_or(Ok(0.0), |value| value.number());
    let params = keys.iter().map(of).collect::<Checked<Vec<f64>>>()?;
    let lens = match fisheye {
        true => Lens::kannala_brandt(&params),
        false => Lens::brown_conrady(&params),
    };
    lens.map_err(|problem| format!("{}: {problem}", stated.place))
}

/// Of the cameras, mm.
fn right_from_left(stereo: &Node, resolution: &str, options: &Options) -> Checked<Isometry3<f64>> {
    let keys = stereo.entries();
    let known = keys.iter().map(|(key, _)| *key);
    let known = known.filter(|key| STEREO.contains(&key.split('_').next().unwrap_or(key)));
    unread::refuse(stereo, &known.collect::<Vec<_>>(), options)?;
    let of = |key: &str| -> Checked<f64> {
        let here = format!("{key}_{resolution}");
        stereo.get(&[&here, key])?.number()
    };
    let turn = Vector3::new(of("RX")?, of("CV")?, of("RZ")?);
    let baseline = stereo.get(&["BASELINE"])?.number()?;
    Ok(Isometry3::from_parts(
        Translation3::new(-baseline, of("TY")?, of("TZ")?),
        UnitQuaternion::from_scaled_axis(turn),
    ))
}
