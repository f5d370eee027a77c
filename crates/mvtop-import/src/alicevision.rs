//! AliceVision's scene as JSON, which Meshroom writes as `cameras.sfm`.
//!
//! Source: <https://github.com/alicevision/AliceVision>, `sfmDataIO/jsonIO.cpp` and `camera/`: numbers are
//! text; `rotation` is a matrix column by column that maps world to camera, so that read row by row it maps
//! camera to world, and `center` is the camera's place. The focal length is `pxFocalLength`, or `focalLength` in
//! mm of a sensor of `sensorWidth` mm. `principalPoint` counts from the corner or, in newer versions, from the
//! middle of the image: where it is within a quarter of a side tells. The unit is arbitrary.

use serde_json::Value;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::openmvg::left_out;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// How far from where it counts from a principal point may be, shares of a side.
const NEAR: f64 = 0.25;

/// Of intrinsics: what is read, and what says how they were found.
const KNOWN: [&str; 22] = [
    "locked",
    "scaleLocked",
    "offsetLocked",
    "distortionLocked",
    "pixelRatioLocked",
    "intrinsicId",
    "width",
    "height",
    "sensorWidth",
    "sensorHeight",
    "serialNumber",
    "type",
    "distortionType",
    "distortionParams",
    "distortionInitializationMode",
    "focalLength",
    "pxFocalLength",
    "pxInitialFocalLength",
    "initialFocalLength",
    "pixelRatio",
    "principalPoint",
    "initializationMode",
];

/// Of the file, beside what was triangulated.
const OF_FILE: [&str; 12] = [
    "version",
    "featuresFolders",
    "matchesFolders",
    "views",
    "intrinsics",
    "poses",
    "rigs",
    "structure",
    "constraints2d",
    "constraintpoints",
    "rotationpriors",
    "surveys",
];
/// Of a view; `metadata` is that of its image.
const OF_VIEW: [&str; 15] = [
    "viewId",
    "poseId",
    "frameId",
    "intrinsicId",
    "resectionId",
    "rigId",
    "subPoseId",
    "path",
    "width",
    "height",
    "metadata",
    "ancestors",
    "isPoseIndependant",
    "isPoseIndependent",
    "imageGroups",
];

/// Whether it has views, intrinsics and poses by their ids.
pub fn is_it(value: &Value) -> bool {
    let first = value.get("intrinsics").and_then(|list| list.get(0));
    value.get("views").is_some() && first.is_some_and(|one| one.get("intrinsicId").is_some())
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let [source] = sources else {
        let got = sources.len();
        return Err(format!("expected one cameras.sfm, got {got} files"));
    };
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    let named = |list: &str, key: &str, id: &str| -> Checked<Option<Node>> {
        let Some(list) = top.find(&[list]) else {
            return Ok(None);
        };
        let all = list.list()?;
        Ok(all
            .into_iter()
            .find(|one| one.find(&[key]).is_some_and(|found| text(&found) == id)))
    };
    unread::refuse(&top, &OF_FILE, options)?;
    let mut cameras = Vec::new();
    let mut unposed = Vec::new();
    for view in top.get(&["views"])?.list()? {
        unread::refuse(&view, &OF_VIEW, options)?;
        let path = view.get(&["path"])?.text()?;
        let file = path.rsplit(['/', '\\']).next().unwrap_or(path);
        let name = file.rsplit_once('.').map_or(file, |(name, _)| name);
        if view.has("rigId") {
            return Err(format!(
                "{}: views that are part of a `rigId` are not read; write poses of their own",
                view.place
            ));
        }
        let id = text(&view.get(&["poseId", "viewId"])?);
        let Some(pose) = named("poses", "poseId", &id)? else {
            unposed.push(name.to_owned());
            continue;
        };
        let id = text(&view.get(&["intrinsicId"])?);
        let intrinsic = named("intrinsics", "intrinsicId", &id)?
            .ok_or_else(|| format!("{}: no intrinsics {id}", view.place))?;
        let (size, plane, lens) = optics(&intrinsic, options)?;
        unread::refuse(&pose, &["poseId", "pose"], options)?;
        let pose = pose.get(&["pose"])?;
        unread::refuse(&pose, &["transform", "locked"], options)?;
        let pose = pose.get(&["transform"])?;
        unread::refuse(&pose, &["rotation", "center"], options)?;
        let rotation = pose.get(&["rotation"])?;
        let world_from_cam = draft::rotation_and_translation(
            &rotation.place,
            &numbers(&rotation)?,
            numbers(&pose.get(&["center"])?)?,
        )?;
        cameras.push(DraftCamera {
            id: draft::id(name),
            size: Some(size),
            plane,
            lens,
            pose: Some(Pose::world_from_cam(world_from_cam)),
        });
    }
    Ok(Draft {
        cameras,
        metres: None,
        posing: "give its pose",
        notes: left_out(&unposed),
    })
}

/// What it says, whether as a number or as text.
fn text(node: &Node) -> String {
    match node.value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn number(node: &Node) -> Checked<f64> {
    let number = text(node).trim().parse::<f64>().ok();
    let number = number.filter(|number| number.is_finite());
    number.ok_or_else(|| node.wrong("a finite number"))
}

fn numbers<const N: usize>(node: &Node) -> Checked<[f64; N]> {
    let all = node
        .list()?
        .iter()
        .map(number)
        .collect::<Checked<Vec<_>>>()?;
    let count = all.len();
    let all = all.try_into();
    all.map_err(|_| format!("{}: expected {N} numbers, got {count}", node.place))
}

fn optics(node: &Node, options: &Options) -> Checked<([u32; 2], Plane, Lens)> {
    let of = |problem: String| format!("{}: {problem}", node.place);
    let find = |key: &str| node.find(&[key]).map(|node| number(&node)).transpose();
    let side = |key: &str| -> Checked<f64> {
        let node = node.get(&[key])?;
        let side = number(&node)?;
        match side.fract() == 0.0 && (1.0..=1e9).contains(&side) {
            true => Ok(side),
            false => Err(node.wrong("a whole number of pixels")),
        }
    };
    let [width, height] = [side("width")?, side("height")?];
    let focal = match (find("pxFocalLength")?, find("focalLength")?) {
        (Some(focal), _) => focal,
        (None, Some(focal)) => {
            let sensor = number(&node.get(&["sensorWidth"])?)?;
            focal / sensor * width
        }
        (None, None) => {
            return Err(of(
                "expected `pxFocalLength`, or `focalLength` and `sensorWidth`, got none".into(),
            ));
        }
    };
    if let Some(ratio) = find("pixelRatio")?.filter(|ratio| *ratio != 1.0) {
        return Err(of(format!(
            "a `pixelRatio` of {ratio} is not read, expected 1"
        )));
    }
    let [cx, cy] = numbers(&node.get(&["principalPoint"])?)?;
    let near = |x: f64, y: f64| x.abs() <= NEAR * width && y.abs() <= NEAR * height;
    let (middle_x, middle_y) = (width / 2.0, height / 2.0);
    let [cx, cy] = match (near(cx - middle_x, cy - middle_y), near(cx, cy)) {
        (true, _) => [cx, cy],
        (false, true) => [cx + middle_x, cy + middle_y],
        (false, false) => {
            return Err(of(format!(
                "its `principalPoint` of {cx} {cy} is neither near the middle of {width}x{height} px nor \
                 near it when counted from there"
            )));
        }
    };
    let params = match node.find(&["distortionParams"]) {
        Some(none) if none.value == "" => Vec::new(),
        Some(list) => list
            .list()?
            .iter()
            .map(number)
            .collect::<Checked<Vec<_>>>()?,
        None => Vec::new(),
    };
    let kind = node.get(&["type"])?.text()?;
    let distortion = match node.find(&["distortionType"]) {
        Some(distortion) => distortion.text()?,
        None => "",
    };
    // Newer versions have the distortion beside a pinhole, older ones a type for both.
    let name = match (kind, distortion) {
        ("pinhole", "" | "none") => kind,
        ("pinhole", distortion) => distortion,
        (kind, distortion) if ["", kind].contains(&distortion) => kind,
        (kind, distortion) => &format!("{kind} with {distortion}"),
    };
    let lens = match (name, params.as_slice()) {
        ("pinhole", []) => Ok(Lens::PINHOLE),
        ("radial1" | "radialk1", &[k1]) => Lens::brown_conrady(&[k1, 0.0, 0.0, 0.0, 0.0]),
        ("radial3" | "radialk3", &[k1, k2, k3]) => Lens::brown_conrady(&[k1, k2, 0.0, 0.0, k3]),
        ("brown", &[k1, k2, k3, p1, p2]) => Lens::brown_conrady(&[k1, k2, p1, p2, k3]),
        ("fisheye4", all @ [_, _, _, _]) => Lens::kannala_brandt(all),
        (name, all) => Err(format!(
            "its lens `{name}` with {} coefficients is not known; expected pinhole, radial1, radial3, brown or \
             fisheye4",
            all.len()
        )),
    };
    unread::refuse(node, &KNOWN, options)?;
    Ok((
        [width as u32, height as u32],
        Plane::new([focal, focal, cx, cy]),
        lens.map_err(of)?,
    ))
}
