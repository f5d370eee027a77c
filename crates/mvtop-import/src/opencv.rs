//! OpenCV: FileStorage as YAML or JSON, of one camera, of a stereo pair, or of several cameras with
//! `rvec` and `tvec` or `R` and `T` each; also other files with its names.

mod camera;
mod found;
mod join;
pub mod keys;
mod names;
mod order;
mod pair;

use nalgebra::Isometry3;
use serde_json::Value;

use self::camera::{SAME_ROTATION, camera};
use self::found::Found;
use self::pair::Pair;
use crate::draft::{Draft, DraftCamera, Pose, directed};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, yaml};

pub use self::camera::transform;
pub use self::found::has_camera;

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let documents = sources.iter().map(|source| {
        let mut all = yaml::documents(source)?;
        all.retain(|document| !document.is_null());
        // Several documents are a list of cameras.
        let document = match all.len() {
            0 | 1 => yaml::document(source)?,
            _ => Value::Array(all),
        };
        Ok((source.stem(), source.name.clone(), document))
    });
    assemble(documents.collect::<Checked<_>>()?, options)
}

/// The rig of documents with OpenCV's names.
///
/// - `documents`: of each the name of the camera that it is of, if it is of one; the file's name, for
///   errors; and what it says
pub fn assemble(documents: Vec<(String, String, Value)>, options: &Options) -> Checked<Draft> {
    let mut found = Found::default();
    for (name, file, document) in documents {
        let document = keys::by_camera(document);
        found
            .collect(&name, &document, true)
            .map_err(|problem| format!("{file}: {problem}"))?;
    }
    let pair = found.join()?;
    found.refuse_unread(options)?;
    let metres = found.metres(options)?;
    let pair = match pair {
        None => None,
        Some(Pair { name, fields }) => {
            let place = format!("{name}: R, T");
            let value = &Value::Object(fields);
            Some(transform(&Node { value, place })?)
        }
    };
    let Found {
        cameras, unordered, ..
    } = found;
    if pair.is_some() && cameras.len() != 2 {
        return Err(format!(
            "R and T are those of a pair of cameras, got {} cameras; give rvec and tvec of each",
            cameras.len()
        ));
    }
    if pair.is_some() && unordered {
        return Err(format!(
            "R and T map the first camera to the second, but the keys `{}` and `{}` do not say which one is \
             the first; give each camera a file of its own, in that order",
            cameras[0].0, cameras[1].0
        ));
    }
    let mut draft = Vec::new();
    let mut notes = Vec::new();
    let mut paired = false;
    for (index, (id, mut fields)) in cameras.into_iter().enumerate() {
        // R1 and R2 of a pair turn its images to rectified ones.
        if pair.is_some() && !fields.contains_key("T") {
            fields.remove("R");
        }
        let value = Value::Object(fields);
        let mut camera = camera(&id, &Node::new(&value, &id), options, &mut notes)?;
        if let Some(second_from_first) = pair
            && camera.pose.is_none()
        {
            if value.get("direction").is_some() {
                return Err(format!(
                    "camera `{id}`: R and T map the first camera of a pair to the second, so leave the direction out"
                ));
            }
            let cam_from_world = [Isometry3::identity(), second_from_first][index];
            camera.pose = Some(Pose::cam_from_world(cam_from_world));
            paired = true;
        }
        draft.push(camera);
    }
    if let (Some(second_from_first), false) = (pair, paired) {
        check_pair(&draft, &second_from_first, options)?;
    }
    if paired {
        notes.push(format!(
            "R and T map `{}` to `{}` (stereoCalibrate), and the world frame is that of the first",
            draft[0].id, draft[1].id
        ));
    }
    Ok(Draft {
        cameras: draft,
        metres,
        posing: "give R and T of the pair, or rvec and tvec of each camera",
        notes,
    })
}

/// Refuses R and T of a pair that are not those between the places of its cameras.
fn check_pair(
    cameras: &[DraftCamera],
    second_from_first: &Isometry3<f64>,
    options: &Options,
) -> Checked<()> {
    let places = cameras.iter().filter_map(|camera| camera.pose.as_ref());
    let places = places
        .map(|pose| directed(pose, options))
        .collect::<Checked<Vec<_>>>()?;
    if let [first, second] = places.as_slice() {
        let off = second_from_first * first.inverse() * second;
        let far = off.translation.vector.norm()
            > SAME_ROTATION * second_from_first.translation.vector.norm();
        if far || off.rotation.angle() > SAME_ROTATION {
            return Err(
                "R and T of no camera by name are not those from the first camera to the second, which have places \
                 of their own; leave the wrong ones out"
                    .into(),
            );
        }
    }
    Ok(())
}
