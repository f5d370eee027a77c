use mvtop_import::{Format, Options};

use super::samples::METASHAPE;
use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

#[test]
fn metashape_counts_from_the_middle_and_states_its_scale() {
    let imported = read(&[("cameras.xml", METASHAPE)], &Options::default()).unwrap();
    assert_eq!(imported.format, Format::Metashape);
    let [left, right] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_eq!([left.id(), right.id()], ["left", "right"]);
    assert_plane(left, [510.0, 500.0, 321.0, 237.5]);
    // p1 and p2 the other way round.
    assert_params(left, &[-0.2, 0.05, -0.002, 0.001, 0.01]);
    assert_pose(left, [0.0; 3], X, Z);
    assert_params(right, &[0.1, 0.02, 0.003, 0.0004]);
    assert_pose(right, [0.4, 0.2, 0.0], MINUS_Y, Z);
    assert!(
        imported
            .notes
            .iter()
            .any(|note| note.contains("no pose: lost.jpg"))
    );
}

#[test]
fn metashape_s_lenses_that_no_rig_file_has_are_refused() {
    for (from, to, expected) in [
        ("<b1>10</b1>", "<k4>0.1</k4>", "k4 of 0.1 is of r⁸"),
        (
            "<b1>10</b1>",
            "<p3>0.1</p3>",
            "the key `p3` of its calibration is not known",
        ),
        (
            "<f>300</f>",
            "<f>300</f><p1>0.1</p1>",
            "a fisheye with p1 and p2 cannot be expressed",
        ),
        (
            r#"<calibration type="fisheye""#,
            r#"<calibration type="spherical""#,
            "is not known",
        ),
        (
            r#"component_id="0" label="right"#,
            r#"component_id="1" label="right"#,
            "of one component",
        ),
    ] {
        let text = METASHAPE.replace(from, to);
        assert_ne!(text, METASHAPE);
        let error = refusal(&[("cameras.xml", &text)], &scaled(0.1));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn without_a_scale_the_unit_is_asked_for() {
    let text = METASHAPE.replace("<scale>0.1</scale>", "");
    let error = refusal(&[("cameras.xml", &text)], &Options::default());
    assert!(error.contains("`unit` (--unit"), "{error}");
}
