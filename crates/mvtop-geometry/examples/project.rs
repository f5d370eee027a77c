//! Prints where each camera of a rig file images a point of the world, metres.
//!
//! `cargo run -p mvtop-geometry --example project -- examples/mvball/rig.json 0 0 0`

use std::path::Path;

use mvtop_geometry::Rig;
use mvtop_geometry::nalgebra::Point3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [rig, x, y, z] = arguments.as_slice() else {
        return Err("usage: project RIG.json X Y Z".into());
    };
    let point = Point3::new(x.parse()?, y.parse()?, z.parse()?);
    print!("{}", pixels(&Rig::load(Path::new(rig))?, &point));
    Ok(())
}

/// A line for each camera.
fn pixels(rig: &Rig, point_in_world: &Point3<f64>) -> String {
    let line = |camera: &mvtop_geometry::Camera| {
        let point_in_cam = camera.world_from_cam().inverse() * point_in_world;
        match camera.intrinsics().project(&point_in_cam) {
            Some(pixel) => format!("{}: {:.1} {:.1}\n", camera.id(), pixel.x, pixel.y),
            None => format!("{}: not imaged\n", camera.id()),
        }
    };
    rig.cameras().iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn point_behind_a_camera_is_not_imaged() {
        let rig = r#"{"format": "mvtop-rig", "version": 1, "unit": "m", "cameras": [{"id": "left",
            "width": 640, "height": 480, "fx": 500, "fy": 510, "cx": 320, "cy": 240,
            "T_world_cam": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}"#;
        let rig = Rig::from_json(rig).unwrap();
        assert_eq!(
            pixels(&rig, &Point3::new(0.1, -0.2, 2.0)),
            "left: 345.0 189.0\n"
        );
        assert_eq!(
            pixels(&rig, &Point3::new(0.1, -0.2, -2.0)),
            "left: not imaged\n"
        );
    }
}
