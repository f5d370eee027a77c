//! Results in BOP's format: a CSV file with a line for each estimated pose.
//!
//! Source: <https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults>.

use std::collections::BTreeMap;
use std::path::Path;

use mvtop_core::file;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::doubts::Inexact;
use super::json::{MM, rotation};
use crate::{Error, Result};

/// Largest file that is read.
const MAX_FILE_BYTES: u64 = 1 << 31;
/// Translations beyond this, 100 km, are taken for broken.
const FARTHEST_MM: f64 = 1e8;

/// Translations none of which is longer than this are taken for metres: no camera sees an object from 2 cm.
const NEAREST_MM: f64 = 20.0;
/// How far times of one image may differ, seconds, as to BOP's toolkit.
const SAME_TIME_S: f64 = 1e-3;

/// The file's first line.
pub const RESULTS_HEADER: &str = "scene_id,im_id,obj_id,score,R,t,time\n";

/// An estimated pose as results have it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Number of the object.
    pub obj_id: u32,
    /// Confidence; greater is surer.
    pub score: f64,
    /// Rotation of `cam_from_obj`, row by row.
    #[serde(rename = "R")]
    pub r: [f64; 9],
    /// Translation of `cam_from_obj`, millimetres.
    pub t_mm: [f64; 3],
}

/// A line of results.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultRow {
    /// Number of the scene.
    pub scene_id: u32,
    /// Number of the image.
    pub im_id: u32,
    /// The pose; its rotation is exact.
    pub estimate: Estimate,
    /// What all poses of the image took, seconds; `None` where that is not known.
    pub time_s: Option<f64>,
}

/// Reads results, in the file's order, and takes note of rotations that were made exact. The first
/// line may be [`RESULTS_HEADER`].
///
/// - `names`: numbers of objects that the file gives by name
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] with the number of the line that is
/// no result.
pub fn load_results(
    path: &Path,
    names: &BTreeMap<String, u32>,
) -> Result<(Vec<ResultRow>, Inexact)> {
    let text = file::read_text(path, MAX_FILE_BYTES)?;
    let (mut rows, mut inexact) = (Vec::new(), Inexact::default());
    let mut times: BTreeMap<(u32, u32), Option<f64>> = BTreeMap::new();
    for (i, line) in text.lines().enumerate() {
        let header = i == 0 && line.trim_start().starts_with("scene_id");
        if header || line.trim().is_empty() {
            continue;
        }
        let place = || format!("{}: line {}", path.display(), i + 1);
        let row = ResultRow::read(line, names);
        let (row, off) = row.map_err(|problem| Error::Data(format!("{}: {problem}", place())))?;
        inexact.note(off, place);
        let image = (row.scene_id, row.im_id);
        let time = *times.entry(image).or_insert(row.time_s);
        let differ = match (time, row.time_s) {
            (Some(a), Some(b)) => (a - b).abs() > SAME_TIME_S,
            (a, b) => a != b,
        };
        if differ {
            let (scene, image) = image;
            let shown = |time: Option<f64>| time.map_or("-1".into(), |time| time.to_string());
            return Err(Error::Data(format!(
                "{}: expected one time for all poses of image {image} of scene {scene}, that of the whole \
                 image, got {} and {}",
                place(),
                shown(time),
                shown(row.time_s)
            )));
        }
        rows.push(row);
    }
    Ok((rows, inexact))
}

/// What to tell people of results that look like metres; `None` where they do not.
pub fn doubt_of_unit(rows: &[ResultRow]) -> Option<String> {
    let length = |row: &ResultRow| Vector3::from(row.estimate.t_mm).norm();
    let farthest = rows.iter().map(length).fold(0.0, f64::max);
    (farthest > 0.0 && farthest < NEAREST_MM).then(|| {
        format!(
            "translations look like metres: the farthest object would be {farthest:.3} mm from its camera; BOP's \
             unit is the millimetre, so multiply by 1000 if so"
        )
    })
}

impl ResultRow {
    /// With how far its rotation was off, before it was made exact.
    fn read(line: &str, names: &BTreeMap<String, u32>) -> Result<(Self, f64), String> {
        let fields = fields(line)?;
        let &[scene_id, im_id, object, score, r, t, time] = &fields[..] else {
            return Err(format!(
                "expected {} with 9 and 3 numbers in R and t between spaces, got {} fields between \
                 commas",
                RESULTS_HEADER.trim_end(),
                fields.len()
            ));
        };
        let obj_id = match names.get(object) {
            Some(&id) => id,
            None => whole("obj_id", object).map_err(|problem| {
                format!("{problem}, and no name of an object; give --map NAME=ID")
            })?,
        };
        let r: [f64; 9] = numbers("R", r)?;
        let (exact, off) = rotation(&r).map_err(|problem| format!("R: {problem}"))?;
        let t_mm: [f64; 3] = numbers("t", t)?;
        if t_mm.iter().any(|x| x.abs() > FARTHEST_MM) {
            return Err(format!(
                "t: expected millimetres of at most {FARTHEST_MM:e}, got {t_mm:?}"
            ));
        }
        let [score] = numbers("score", score)?;
        let [time] = numbers("time", time)?;
        let estimate = Estimate {
            obj_id,
            score,
            r: std::array::from_fn(|i| exact[(i / 3, i % 3)]),
            t_mm,
        };
        let row = Self {
            scene_id: whole("scene_id", scene_id)?,
            im_id: whole("im_id", im_id)?,
            estimate,
            time_s: (time >= 0.0).then_some(time),
        };
        Ok((row, off))
    }
}

/// What is between commas, without the quotes that some programs put around it.
fn fields(line: &str) -> Result<Vec<&str>, String> {
    let mut quoted = false;
    let between = |c: char| {
        quoted ^= c == '"';
        c == ',' && !quoted
    };
    let bare = |field| {
        let field: &str = field;
        let inner = match field.trim().strip_prefix('"') {
            None => Some(field),
            Some(rest) => rest.strip_suffix('"'),
        };
        inner.filter(|inner| !inner.contains('"')).map(str::trim)
    };
    let fields: Option<Vec<&str>> = line.split(between).map(bare).collect();
    fields.ok_or_else(|| "expected each field as it is or in quotes, got others".into())
}

fn whole(name: &str, text: &str) -> Result<u32, String> {
    let number = text.parse();
    number.map_err(|_| format!("{name}: expected a whole number, got {text:?}"))
}

/// Numbers between spaces.
fn numbers<const N: usize>(name: &str, text: &str) -> Result<[f64; N], String> {
    let numbers: Vec<f64> = text.split_whitespace().flat_map(str::parse).collect();
    let count = text.split_whitespace().count();
    match <[f64; N]>::try_from(numbers) {
        Ok(numbers) if count == N && numbers.iter().all(|x| x.is_finite()) => Ok(numbers),
        _ => Err(format!("{name}: expected {N} finite numbers, got {text:?}")),
    }
}

impl Estimate {
    /// Object frame to the frame of the image's camera, metres.
    ///
    /// # Errors
    /// [`Error::Data`] where its rotation is none.
    pub fn cam_from_obj(&self) -> Result<Isometry3<f64>> {
        let (rotation, _) = rotation(&self.r).map_err(Error::Data)?;
        Ok(Isometry3::from_parts(
            (Vector3::from(self.t_mm) * MM).into(),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))
    }

    /// - `cam_from_obj`: object frame to the frame of the image's camera, metres
    pub fn new(obj_id: u32, score: f64, cam_from_obj: &Isometry3<f64>) -> Self {
        let rotation = cam_from_obj.rotation.to_rotation_matrix();
        Self {
            obj_id,
            score,
            r: std::array::from_fn(|i| rotation[(i / 3, i % 3)]),
            t_mm: (cam_from_obj.translation.vector * 1e3).into(),
        }
    }

    /// The estimate's line, with its end; every digit is written.
    ///
    /// - `time_s`: what all poses of the image took, seconds; BOP's -1 where that is not known
    pub fn csv_line(&self, scene_id: u32, im_id: u32, time_s: f64) -> String {
        let (obj_id, score, r, t) = (self.obj_id, self.score, list(&self.r), list(&self.t_mm));
        format!("{scene_id},{im_id},{obj_id},{score},{r},{t},{time_s}\n")
    }
}

fn list(numbers: &[f64]) -> String {
    let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
    numbers.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    #[test]
    fn a_line_has_rows_of_the_rotation_and_millimetres() {
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 90f64.to_radians());
        let pose = Isometry3::from_parts(Translation3::new(0.5, -0.25, 1.0), quarter);
        let mut estimate = Estimate::new(7, 0.75, &pose);
        for (entry, expected) in estimate
            .r
            .iter_mut()
            .zip([0., -1., 0., 1., 0., 0., 0., 0., 1.])
        {
            assert!((*entry - expected).abs() < 1e-15);
            *entry = expected;
        }
        assert_eq!(
            estimate.csv_line(48, 3, 0.125),
            "48,3,7,0.75,0 -1 0 1 0 0 0 0 1,500 -250 1000,0.125\n"
        );
        let (back, _) = ResultRow::read(&estimate.csv_line(48, 3, -1.0), &BTreeMap::new()).unwrap();
        assert_eq!((back.scene_id, back.im_id, back.time_s), (48, 3, None));
        assert_eq!(back.estimate, estimate);
        let off = back.estimate.cam_from_obj().unwrap().inv_mul(&pose);
        assert!(off.translation.vector.norm() < 1e-15 && off.rotation.angle() < 1e-7);
        let columns = |line: &str| line.trim_end().split(',').count();
        assert_eq!(
            columns(RESULTS_HEADER),
            columns(&estimate.csv_line(1, 2, -1.0))
        );
    }

    fn load(text: &str) -> Result<(Vec<ResultRow>, Inexact)> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("results.csv");
        std::fs::write(&path, text).unwrap();
        load_results(&path, &BTreeMap::from([("mug".to_owned(), 4)]))
    }

    #[test]
    fn results_of_other_programs_are_read() {
        // Header or none, line ends of Windows, spaces after commas, few digits, a name, no time.
        let rows = "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 900,0.25\r\n\
                    1, 3, mug, 1e-1, 1.004  0 0 0 1 0 0 0 1 , 1.5 -2 3e2, -1\r\n\r\n";
        for header in ["", RESULTS_HEADER] {
            let (read, inexact) = load(&format!("{header}{rows}")).unwrap();
            let [first, second] = &read[..] else { panic!() };
            assert_eq!((first.estimate.obj_id, second.estimate.obj_id), (3, 4));
            assert_eq!((first.time_s, second.time_s), (Some(0.25), None));
            assert_eq!(second.estimate.t_mm, [1.5, -2.0, 300.0]);
            assert!((second.estimate.r[0] - 1.0).abs() < 1e-14);
            assert_eq!((inexact.of, inexact.count), (2, 1));
            assert!(inexact.place.ends_with(if header.is_empty() {
                "line 2"
            } else {
                "line 3"
            }));
        }
    }

    #[test]
    fn fields_may_be_quoted() {
        let quoted = "\"1\",2,\"mug\",0.5,\"1 0 0 0 1 0 0 0 1\",\"0 0 900\", \"0.25\"\n";
        let (read, _) = load(quoted).unwrap();
        assert_eq!((read[0].scene_id, read[0].estimate.obj_id), (1, 4));
        assert_eq!(read[0].estimate.t_mm, [0.0, 0.0, 900.0]);
        let broken = quoted.replacen("\"mug\"", "m\"ug", 1);
        let error = load(&broken).unwrap_err().to_string();
        assert!(error.contains("expected"), "{error}");
    }

    #[test]
    fn times_that_differ_within_an_image_are_refused() {
        let row =
            |image: u32, time: &str| format!("1,{image},3,0.5,1 0 0 0 1 0 0 0 1,0 0 900,{time}\n");
        assert!(load(&(row(1, "0.25") + &row(1, "0.2505") + &row(2, "0.5"))).is_ok());
        for other in ["0.3", "-1"] {
            let error = load(&(row(1, "0.25") + &row(1, other))).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains("line 2: expected one time for all poses of image 1"),
                "{error}"
            );
            assert!(error.contains(&format!("got 0.25 and {other}")), "{error}");
        }
    }

    #[test]
    fn translations_in_metres_are_doubted() {
        let row = |t: &str| format!("1,2,3,0.5,1 0 0 0 1 0 0 0 1,{t},-1\n");
        let doubt = |text: &str| doubt_of_unit(&load(text).unwrap().0);
        assert!(
            doubt(&(row("0 0 0.9") + &row("0.1 0 1.2")))
                .unwrap()
                .contains("look like metres")
        );
        assert_eq!(doubt(&(row("0 0 0.9") + &row("0 0 900"))), None);
        assert_eq!(doubt(&row("0 0 0")), None);
    }

    #[test]
    fn lines_that_are_no_results_are_named() {
        let good = "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 900,0.25";
        for (wrong, hint) in [
            ("1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 900", "6 fields"),
            ("1,2,can,0.5,1 0 0 0 1 0 0 0 1,0 0 900,1", "--map NAME=ID"),
            (
                "1,-2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 900,1",
                "im_id: expected a whole",
            ),
            (
                "1,2,3,0.5,1 0 0 0 1 0 0 0 1.2,0 0 900,1",
                "R: expected a rotation",
            ),
            (
                "1,2,3,0.5,1 0 0 0 1 0 0 0,0 0 900,1",
                "R: expected 9 finite numbers",
            ),
            (
                "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 inf,1",
                "t: expected 3 finite numbers",
            ),
            (
                "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 x 9,1",
                "t: expected 3 finite numbers",
            ),
            ("1,2,3,nan,1 0 0 0 1 0 0 0 1,0 0 900,1", "score: expected 1"),
        ] {
            let error = load(&format!("{good}\n{wrong}\n")).unwrap_err().to_string();
            assert!(error.contains("results.csv: line 2: "), "{error}");
            assert!(error.contains(hint) && !error.contains('\n'), "{error}");
        }
    }
}
