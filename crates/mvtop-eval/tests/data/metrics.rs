//! Metrics against what the BOP toolkit gives (`export/fixtures/metrics.py`), and cases worked by hand.

use mvtop_core::{Intrinsics, Projection};
use mvtop_eval::metrics::{
    BOP_MAX_STEP, ContinuousSymmetry, MatchingCost, Surface, Symmetries, VsdOptions,
    rotation_error_deg, translation_error, vsd,
};
use nalgebra::{
    Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3,
};
use ndarray::{Array2, Array3, Axis};
use safetensors::SafeTensors;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use super::{brown_conrady, pinhole};

const CASES: [&str; 5] = ["plain", "far", "discrete", "continuous", "both"];

struct Fixture(Vec<u8>);

impl Fixture {
    fn load() -> Self {
        Self::of("metrics.safetensors")
    }

    fn of(name: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
        Self(std::fs::read(path.join(name)).unwrap())
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let data = file
            .tensor(name)
            .unwrap_or_else(|_| panic!("no tensor `{name}`"));
        let bytes = data.data().chunks_exact(8);
        bytes
            .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
            .collect()
    }

    fn points(&self, name: &str) -> Vec<Point3<f64>> {
        let numbers = self.numbers(name);
        numbers.chunks_exact(3).map(Point3::from_slice).collect()
    }

    fn motions(&self, name: &str) -> Vec<Isometry3<f64>> {
        self.numbers(name).chunks_exact(16).map(motion).collect()
    }

    fn intrinsics(&self, name: &str) -> Intrinsics {
        let [fx, fy, cx, cy] = self.numbers(name)[..] else {
            panic!("{name}")
        };
        Intrinsics::new(fx, fy, cx, cy, Projection::Pinhole).unwrap()
    }

    fn symmetries(&self, case: &str) -> Symmetries {
        let axes = self.points(&format!("{case}.axes"));
        let offsets = self.points(&format!("{case}.offsets"));
        let continuous: Vec<ContinuousSymmetry> = axes
            .iter()
            .zip(offsets)
            .map(|(axis, offset)| ContinuousSymmetry {
                axis: Unit::new_normalize(axis.coords),
                offset,
            })
            .collect();
        let discrete = self.motions(&format!("{case}.discrete"));
        let step = self.numbers(&format!("{case}.step"))[0];
        Symmetries::new(&discrete, &continuous, step).unwrap()
    }
}

fn motion(rows: &[f64]) -> Isometry3<f64> {
    let rotation = Matrix3::from_fn(|i, j| rows[4 * i + j]);
    Isometry3::from_parts(
        Translation3::new(rows[3], rows[7], rows[11]),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
    )
}

#[test]
fn symmetries_are_those_of_the_toolkit() {
    let fixture = Fixture::load();
    for case in CASES {
        let symmetries = fixture.symmetries(case);
        let expected = fixture.motions(&format!("{case}.symmetries"));
        assert_eq!(symmetries.motions().len(), expected.len(), "{case}");
        assert_eq!(symmetries.is_symmetric(), expected.len() > 1);
        for (ours, theirs) in symmetries.motions().iter().zip(&expected) {
            let off = (ours.to_homogeneous() - theirs.to_homogeneous()).amax();
            assert!(off < 1e-9, "{case}: off by {off:e}");
        }
    }
    // The case with BOP's own step.
    assert_eq!(fixture.numbers("continuous.step"), [BOP_MAX_STEP]);
    assert_eq!(fixture.symmetries("continuous").motions().len(), 315);
}

#[test]
fn errors_are_those_of_the_toolkit() {
    let fixture = Fixture::load();
    let mut compared = 0;
    for case in CASES {
        let surface = Surface::new(&fixture.points(&format!("{case}.points"))).unwrap();
        let symmetries = fixture.symmetries(case);
        let intrinsics = fixture.intrinsics(&format!("{case}.lens"));
        let truths = fixture.motions(&format!("{case}.truth"));
        let estimates = fixture.motions(&format!("{case}.estimate"));
        let none = Symmetries::default();
        type Error<'a> = &'a dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> f64;
        let kinds: [(&str, Error); 8] = [
            ("add", &|t, e| surface.add(t, e)),
            ("adi", &|t, e| surface.add_s(t, e)),
            ("mssd", &|t, e| surface.mssd(t, e, &symmetries)),
            ("mspd", &|t, e| surface.mspd(t, e, &symmetries, &intrinsics)),
            ("re", &|t, e| rotation_error_deg(t, e, &none)),
            ("te", &|t, e| translation_error(t, e, &none)),
            ("re_symmetric", &|t, e| {
                rotation_error_deg(t, e, &symmetries)
            }),
            ("te_symmetric", &|t, e| translation_error(t, e, &symmetries)),
        ];
        for (kind, error) in kinds {
            let expected = fixture.numbers(&format!("{case}.{kind}"));
            let mut worst: f64 = 0.0;
            for ((truth, estimate), expected) in truths.iter().zip(&estimates).zip(expected) {
                worst = worst.max((error(truth, estimate) - expected).abs());
                compared += 1;
            }
            println!("{case} {kind}: at most {worst:.1e}");
            assert!(worst < 1e-6, "{case} {kind}: off by {worst:e}");
        }
    }
    assert_eq!(compared, CASES.len() * 8 * 12);
}

#[test]
fn add_is_that_of_the_training() {
    let fixture = Fixture::of("pose.safetensors");
    let surface = Surface::new(&fixture.points("points")).unwrap();
    let rotations = fixture.numbers("rotation");
    let poses: Vec<Isometry3<f64>> = rotations
        .chunks_exact(9)
        .zip(fixture.points("translation"))
        .map(|(r, t)| {
            motion(&[
                r[0], r[1], r[2], t.x, r[3], r[4], r[5], t.y, r[6], r[7], r[8], t.z,
            ])
        })
        .collect();
    let expected = fixture.numbers("add");
    assert!(!expected.is_empty());
    for (i, expected) in expected.iter().enumerate() {
        let before = &poses[(i + poses.len() - 1) % poses.len()];
        let add = surface.add(&poses[i], before);
        assert!((add - expected).abs() < 1e-12, "{i}: {add} {expected}");
    }
}

#[test]
fn add_by_hand() {
    let points = [[1., 0., 0.], [0., 2., 0.], [0., 0., 0.]];
    let surface = Surface::new(&points.map(Point3::from)).unwrap();
    let truth = Isometry3::identity();
    let moved = Isometry3::translation(0.0, 3.0, 4.0);
    assert_eq!(surface.add(&truth, &moved), 5.0);
    // Half a turn about z moves the points by 2, 4 and 0.
    let turned = Isometry3::rotation(Vector3::z() * PI);
    assert!((surface.add(&truth, &turned) - 2.0).abs() < 1e-12);
}

#[test]
fn vsd_is_that_of_the_toolkit() {
    let fixture = Fixture::load();
    let file = SafeTensors::deserialize(&fixture.0).unwrap();
    let images = |name: &str| -> Vec<Array2<f32>> {
        let tensor = file.tensor(name).unwrap();
        let bytes = tensor.data().chunks_exact(4);
        let numbers = bytes
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        let &[n, height, width] = tensor.shape() else {
            panic!("{name}")
        };
        let images = Array3::from_shape_vec((n, height, width), numbers).unwrap();
        images
            .axis_iter(Axis(0))
            .map(|image| image.to_owned())
            .collect()
    };
    let [estimates, truths, measured] = ["vsd.estimate", "vsd.truth", "vsd.measured"].map(images);
    let intrinsics = fixture.intrinsics("vsd.lens");
    let taus = fixture.numbers("vsd.taus");
    let diameter = fixture.numbers("vsd.diameter")[0];
    let step = VsdOptions {
        delta: fixture.numbers("vsd.delta")[0],
        taus: taus.clone(),
        diameter: Some(diameter),
        cost: MatchingCost::Step,
    };
    let linear = VsdOptions {
        cost: MatchingCost::TruncatedLinear,
        ..step.clone()
    };
    let in_mm = VsdOptions {
        taus: taus.iter().map(|tau| tau * 200.0).collect(),
        diameter: None,
        ..step.clone()
    };
    for (name, options) in [("step", step), ("tlinear", linear), ("step_mm", in_mm)] {
        let expected = fixture.numbers(&format!("vsd.{name}"));
        assert_eq!(expected.len(), truths.len() * taus.len());
        for (i, expected) in expected.chunks_exact(taus.len()).enumerate() {
            let ours = vsd(
                &estimates[i],
                &truths[i],
                &measured[i],
                &intrinsics,
                &options,
            )
            .unwrap();
            for (ours, theirs) in ours.iter().zip(expected) {
                assert!((ours - theirs).abs() < 1e-6, "{name} {i}: {ours} {theirs}");
            }
        }
    }
}

#[test]
fn vsd_of_one_row_by_hand() {
    // Pixels: both poses alike; 30 mm apart; only one of them; hidden in both; neither.
    let row = |depths: [f32; 5]| Array2::from_shape_vec((1, 5), depths.to_vec()).unwrap();
    let truth = row([1000., 1000., 1000., 1000., 0.]);
    let estimate = row([1000., 1030., 0., 1000., 0.]);
    let measured = row([1000., 0., 1000., 500., 800.]);
    // So long a lens that distances are depths.
    let intrinsics = pinhole(1e6, 2.0, 0.0);
    let mut options = VsdOptions {
        delta: 15.0,
        taus: vec![0.1, 0.2],
        diameter: Some(200.0),
        cost: MatchingCost::Step,
    };
    let step = vsd(&estimate, &truth, &measured, &intrinsics, &options).unwrap();
    // Off by 0.15 diameters in one of three visible pixels, and one that only the truth covers.
    assert_eq!(step, [2.0 / 3.0, 1.0 / 3.0]);
    options.cost = MatchingCost::TruncatedLinear;
    let linear = vsd(&estimate, &truth, &measured, &intrinsics, &options).unwrap();
    assert_eq!(linear[0], 2.0 / 3.0);
    assert!((linear[1] - 1.75 / 3.0).abs() < 1e-9, "{linear:?}");
    let nothing = row([0.0; 5]);
    assert_eq!(
        vsd(&nothing, &nothing, &measured, &intrinsics, &options).unwrap(),
        [1.0, 1.0]
    );
    let other = Array2::zeros((2, 5));
    let error = vsd(&estimate, &truth, &other, &intrinsics, &options).unwrap_err();
    assert!(error.to_string().contains("5x2 (measured)"), "{error}");
}

#[test]
fn a_square_turned_by_a_quarter_by_hand() {
    let corners = [[1., 1., 0.], [-1., 1., 0.], [-1., -1., 0.], [1., -1., 0.]];
    let surface = Surface::new(&corners.map(Point3::from)).unwrap();
    let turn = |angle: f64| Isometry3::rotation(Vector3::z() * angle);
    let truth = Isometry3::translation(0., 0., 5.);
    let quarter = truth * turn(FRAC_PI_2);
    assert!((surface.add(&truth, &quarter) - 2.0).abs() < 1e-12);
    assert!(surface.add_s(&truth, &quarter) < 1e-12);
    assert_eq!(
        surface.add_or_add_s(&truth, &quarter, true),
        surface.add_s(&truth, &quarter)
    );
    assert_eq!(
        surface.add_or_add_s(&truth, &quarter, false),
        surface.add(&truth, &quarter)
    );
    let none = Symmetries::default();
    let half = Symmetries::new(&[turn(PI)], &[], BOP_MAX_STEP).unwrap();
    let quarters: Vec<_> = [1., 2., 3.].map(|n| turn(n * FRAC_PI_2)).to_vec();
    let quarters = Symmetries::new(&quarters, &[], BOP_MAX_STEP).unwrap();
    let intrinsics = pinhole(100.0, 0.0, 0.0);
    for (symmetries, mssd) in [(&none, 2.0), (&half, 2.0), (&quarters, 0.0)] {
        assert!((surface.mssd(&truth, &quarter, symmetries) - mssd).abs() < 1e-7);
        // 2 m at 5 m and 100 px.
        let mspd = surface.mspd(&truth, &quarter, symmetries, &intrinsics);
        assert!((mspd - 20.0 * mssd).abs() < 1e-6, "{mspd}");
        let rotation = rotation_error_deg(&truth, &quarter, symmetries);
        assert!((rotation - 45.0 * mssd).abs() < 1e-5, "{rotation}");
    }
    // An axis beside the origin: half a turn about x = 1 moves the origin to x = 2.
    let beside = ContinuousSymmetry {
        axis: Vector3::z_axis(),
        offset: Point3::new(1., 0., 0.),
    };
    let beside = Symmetries::new(&[], &[beside], PI / 2.0).unwrap();
    assert_eq!(beside.motions().len(), 2);
    let moved = truth * Isometry3::translation(2., 0., 0.);
    assert!(translation_error(&truth, &moved, &beside) < 1e-12);
    assert_eq!(translation_error(&truth, &moved, &none), 2.0);
}

#[test]
fn mspd_goes_through_the_true_lens_and_not_behind_the_camera() {
    let surface = Surface::new(&[Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.2, 0.0)]).unwrap();
    let (truth, estimate) = (
        Isometry3::translation(0., 0., 1.),
        Isometry3::translation(0.05, 0., 1.1),
    );
    let none = Symmetries::default();
    let plain = pinhole(500.0, 320.0, 240.0);
    let bent = |k1| {
        let projection = brown_conrady(&[k1, 0.0, 0.0, 0.0]);
        Intrinsics::new(500.0, 500.0, 320.0, 240.0, projection).unwrap()
    };
    let straight = surface.mspd(&truth, &estimate, &none, &plain);
    // With next to no distortion the general way must give what the pinhole's gives.
    assert!((surface.mspd(&truth, &estimate, &none, &bent(1e-16)) - straight).abs() < 1e-9);
    let bent = bent(-0.3);
    assert!((surface.mspd(&truth, &estimate, &none, &bent) - straight).abs() > 0.1);
    let behind = Isometry3::translation(0., 0., -1.);
    for intrinsics in [&plain, &bent] {
        assert_eq!(
            surface.mspd(&behind, &estimate, &none, intrinsics),
            f64::INFINITY
        );
        assert_eq!(
            surface.mspd(&truth, &behind, &none, intrinsics),
            f64::INFINITY
        );
    }
}

#[test]
fn surfaces_and_steps_that_cannot_be_are_refused() {
    let error = Surface::new(&[]).unwrap_err().to_string();
    assert!(error.contains("at least one point"), "{error}");
    let error = Surface::new(&[Point3::new(0., f64::INFINITY, 0.)]).unwrap_err();
    assert!(error.to_string().contains("point 0"), "{error}");
    for step in [0.0, -1.0, f64::NAN, 4.0] {
        let error = Symmetries::new(&[], &[], step).unwrap_err().to_string();
        assert!(error.contains("largest step"), "{error}");
    }
}
