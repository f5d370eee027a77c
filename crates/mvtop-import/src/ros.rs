//! ROS: `camera_info` as `camera_calibration` writes it or as a message, and poses as TF (`/tf_static`),
//! a URDF, a list of frames or the result of a hand-eye calibration.

pub mod frames;
pub mod hand_eye;
pub mod urdf;

use nalgebra::Isometry3;

use self::frames::Tree;

use crate::draft::{self, Draft, DraftCamera, Pose};
use crate::lens::{Lens, Plane};
use crate::node::Node;
use crate::source::Source;
use crate::{Checked, Options, unread, xml, yaml};

/// What to do about cameras whose places are not known.
const POSING: &str = "a camera_info has no pose, so give a file of transforms as well (ros2 topic echo \
    --once /tf_static), the robot's URDF, or a list `FRAME: {parent: FRAME, xyz: [x, y, z], rpy: [r, p, y]}`";

/// Keys of a camera_info.
const KNOWN: [&str; 23] = [
    "header",
    "image_width",
    "width",
    "image_height",
    "height",
    "camera_name",
    "camera_matrix",
    "K",
    "k",
    "distortion_model",
    "distortion_coefficients",
    "D",
    "d",
    "rectification_matrix",
    "R",
    "r",
    "projection_matrix",
    "P",
    "p",
    "binning_x",
    "binning_y",
    "roi",
    "camera_type",
];

struct Info {
    /// Name of the camera, and of its frame where the file has it.
    name: String,
    frame: Option<String>,
    camera: DraftCamera,
    /// Rectified from raw camera frame.
    rectification: Isometry3<f64>,
    /// Of a rectified pair or row: x of its center in the frame of the first one, metres.
    baseline: Option<f64>,
}

pub fn read(sources: &[Source], options: &Options) -> Checked<Draft> {
    let mut tree = Tree::default();
    let mut infos = Vec::new();
    for source in sources {
        if source.text().is_ok_and(xml::is_xml) {
            tree.add_joints(&source.name, urdf::joints(source)?)?;
            continue;
        }
        for document in yaml::documents(source)?
            .iter()
            .filter(|document| !document.is_null())
        {
            let top = Node::new(document, &source.name);
            let of_camera = top.find(&["camera_matrix", "K", "k"]).is_some();
            match of_camera {
                true => infos.push(info(&top, source, options)?),
                false => tree.add(&top, options)?,
            }
        }
    }
    if infos.is_empty() {
        let only = match tree.is_empty() {
            true => "",
            false => {
                ", only transforms between frames (TF, a URDF, a hand-eye result); give the camera_info as well"
            }
        };
        return Err(format!(
            "expected a camera_info of each camera, got none{only}"
        ));
    }
    name_apart(&mut infos);
    let mut notes = vec![match options.rectified {
        true => {
            "the images are taken to be rectified (image_rect): P, without distortion".to_owned()
        }
        false => "the images are taken to be raw (image_raw): K and D; for image_rect give \
                  `rectified` (--rectified)"
            .to_owned(),
    }];
    let row = tree.is_empty()
        && infos.len() > 1
        && infos
            .iter()
            .any(|info| info.baseline.is_some_and(|x| x != 0.0));
    if row {
        check_row(&infos)?;
        notes.push(
            "the cameras stand apart by the baseline in their P and turned by their R".into(),
        );
    }
    let mut cameras = Vec::new();
    let mut root: Option<(String, String)> = None;
    for mut info in infos {
        let pose = match (row, info.baseline) {
            (true, Some(x)) => Some(Isometry3::translation(x, 0.0, 0.0) * info.rectification),
            _ if tree.is_empty() => None,
            _ => {
                let placed = tree.placed(&info.name, info.frame.as_deref())?;
                let (first, of_first) =
                    root.get_or_insert_with(|| (info.name.clone(), placed.root.clone()));
                if *of_first != placed.root {
                    return Err(format!(
                        "camera `{first}` stands in `{of_first}`{}, camera `{}` in `{}`{}, and no \
                         transform connects these; give one",
                        tree.moved_by(of_first),
                        info.name,
                        placed.root,
                        tree.moved_by(&placed.root)
                    ));
                }
                if !placed.frame.contains("optical") {
                    notes.push(format!(
                        "`{}` is taken for camera `{}`'s optical frame (z forward)",
                        placed.frame, info.name
                    ));
                }
                Some(placed.root_from_cam)
            }
        };
        info.camera.pose = pose.map(|world_from_cam| {
            Pose::world_from_cam(match options.rectified {
                true => world_from_cam * info.rectification.inverse(),
                false => world_from_cam,
            })
        });
        cameras.push(info.camera);
    }
    if let Some((_, root)) = root {
        notes.push(format!("the world is `{root}`{}", tree.moved_by(&root)));
    }
    Ok(Draft {
        cameras,
        metres: Some(1.0),
        posing: POSING,
        notes,
    })
}

/// Refuses cameras of several pairs: the P of each says where it stands in its own pair.
fn check_row(infos: &[Info]) -> Checked<()> {
    let places: Vec<f64> = infos.iter().filter_map(|info| info.baseline).collect();
    let taken = |(i, x): (usize, &f64)| places[..i].contains(x);
    if places.contains(&0.0) && !places.iter().enumerate().any(taken) {
        return Ok(());
    }
    let got = infos.iter().map(|info| {
        let x = info.baseline.map_or("no P".into(), |x| format!("{x:.4} m"));
        format!("`{}` at {x}", info.camera.id)
    });
    Err(format!(
        "without transforms, P (-Tx / fx) says where the cameras of one rectified pair or row stand: expected \
         one at 0 and the others elsewhere, got {}; {POSING}",
        got.collect::<Vec<_>>().join(", ")
    ))
}

fn info(top: &Node, source: &Source, options: &Options) -> Checked<Info> {
    let of = |problem: String| format!("{}: {problem}", top.place);
    let header = top.find(&["header"]);
    if let Some(header) = &header {
        unread::refuse(header, &["frame_id", "seq", "stamp"], options)?;
    }
    let header = header.and_then(|header| header.find(&["frame_id"]));
    let frame = header.map(|id| id.text().map(str::to_owned)).transpose()?;
    let name = match top.find(&["camera_name"]) {
        Some(name) => name.text()?.to_owned(),
        None => frame.clone().unwrap_or_else(|| source.stem()),
    };
    for key in ["binning_x", "binning_y"] {
        if let Some(binning) = top.find(&[key])
            && ![0.0, 1.0].contains(&binning.number()?)
        {
            return Err(binning.wrong("0 or 1; calibrate with the binning that is used"));
        }
    }
    let size = [
        top.get(&["image_width", "width"])?.pixels()?,
        top.get(&["image_height", "height"])?.pixels()?,
    ];
    if let Some(roi) = top.find(&["roi"]) {
        draft::whole_image(&roi, size)?;
    }
    let r = top.find(&["rectification_matrix", "R", "r"]);
    let p = top.find(&["projection_matrix", "P", "p"]);
    let p = p
        .map(|p| p.vector::<12>())
        .transpose()?
        .filter(|p| p[0] != 0.0);
    let r = r
        .map(|r| r.vector::<9>())
        .transpose()?
        .filter(|r| *r != [0.0; 9]);
    let rectification = match r {
        Some(r) => draft::rotation_and_translation(&of("R".into()), &r, [0.0; 3])?,
        None => Isometry3::identity(),
    };
    unread::refuse(top, &KNOWN, options)?;
    let model = top.get(&["distortion_model"])?;
    if let Some(kind) = top.find(&["camera_type"]) {
        let is_fisheye =
            |name: &str| Lens::named(name, &[0.0; 4]).is_ok_and(|lens| lens.is_fisheye());
        let known = Lens::named(kind.text()?, &[0.0; 4]).is_ok();
        if !known || is_fisheye(kind.text()?) != is_fisheye(model.text()?) {
            return Err(kind.wrong("the lens of `distortion_model`"));
        }
    }
    let (plane, lens) = if options.rectified {
        let [fx, skew, cx, _, a, fy, cy, _, b, c, one, _] =
            p.ok_or_else(|| of("rectified images need P, got none".into()))?;
        let plane = Plane::from_matrix([fx, skew, cx, a, fy, cy, b, c, one]).map_err(of)?;
        (plane, Lens::PINHOLE)
    } else {
        let matrix = top.get(&["camera_matrix", "K", "k"])?;
        let params = match top.find(&["distortion_coefficients", "D", "d"]) {
            Some(params) => params.numbers()?,
            None => Vec::new(),
        };
        let lens = Lens::named(model.text()?, &params).map_err(of)?;
        (Plane::from_matrix(matrix.vector()?).map_err(of)?, lens)
    };
    Ok(Info {
        camera: DraftCamera {
            id: draft::id(&name),
            size: Some(size),
            plane,
            lens,
            pose: None,
        },
        name,
        frame,
        rectification,
        // Tx = -fx' B, so a camera to the right has a negative one.
        baseline: p.map(|p| -p[3] / p[0] + 0.0), // No -0.
    })
}

/// The calibrator calls every camera `narrow_stereo`: those are told apart by their number.
fn name_apart(infos: &mut [Info]) {
    let ids: Vec<String> = infos.iter().map(|info| info.camera.id.clone()).collect();
    for (index, info) in infos.iter_mut().enumerate() {
        if ids.iter().filter(|id| **id == info.camera.id).count() > 1 {
            info.camera.id = format!("{}_{index}", info.camera.id);
        }
    }
}
