//! The configuration.

use super::*;

#[test]
fn configuration_survives_json_and_may_be_partial() {
    let all = RefineConfig::default();
    let text = serde_json::to_string(&all).unwrap();
    assert_eq!(serde_json::from_str::<RefineConfig>(&text).unwrap(), all);
    let text = r#"{"correlated_lines": 2.0, "texture": {"min_correlation": 0.5}}"#;
    let partial: RefineConfig = serde_json::from_str(text).unwrap();
    let texture = TextureConfig {
        min_correlation: 0.5,
        ..TextureConfig::default()
    };
    let expected = RefineConfig {
        correlated_lines: 2.0,
        texture,
        ..all
    };
    assert_eq!(partial, expected);
    assert!(serde_json::from_str::<RefineConfig>(r#"{"corelated_lines": 2.0}"#).is_err());
}

#[test]
fn configured_numbers_are_used() {
    let (mesh, camera, mut draw) = (cuboid(), camera(70.0), Draw(4));
    let truth = Isometry3::from_parts(Translation3::identity(), draw.rotation(3.0));
    let image = seen(&mesh, &camera, &truth, &mut draw);
    let view = View {
        camera: &camera,
        image: &Pyramid::new(&image),
    };
    let inliers = |inlier_px: f64, contour_points: f64| {
        let config = RefineConfig {
            inlier_px: [inlier_px, 2.0],
            contour_points,
            ..RefineConfig::default()
        };
        let refiner = Refiner::with_config(&mesh, 0.13, config);
        let edges = refiner.edges(&view, &truth);
        let near = edges.iter().filter(|edge| edge.is_inlier).count();
        [near, edges.len()]
    };
    let [few, all] = inliers(0.2, 220.0);
    let [most, same] = inliers(1.5, 220.0);
    assert!(few < most && all == same, "{few} and {most} of {all}");
    let [_, half] = inliers(1.5, 110.0);
    assert!(
        (half as f64 / all as f64 - 0.5).abs() < 0.05,
        "{half} of {all}"
    );
}

#[test]
fn unusable_numbers_are_refused() {
    let default = RefineConfig::default;
    assert_eq!(default().check(), Ok(()));
    let with = |change: fn(&mut RefineConfig)| {
        let mut config = default();
        change(&mut config);
        config.check()
    };
    assert!(with(|config| config.inlier_px[1] = f64::NAN).is_err());
    assert!(with(|config| config.correlated_lines = 0.0).is_err());
    assert!(with(|config| config.coarse.side_px = [224.0, 96.0]).is_err());
    assert!(with(|config| config.fine.steps_px.clear()).is_err());
    assert!(with(|config| config.function_amplitude = 0.5).is_err());
    let text = with(|config| config.texture.search_deg[0] = [24.0, 0.0]).unwrap_err();
    assert!(
        text.contains("search_deg") && text.contains("above 0"),
        "{text}"
    );
}
