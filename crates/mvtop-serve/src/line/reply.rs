//! Poses as lines of words.

use mvtop_core::error::printable;
use mvtop_core::prediction::Prediction;
use mvtop_core::scorer::Verdict;
use mvtop_core::{Request, Rig};
use nalgebra::{Isometry3, UnitQuaternion};

use crate::exposure::Exposure;
use crate::problem::Problem;

/// How numbers are written.
#[derive(Debug, Clone, Copy)]
pub struct Format {
    unit: Unit,
    rotation: Rotation,
    /// Whether each pose ends with the object's number over time.
    pub ids: bool,
}

#[derive(Debug, Clone, Copy)]
enum Unit {
    Metre,
    Millimetre,
}

#[derive(Debug, Clone, Copy)]
enum Rotation {
    /// Unit quaternion, w first, w >= 0.
    Quaternion,
    /// Axis times angle, radians.
    Vector,
    /// Turns about z, y and x, in this order about the turned axes, degrees.
    Abc,
}

impl Default for Format {
    fn default() -> Self {
        Self {
            unit: Unit::Metre,
            rotation: Rotation::Quaternion,
            ids: false,
        }
    }
}

impl Format {
    /// - `name`: `unit` or `rotation`
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), Problem> {
        match (name, value) {
            ("unit", "m") => self.unit = Unit::Metre,
            ("unit", "mm") => self.unit = Unit::Millimetre,
            ("unit", _) => {
                return Err(Problem::bad(format!(
                    "unit: expected m or mm, got `{value}`"
                )));
            }
            (_, "wxyz") => self.rotation = Rotation::Quaternion,
            (_, "vector") => self.rotation = Rotation::Vector,
            (_, "abc") => self.rotation = Rotation::Abc,
            _ => {
                let message = format!("rotation: expected wxyz, vector or abc, got `{value}`");
                return Err(Problem::bad(message));
            }
        }
        Ok(())
    }

    /// The lines of an answer, without its end.
    ///
    /// - `request`: that chose the objects
    pub fn told(
        &self,
        exposure: &Exposure,
        prediction: &Prediction,
        request: &Request,
        rig: &Rig,
    ) -> Result<String, Problem> {
        let frame_from_world = request.frame_from_world(rig)?;
        let (unit, rotation) = (self.unit_name(), self.rotation_name());
        let age_s = exposure.time.elapsed().map_or(0.0, |age| age.as_secs_f64());
        let frame = word(request.frame.as_deref().unwrap_or("world"));
        let mut lines = format!(
            "OK exposure={} poses={} warnings={} frame={frame} unit={unit} rotation={rotation} age_s={age_s:.3}\n",
            exposure.number,
            prediction.objects.len(),
            prediction.warnings.len(),
        );
        for (index, object) in prediction.objects.iter().enumerate() {
            let verdict = request
                .min_confidence
                .map(|least| match Verdict::of(object, least) {
                    Verdict::Accept => "accept",
                    Verdict::Reject => "reject",
                    Verdict::NeedAnotherView => "need_another_view",
                });
            let id = object.track_id.filter(|_| self.ids);
            let id = id.map_or(String::new(), |id| format!(" id={id}"));
            let confidence = object.confidence.map_or("-".into(), |p| format!("{p:.4}"));
            lines.push_str(&format!(
                "POSE {index} {} {confidence} {} {}{id}\n",
                word(&object.class),
                verdict.unwrap_or("-"),
                self.numbers(&(frame_from_world * object.world_from_obj))
            ));
        }
        for miss in prediction.near_misses.iter().filter(|_| request.why) {
            lines.push_str(&format!(
                "WHY {} {}\n",
                word(&miss.class),
                printable(&miss.message)
            ));
        }
        for warning in &prediction.warnings {
            lines.push_str(&format!("WARNING {}\n", printable(&warning.message)));
        }
        Ok(lines)
    }

    fn unit_name(&self) -> &'static str {
        match self.unit {
            Unit::Metre => "m",
            Unit::Millimetre => "mm",
        }
    }

    fn rotation_name(&self) -> &'static str {
        match self.rotation {
            Rotation::Quaternion => "wxyz",
            Rotation::Vector => "vector",
            Rotation::Abc => "abc",
        }
    }

    fn numbers(&self, pose: &Isometry3<f64>) -> String {
        let scale = match self.unit {
            Unit::Metre => 1.0,
            Unit::Millimetre => 1e3,
        };
        let place = pose.translation.vector * scale;
        let mut numbers: Vec<f64> = place.iter().copied().collect();
        numbers.extend(self.turn(&pose.rotation));
        let texts: Vec<String> = numbers.into_iter().map(text).collect();
        texts.join(" ")
    }

    fn turn(&self, rotation: &UnitQuaternion<f64>) -> Vec<f64> {
        match self.rotation {
            Rotation::Quaternion => mvtop_core::pose::wxyz(rotation).to_vec(),
            Rotation::Vector => rotation.scaled_axis().iter().copied().collect(),
            Rotation::Abc => {
                let (about_x, about_y, about_z) = rotation.euler_angles();
                [about_z, about_y, about_x].map(f64::to_degrees).to_vec()
            }
        }
    }
}

/// A number with six digits after the point; none is -0, which some controllers do not read.
fn text(number: f64) -> String {
    let text = format!("{number:.6}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|c| c == b'0' || c == b'.') => zero.to_owned(),
        _ => text,
    }
}

/// A name as one word.
fn word(name: &str) -> String {
    printable(name).replace(' ', "_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, Vector3};

    #[test]
    fn poses_are_written_as_each_controller_wants_them() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let pose = Isometry3::from_parts(Translation3::new(0.1, -0.2, 0.3), turn);
        let mut format = Format::default();
        assert_eq!(
            format.numbers(&pose),
            "0.100000 -0.200000 0.300000 0.707107 0.000000 0.000000 0.707107"
        );
        format.set("unit", "mm").unwrap();
        format.set("rotation", "vector").unwrap();
        assert_eq!(
            format.numbers(&pose),
            "100.000000 -200.000000 300.000000 0.000000 0.000000 1.570796"
        );
        format.set("rotation", "abc").unwrap();
        assert_eq!(
            format.numbers(&pose),
            "100.000000 -200.000000 300.000000 90.000000 0.000000 0.000000"
        );
        assert!(format.set("unit", "inch").is_err() && format.set("rotation", "xyz").is_err());
    }

    #[test]
    fn abc_are_turns_about_z_y_and_x_one_after_the_other() {
        let about =
            |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
        let turn = about(Vector3::z_axis(), 30.0)
            * about(Vector3::y_axis(), -20.0)
            * about(Vector3::x_axis(), 70.0);
        let mut format = Format::default();
        format.set("rotation", "abc").unwrap();
        let got = format.turn(&turn);
        for (got, want) in got.iter().zip([30.0, -20.0, 70.0]) {
            assert!((got - want).abs() < 1e-9, "{got}");
        }
    }
}
