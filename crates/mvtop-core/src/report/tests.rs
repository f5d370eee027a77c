use super::*;
use crate::prediction::RigConsistency;
use crate::{Intrinsics, Projection};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

#[test]
fn quarter_turn_seen_by_two_cameras_is_written_as_documented() {
    let camera = |id: &str| {
        let intrinsics = Intrinsics::new(9., 9., 4., 3., Projection::Pinhole).unwrap();
        Camera::new(id, [8, 6], intrinsics, Isometry3::identity()).unwrap()
    };
    let rig = Rig::new(vec![camera("left"), camera("right")], 0).unwrap();
    let quarter_turn =
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let pose = Isometry3::from_parts(Translation3::new(1., 2., 3.), quarter_turn);
    let seen = |camera, bbox| CameraPose {
        camera,
        cam_from_obj: pose,
        bbox,
    };
    let prediction = Prediction {
        reference: 1,
        objects: vec![ObjectPose {
            class: "mvball".into(),
            class_id: 1,
            score: 0.5,
            ref_from_obj: pose,
            world_from_obj: Isometry3::identity(),
            sigma: Sigma {
                rot_deg: 4.0,
                t_m: 0.01,
            },
            deviation: None,
            coordinate_inliers: Some(0.625),
            refinement: Some(Refinement {
                accepted: true,
                contour_inliers: 0.75,
                contour_residual_px: 0.5,
                color_separation: 0.25,
                mutual_information: 0.125,
                mutual_information_min: 0.0625,
                texture_correlation: None,
                initial_sigma: Sigma {
                    rot_deg: 6.0,
                    t_m: 0.02,
                },
            }),
            confidence: Some(0.875),
            evidence: Some(Scored {
                log_odds: 2.0,
                initial_log_odds: 1.5,
                terms: std::array::from_fn(|term| term as f64),
                views: vec![ViewEvidence {
                    view: 0,
                    visible: 0.5,
                    detector: 0.0,
                    coordinates: 0.1,
                    contour: 0.2,
                    color: 0.3,
                    mutual_information: 0.4,
                    texture: 0.5,
                }],
                ..Scored::default()
            }),
            hypotheses: vec![Hypothesis {
                world_from_obj: pose,
                sigma: Sigma {
                    rot_deg: 3.0,
                    t_m: 0.01,
                },
                probability: 0.75,
            }],
            next_view: Some(0),
            symmetry: Symmetry {
                discrete: vec![Isometry3::identity(); 5],
                axis: None,
            },
            cameras: vec![seen(0, Some([1., 2., 3., 4.].into())), seen(1, None)],
            track_id: None,
        }],
        timings: Timings {
            total: 7.0,
            ..Timings::default()
        },
        model: "models/one".into(),
        provider: "cpu".into(),
        rig_consistency: Some(RigConsistency {
            px: 1.5,
            deviation: 0.5,
            camera_deviation: 0.25,
            scale_deviation: 0.125,
            box_deviation: 0.75,
            contradiction: -1.0,
            confirmed: 3,
            unconfirmed: 1,
            worst_camera: None,
        }),
        warnings: vec![
            Warning {
                code: WarningCode::OneColor,
                camera: Some(1),
                object: None,
                message: "dark".into(),
            },
            Warning {
                code: WarningCode::LinesMiss,
                camera: None,
                object: Some(0),
                message: "beside".into(),
            },
        ],
        near_misses: Vec::new(),
    };
    let json = serde_json::to_value(Report::new(&prediction, &rig)).unwrap();

    assert_eq!(json["schema_version"], 1);
    assert_eq!(json["reference"], "right");
    assert_eq!(json["timings_ms"]["total"], 7.0);
    assert_eq!(json["model"], "models/one");
    assert_eq!(json["provider"], "cpu");
    assert_eq!(
        json["warnings"],
        serde_json::json!([
            {"code": "one_color", "camera": "right", "object": null, "message": "dark"},
            {"code": "lines_miss", "camera": null, "object": 0, "message": "beside"}
        ])
    );
    assert_eq!(
        json["rig_consistency"],
        serde_json::json!({
            "px": 1.5, "deviation": 0.5, "camera_deviation": 0.25, "scale_deviation": 0.125,
            "box_deviation": 0.75, "contradiction": -1.0, "confirmed": 3, "unconfirmed": 1,
            "worst_camera": null
        })
    );
    let object = &json["objects"][0];
    assert_eq!(object["class"], "mvball");
    assert_eq!(
        object["symmetry"],
        serde_json::json!({"poses": 6, "axis": null})
    );
    assert_eq!(
        object["refinement"],
        serde_json::json!({
            "accepted": true, "contour_inliers": 0.75, "contour_residual_px": 0.5,
            "color_separation": 0.25, "mutual_information": 0.125,
            "mutual_information_min": 0.0625, "texture_correlation": null,
            "initial_sigma": {"rot_deg": 6.0, "t_m": 0.02}
        })
    );
    assert_eq!(object["confidence"], 0.875);
    assert_eq!(object["next_view"], "left");
    let hypothesis = &object["hypotheses"][0];
    assert_eq!(hypothesis["probability"], 0.75);
    assert_eq!(hypothesis["T_world_obj"][2][3], 3.0);
    let evidence = &object["evidence"];
    assert_eq!(evidence["log_odds"], 2.0);
    assert_eq!(
        evidence["pose"].as_object().unwrap().len(),
        POSE_TERMS.len()
    );
    assert_eq!(evidence["pose"]["prior"], 0.0);
    assert_eq!(evidence["pose"]["rig_deviation"], 7.0);
    assert_eq!(
        evidence["views"],
        serde_json::json!([{
            "visible": 0.5, "detector": 0.0, "coordinates": 0.1, "contour": 0.2, "color": 0.3,
            "mutual_information": 0.4, "texture": 0.5
        }])
    );
    assert_eq!(object["t_m"], serde_json::json!([1.0, 2.0, 3.0]));
    assert_eq!(
        object["T_world_obj"][0],
        serde_json::json!([1.0, 0.0, 0.0, 0.0])
    );
    // Rows: the object's x axis points along y, its y axis along -x.
    let number = |row: usize, column: usize| object["T_ref_obj"][row][column].as_f64().unwrap();
    assert!((number(1, 0) - 1.0).abs() < 1e-12 && (number(0, 1) + 1.0).abs() < 1e-12);
    assert_eq!([number(0, 3), number(1, 3), number(2, 3)], [1.0, 2.0, 3.0]);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (i, expected) in [half, 0.0, 0.0, half].into_iter().enumerate() {
        assert!((object["q_wxyz"][i].as_f64().unwrap() - expected).abs() < 1e-12);
    }
    assert_eq!(
        object["cameras"][0]["box"],
        serde_json::json!([1.0, 2.0, 3.0, 4.0])
    );
    assert_eq!(object["cameras"][0]["detected"], true);
    assert_eq!(object["cameras"][1]["id"], "right");
    assert_eq!(object["cameras"][1]["box"], serde_json::Value::Null);
    assert_eq!(object["cameras"][1]["detected"], false);

    // All keys, and their order.
    let mut rounded = serde_json::to_value(Report::new(&prediction, &rig)).unwrap();
    round(&mut rounded);
    insta::assert_json_snapshot!(rounded);
}

/// Numbers to 9 digits after the point, without -0.
fn round(value: &mut serde_json::Value) {
    use serde_json::Value;
    match value {
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or_default();
            *value = ((number * 1e9).round() / 1e9 + 0.0).into();
        }
        Value::Array(all) => all.iter_mut().for_each(round),
        Value::Object(all) => all.values_mut().for_each(round),
        _ => {}
    }
}
