//! What is given of the objects in a scene: boxes to use instead of detecting, or the whole truth to
//! compare with. `docs/reference/json.md` describes both files.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Isometry3;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{BBox, Error, Result, json, transform};

/// One object and where the cameras see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GivenBoxes {
    /// Name of one of the bundle's classes.
    pub class: String,
    /// In the image, by camera id; cameras that do not see it are left out.
    pub boxes: BTreeMap<String, BBox>,
}

/// One object, where it is and where the cameras see it.
#[derive(Debug, Clone, PartialEq)]
pub struct TruePose {
    /// Its class and its boxes.
    pub seen: GivenBoxes,
    /// Object frame to world frame, metres.
    pub world_from_obj: Isometry3<f64>,
}

/// Reads a file of boxes; keys it does not know are ignored, so that a file of the truth serves, too.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read or is not such a file.
pub fn load_boxes(path: &Path) -> Result<Vec<GivenBoxes>> {
    objects(
        path,
        r#"{"objects": [{"class": NAME, "boxes": {CAMERA: [x0, y0, x1, y1]}}]}"#,
    )
}

/// Reads a file of the truth; its boxes may be left out.
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read or is not such a file, and
/// [`Error::Annotations`] where a pose is none.
pub fn load_truth(path: &Path) -> Result<Vec<TruePose>> {
    #[derive(Deserialize)]
    struct Object {
        class: String,
        #[serde(rename = "T_world_obj")]
        t_world_obj: Value,
        #[serde(default)]
        boxes: BTreeMap<String, BBox>,
    }
    let expected = r#"{"objects": [{"class": NAME, "T_world_obj": 4x4 rows in metres}]}"#;
    let refuse = |problem| Error::Annotations {
        path: path.to_owned(),
        problem,
    };
    let pose = |(i, object): (usize, Object)| {
        let place = format!("T_world_obj of object {i}");
        let (class, boxes) = (object.class, object.boxes);
        Ok(TruePose {
            seen: GivenBoxes { class, boxes },
            world_from_obj: transform::from_json(place, &object.t_world_obj, 1.0)
                .map_err(refuse)?,
        })
    };
    let objects = objects(path, expected)?.into_iter();
    objects.enumerate().map(pose).collect()
}

fn objects<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<Vec<T>> {
    #[derive(Deserialize)]
    struct Document<T> {
        objects: Vec<T>,
    }
    let document: Document<T> = json::read(path, expected)?;
    Ok(document.objects)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use tempfile::NamedTempFile;

    fn file(text: &str) -> NamedTempFile {
        let file = NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    const TRUTH: &str = r#"{"objects": [{"class": "mvball",
        "T_world_obj": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        "boxes": {"right": [1, 2, 3.5, 4]}}]}"#;

    #[test]
    fn file_of_the_truth_gives_poses_and_boxes() {
        let file = file(TRUTH);
        let truth = load_truth(file.path()).unwrap();
        assert_eq!(
            truth[0].world_from_obj.translation.vector,
            Vector3::new(1.0, 2.0, 3.0)
        );
        let x = truth[0].world_from_obj.rotation * Vector3::x();
        assert!((x - Vector3::y()).norm() < 1e-9);
        let boxes = load_boxes(file.path()).unwrap();
        assert_eq!(boxes, [truth[0].seen.clone()]);
        assert_eq!(boxes[0].class, "mvball");
        assert_eq!(boxes[0].boxes["right"], [1.0, 2.0, 3.5, 4.0].into());
    }

    #[test]
    fn other_files_are_refused_in_one_sentence() {
        for text in [
            "",
            "[]",
            r#"{"objects":[{"class":"a","boxes":{"left":[1,2,3]}}]}"#,
        ] {
            let file = file(text);
            for error in [
                load_boxes(file.path()).unwrap_err(),
                load_truth(file.path()).unwrap_err(),
            ] {
                let text = error.to_string();
                assert!(
                    text.contains("expected {\"objects\"") && !text.contains('\n'),
                    "{text}"
                );
            }
        }
        let sheared = file(&TRUTH.replace("[0, -1, 0, 1]", "[0, -1, 1, 1]"));
        let text = load_truth(sheared.path()).unwrap_err().to_string();
        assert!(text.contains("T_world_obj of object 0"), "{text}");
        assert!(matches!(
            load_truth(Path::new("none.json")),
            Err(Error::Geometry(mvtop_geometry::Error::Read { .. }))
        ));
    }
}
