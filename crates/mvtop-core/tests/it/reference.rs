//! The shipped model's poses in the world are those of the images, whichever camera is the reference.

use crate::fixtures::fixture_path;
use mvtop_core::{Camera, Estimator, Options, PredictOptions, Rig, ViewImage, image};

/// More than are anchors.
const VIEWS: usize = 6;

#[test]
fn poses_of_the_shipped_model_do_not_depend_on_the_reference() {
    let folder = fixture_path("tiny/sample");
    let sample = Rig::load(&folder.join("rig.json")).unwrap();
    let (mut cameras, mut images) = (Vec::new(), Vec::new());
    // The sample's views, some of them again under other names.
    for (view, camera) in sample.cameras().iter().cycle().take(VIEWS).enumerate() {
        let file = folder.join(format!("{}.png", camera.id()));
        images.push(ViewImage {
            camera: view,
            image: image::load(&file, camera).unwrap(),
        });
        let size = [camera.width(), camera.height()];
        let (intrinsics, pose) = (camera.intrinsics().clone(), *camera.world_from_cam());
        cameras.push(Camera::new(format!("view{view}"), size, intrinsics, pose).unwrap());
    }
    let model = fixture_path("../models/mvball");
    let estimator = Estimator::load(&model, &Options::default()).unwrap();
    let found = [0, 3, 5].map(|reference| {
        let rig = Rig::new(cameras.clone(), reference).unwrap();
        let prediction = estimator
            .predict(&rig, &images, &PredictOptions::default())
            .unwrap();
        let object = &prediction.objects[0];
        assert!(object.cameras.iter().all(|seen| seen.bbox.is_some()));
        let again = rig.cameras()[reference].world_from_cam() * object.ref_from_obj;
        let world_from_obj = object.world_from_obj.to_homogeneous();
        assert!((again.to_homogeneous() - world_from_obj).amax() < 1e-12);
        world_from_obj
    });
    for pose in &found[1..] {
        assert!((pose - found[0]).amax() < 1e-12, "{pose}{}", found[0]);
    }
}
