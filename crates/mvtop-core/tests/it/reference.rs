//! The shipped model's poses in the world are those of the images, whichever camera is the reference.

use crate::fixtures::{fixture_path, sample_image, sample_rig};
use mvtop_core::{Estimator, Options, PredictOptions, Rig, ViewImage};

#[test]
fn poses_of_the_shipped_model_do_not_depend_on_the_reference() {
    let cameras = sample_rig().cameras().to_vec(); // six: more than are anchors
    let image = |(camera, real)| ViewImage {
        camera,
        image: sample_image(real),
    };
    let images: Vec<ViewImage> = cameras.iter().enumerate().map(image).collect();
    let model = fixture_path("../models/mvball");
    let estimator = Estimator::load(&model, &Options::default()).unwrap();
    let found = [0, 3, 5].map(|reference| {
        let rig = Rig::new(cameras.clone(), reference).unwrap();
        let prediction = estimator
            .predict(&rig, &images, &PredictOptions::default())
            .unwrap();
        let object = &prediction.objects[0];
        let seen = object.cameras.iter().filter(|seen| seen.bbox.is_some());
        assert!(seen.count() > 4, "too few to choose anchors from");
        let again = rig.reference_camera().world_from_cam() * object.ref_from_obj;
        let world_from_obj = object.world_from_obj.to_homogeneous();
        assert!((again.to_homogeneous() - world_from_obj).amax() < 1e-12);
        world_from_obj
    });
    for pose in &found[1..] {
        assert!((pose - found[0]).amax() < 1e-12, "{pose}{}", found[0]);
    }
}
