//! Prints the poses of the shipped example of two views.
//!
//! `cargo run --release -p mvtop-core --example poses`

use std::path::Path;

use mvtop_core::{Estimator, Options, PredictOptions, Prediction, Result, Rig, ViewImage, image};

fn main() -> Result<()> {
    for object in poses()?.objects {
        println!(
            "{}, score {:.2}: {}",
            object.class, object.score, object.ref_from_obj
        );
    }
    Ok(())
}

/// Of the objects in the example's images, in the frame of the rig's reference camera.
fn poses() -> Result<Prediction> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let example = repository.join("examples/mvball");
    let rig = Rig::load(&example.join("rig.json"))?;
    let mut images = Vec::new();
    for (camera, of) in rig.cameras().iter().enumerate() {
        let image = image::load(&example.join(format!("{}.png", of.id())), of)?;
        images.push(ViewImage { camera, image });
    }
    let estimator = Estimator::load(&repository.join("models/mvball"), &Options::default())?;
    estimator.predict(&rig, &images, &PredictOptions::default())
}

#[cfg(test)]
mod tests {
    #[test]
    fn example_shows_one_ball() {
        let classes: Vec<String> = super::poses()
            .unwrap()
            .objects
            .into_iter()
            .map(|object| object.class)
            .collect();
        assert_eq!(classes, ["mvball"]);
    }
}
