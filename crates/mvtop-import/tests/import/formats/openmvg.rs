use mvtop_import::{Format, Options};

use super::samples::OPENMVG;
use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn openmvg_states_the_centers_of_cameras() {
    let imported = read(&[("sfm_data.json", OPENMVG)], &scaled(0.1)).unwrap();
    assert_eq!(imported.format, Format::OpenMvg);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!([left.id(), right.id()], ["left", "right"]);
    assert_plane(left, [500.0, 500.0, 320.0, 240.0]);
    assert_params(left, &[-0.2, 0.05, 0.001, -0.002, 0.01]);
    assert_pose(left, [0.0; 3], X, Z);
    let lens = right.intrinsics().projection();
    assert_eq!(lens.distortion(), Some("kannala_brandt"));
    assert_pose(right, [0.4, 0.2, 0.0], MINUS_Y, Z);
    assert!(
        imported
            .notes
            .iter()
            .any(|note| note.ends_with("no pose: lost"))
    );
}

#[test]
fn openmvg_s_unit_is_asked_for_and_a_lens_that_is_not_known_named() {
    let error = refusal(&[("sfm_data.json", OPENMVG)], &Options::default());
    assert!(error.contains("`unit` (--unit"), "{error}");
    let other = OPENMVG.replace("disto_t2", "disto_k9");
    let error = refusal(&[("sfm_data.json", &other)], &scaled(0.1));
    assert!(error.contains("the key `disto_k9` is not known"), "{error}");
}
