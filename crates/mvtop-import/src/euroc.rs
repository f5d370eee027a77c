//! EuRoC's `sensor.yaml`, one file per camera; the world frame is the body's.

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// Its keys.
const KNOWN: [&str; 9] = [
    "sensor_type",
    "comment",
    "T_BS",
    "rate_hz",
    "resolution",
    "camera_model",
    "intrinsics",
    "distortion_model",
    "distortion_coefficients",
];

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let cameras = sources
        .iter()
        .map(|source| camera(source, options))
        .collect::<Checked<_>>()?;
    Ok(Draft {
        cameras,
        metres: Some(1.0),
        posing: "give its T_BS, the pose of the sensor in the body frame",
        notes: vec!["the world frame is that of the body".into()],
    })
}

fn camera(source: &Source, options: &Options) -> Checked<DraftCamera> {
    let document = yaml::document(source)?;
    let top = Node::new(&document, &source.name);
    let of = |problem: String| format!("{}: {problem}", source.name);
    if let Some(kind) = top
        .find(&["sensor_type"])
        .filter(|kind| kind.value != "camera")
    {
        return Err(kind.wrong("camera"));
    }
    let model = top.get(&["camera_model"])?;
    if model.text()? != "pinhole" {
        return Err(model.wrong("pinhole"));
    }
    let params = match top.find(&["distortion_coefficients"]) {
        Some(params) => params.numbers()?,
        None => Vec::new(),
    };
    unread::refuse(&top, &KNOWN, options)?;
    let name = top.get(&["distortion_model"])?;
    let body_from_sensor = top.get(&["T_BS"])?;
    // mav0/cam0/sensor.yaml: the folder names the camera.
    let folder = source.path.parent().and_then(|folder| folder.file_name());
    let name_of_file = match (source.stem().as_str(), folder) {
        ("sensor", Some(folder)) => folder.to_string_lossy().into_owned(),
        (stem, _) => stem.to_owned(),
    };
    let id = draft::id(&name_of_file);
    let plane = Plane::new(top.get(&["intrinsics"])?.vector()?);
    let sides = top.get(&["resolution"])?.size()?;
    let size = draft::ordered_size(&id, "resolution", Some(false), sides, &plane, options)?;
    Ok(DraftCamera {
        id,
        size: Some(size),
        plane,
        lens: Lens::named(name.text()?, &params).map_err(of)?,
        pose: Some(Pose::world_from_cam(draft::rigid(
            &body_from_sensor.place,
            &body_from_sensor.matrix4()?,
        )?)),
    })
}
