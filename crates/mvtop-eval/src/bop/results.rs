//! Results in BOP's format: a CSV file with a line for each estimated pose.
//!
//! Source: <https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults>.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

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

impl Estimate {
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
        let columns = |line: &str| line.trim_end().split(',').count();
        assert_eq!(
            columns(RESULTS_HEADER),
            columns(&estimate.csv_line(1, 2, -1.0))
        );
    }
}
