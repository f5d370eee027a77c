//! BOP's `scene_camera.json`, one file per camera (`scene_camera_cam1.json`), or one of all frames; `camera.json` and
//! `camera_cam1.json` of the data set state the size of images.

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, yaml};

/// Keys of an image's camera; the last ones are of LINEMOD's and HomebrewedDB's renderings.
const KNOWN: [&str; 12] = [
    "cam_K",
    "cam_dist",
    "cam_R_w2c",
    "cam_t_w2c",
    "R_w2c",
    "t_w2c",
    "width",
    "height",
    "depth_scale",
    "view_level",
    "elev",
    "mode",
];

/// Keys of a camera of the data set, whose images have matrices of their own.
const KNOWN_OF_ALL: [&str; 7] = ["fx", "fy", "cx", "cy", "width", "height", "depth_scale"];

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut cameras = Vec::new();
    let mut sizes = Vec::new();
    let mut scenes = Vec::new();
    for source in sources {
        let document = yaml::document(source)?;
        let top = Node::new(&document, &source.name);
        match top.has("fx") {
            true => {
                unread::refuse(&top, &KNOWN_OF_ALL, options)?;
                let side = |key: &str| top.get(&[key])?.pixels();
                let stem = source.stem();
                let of = stem.strip_prefix("camera_").unwrap_or_default().to_owned();
                sizes.push((of, [side("width")?, side("height")?]));
            }
            false => scenes.push((source, document)),
        }
    }
    let several = scenes.len() > 1;
    for (source, document) in scenes {
        let sensor = sensor(source);
        let said = sizes
            .iter()
            .find(|(of, _)| of.is_empty() || sensor.as_ref() == Some(of));
        let said = said.map(|(_, size)| *size);
        let before = cameras.len();
        // BOP's numbers are keys, which come in the order of text.
        let top = Node::new(&document, &source.name);
        let mut images = Vec::new();
        for (key, node) in top.entries() {
            let number: u32 = key
                .parse()
                .map_err(|_| format!("{}: expected numbers of images, got {key:?}", source.name))?;
            images.push((number, node));
        }
        images.sort_by_key(|(number, _)| *number);
        if let Some(wanted) = options.image {
            images.retain(|(number, _)| *number == wanted);
        }
        let Some((first, _)) = images.first() else {
            let asked = options
                .image
                .map_or("any image".into(), |n| format!("image {n}"));
            return Err(format!("{}: expected {asked}, got none", source.name));
        };
        if let Some(sensor) = sensor.filter(|_| several) {
            // A rig has a camera per file, so the file must say one and the same in all images.
            let mut still = None;
            for (other, node) in &images {
                let camera = camera(sensor.clone(), node, options)?;
                if *still.get_or_insert_with(|| camera.clone()) != camera {
                    return Err(format!(
                        "{}: the camera of image {first} is not that of image {other}; give `image` \
                         (--image N), the image whose cameras make the rig",
                        source.name
                    ));
                }
            }
            cameras.extend(still);
        } else {
            for (number, node) in &images {
                cameras.push(camera(format!("{number:06}"), node, options)?);
            }
        }
        for camera in &mut cameras[before..] {
            camera.size = camera.size.or(said);
        }
    }
    Ok(Draft {
        cameras,
        metres: Some(0.001),
        posing: "give its cam_R_w2c and cam_t_w2c",
        notes: Vec::new(),
    })
}

/// `cam1` of `scene_camera_cam1.json`.
fn sensor(source: &Source) -> Option<String> {
    let stem = source.stem();
    Some(
        stem.strip_prefix("scene_camera_")
            .unwrap_or(&stem)
            .to_owned(),
    )
}

fn camera(id: String, node: &Node, options: &Options) -> Checked<DraftCamera> {
    let of = |problem: String| format!("{}: {problem}", node.place);
    unread::refuse(node, &KNOWN, options)?;
    let Some(matrix) = node.find(&["cam_K"]) else {
        return Err(of(
            "expected cam_K, got none; cameras given by cam_model are not read".into(),
        ));
    };
    let plane = Plane::from_matrix(matrix.vector()?).map_err(of)?;
    let lens = match node.find(&["cam_dist"]) {
        Some(params) => Lens::brown_conrady(&params.numbers()?).map_err(of)?,
        None => Lens::PINHOLE,
    };
    // XYZ-IBD has the shorter names in some files.
    let r = node.find(&["cam_R_w2c", "R_w2c"]);
    let t = node.find(&["cam_t_w2c", "t_w2c"]);
    let pose = match (r, t) {
        (Some(r), Some(t)) => {
            let transform = draft::rotation_and_translation(&r.place, &r.vector()?, t.vector()?)?;
            Some(Pose::cam_from_world(transform))
        }
        (None, None) => None,
        _ => {
            return Err(of(
                "expected both cam_R_w2c and cam_t_w2c, got one of them".into()
            ));
        }
    };
    let size = match (node.find(&["width"]), node.find(&["height"])) {
        (Some(width), Some(height)) => Some([width.pixels()?, height.pixels()?]),
        _ => None,
    };
    Ok(DraftCamera {
        id: draft::id(&id),
        size,
        plane,
        lens,
        pose,
    })
}
