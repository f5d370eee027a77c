//! How fast `mvtop_eval::leakage` is: a million poses against a hundred thousand, of 21 objects.
//!
//! ```text
//! cargo run --release -p mvtop-benches --bin leakage_speed -- out/audit
//! ```
//!
//! writes two splits in BOP layout (0.6 GB) and models into the folder, times the comparison in
//! memory and with reading, and checks that exactly the planted poses are found. Numbers after the
//! folder set how many poses each split has. The seed is fixed.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use mvtop_eval::bop::load_models;
use mvtop_eval::leakage::{Files, PoseRecord, Settings, common_objects, leakage};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

const OBJECTS: usize = 21;
/// Poses of one image, and images of one scene.
const PER_IMAGE: usize = 5;
const IMAGES: usize = 1000;
const DIAMETER_MM: f64 = 150.0;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments
        .next()
        .ok_or("usage: leakage_speed FOLDER [TEST [TRAIN]]")?;
    let folder = Path::new(&folder);
    let mut number = |default| {
        arguments
            .next()
            .map_or(Ok(default), |text| text.parse::<usize>())
    };
    let (test_poses, train_poses) = (number(100_000)?, number(1_000_000)?);

    let mut random = SplitMix(1);
    let mut train: Vec<PoseRecord> = (0..train_poses).map(|_| random.pose()).collect();
    let test: Vec<PoseRecord> = (0..test_poses).map(|_| random.pose()).collect();
    // Of ten poses of the test split, in training: two number for number, one off by less than
    // the threshold, one by more, one at the same place with another rotation, one near.
    let mut planted = 0;
    for (i, (pose, place)) in test.iter().zip(&mut train).enumerate() {
        let off = random.direction();
        *place = match i % 10 {
            0 | 1 => *pose,
            2 => shifted(pose, off * 0.009),
            3 => shifted(pose, off * 0.011),
            4 => PoseRecord {
                translation_mm: pose.translation_mm,
                ..random.pose()
            },
            5 => shifted(pose, off * (0.1 + 15.0 * random.unit())),
            _ => continue,
        };
        planted += u64::from(i % 10 < 3);
    }

    let watch = Watch::start();
    write_split(&folder.join("test"), &test)?;
    write_split(&folder.join("train"), &train)?;
    write_models(&folder.join("models"), &mut random)?;
    watch.print("written", "");

    let watch = Watch::start();
    let files = |name| Files::find(&folder.join(name));
    let (test, train) = (files("test")?, files("train")?);
    let (a, b) = (test.read(|_| ())?, train.read(|_| ())?);
    let common = common_objects(&a, &b)?;
    let models = load_models(&folder.join("models"), |id| common.contains(&id))?;
    let megabytes = (test.bytes + train.bytes) as f64 / 1e6;
    watch.print(
        "read",
        &format!("{megabytes:.0} MB, {} and {} poses", a.poses(), b.poses()),
    );

    for (name, models) in [("ADD", Some(&models)), ("rotation", None)] {
        let settings = Settings {
            within_mm: 0.01,
            limit: 1.0,
            models,
        };
        let watch = Watch::start();
        let found = leakage(&a, &b, &settings)?.total().a;
        let (recur, same) = (found.recurring, found.same_translation);
        watch.print(
            &format!("by {name}"),
            &format!("{recur} recur of {planted} planted, {same} have the same translation"),
        );
        if found.recurring != planted {
            return Err("poses were lost or invented".into());
        }
    }
    Ok(())
}

/// Prints what took how long, on the clock and, on Linux, of processor time: the latter does not
/// depend on what else the machine does.
struct Watch(Instant, Option<f64>);

impl Watch {
    fn start() -> Self {
        Self(Instant::now(), processor_s())
    }

    fn print(&self, name: &str, text: &str) {
        let clock = self.0.elapsed().as_secs_f64();
        let processor = processor_s().zip(self.1).map(|(now, then)| now - then);
        let processor = processor.map_or("?".into(), |s| format!("{s:.2}"));
        println!("{name:12} {clock:6.2} s, {processor:>5} s of processor time  {text}");
    }
}

/// User and system time of this process, seconds; from proc(5), in ticks of 10 ms.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let (_, after_name) = text.rsplit_once(')')?;
    let fields: Vec<&str> = after_name.split_whitespace().collect();
    let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}

fn shifted(pose: &PoseRecord, by_mm: Vector3<f64>) -> PoseRecord {
    PoseRecord {
        translation_mm: pose.translation_mm + by_mm,
        ..*pose
    }
}

/// Writes poses as BOP's tools do, indented, every digit.
fn write_split(folder: &Path, poses: &[PoseRecord]) -> Result<(), Failure> {
    for (scene, poses) in poses.chunks(PER_IMAGE * IMAGES).enumerate() {
        let mut text = String::from("{");
        for (image, poses) in poses.chunks(PER_IMAGE).enumerate() {
            let comma = if image > 0 { "," } else { "" };
            write!(text, "{comma}\n \"{image}\": [")?;
            for (i, pose) in poses.iter().enumerate() {
                let comma = if i > 0 { "," } else { "" };
                let place = scene * PER_IMAGE * IMAGES + image * PER_IMAGE + i;
                let list = |numbers: &mut dyn Iterator<Item = f64>| {
                    let lines: Vec<_> = numbers.map(|n| format!("\n    {n}")).collect();
                    lines.join(",")
                };
                write!(
                    text,
                    "{comma}\n  {{\n   \"cam_R_m2c\": [{}\n   ],\n   \"cam_t_m2c\": [{}\n   ],\n   \
                     \"obj_id\": {}\n  }}",
                    list(&mut pose.rotation.transpose().iter().copied()),
                    list(&mut pose.translation_mm.iter().copied()),
                    place % OBJECTS + 1
                )?;
            }
            text.push_str("\n ]");
        }
        let folder = folder.join(format!("{scene:06}"));
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join("scene_gt.json"), text + "\n}\n")?;
    }
    Ok(())
}

/// Ellipsoids of 2000 points.
fn write_models(folder: &Path, random: &mut SplitMix) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)?;
    let mut infos = BTreeMap::new();
    for id in 1..=OBJECTS {
        let axes = Vector3::new(0.5, 0.25 + 0.2 * random.unit(), 0.2 + 0.2 * random.unit());
        let mut text = String::from(
            "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\n\
             property float z\nend_header\n",
        );
        for _ in 0..2000 {
            let p = random.direction().component_mul(&axes) * DIAMETER_MM;
            writeln!(text, "{} {} {}", p.x, p.y, p.z)?;
        }
        std::fs::write(folder.join(format!("obj_{id:06}.ply")), text)?;
        infos.insert(id, serde_json::json!({"diameter": DIAMETER_MM}));
    }
    let infos = serde_json::to_string(&infos)?;
    Ok(std::fs::write(folder.join("models_info.json"), infos)?)
}

/// Steele, Lea and Flood, "Fast Splittable Pseudorandom Number Generators", 2014.
struct SplitMix(u64);

impl SplitMix {
    /// In 0 to 1.
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    /// Even over the sphere.
    fn direction(&mut self) -> Vector3<f64> {
        let (height, turn) = (2.0 * self.unit() - 1.0, self.unit() * std::f64::consts::TAU);
        let across = (1.0 - height * height).sqrt();
        Vector3::new(across * turn.cos(), across * turn.sin(), height)
    }

    /// Anywhere in a table scene's volume, in any orientation (Shoemake, 1992).
    fn pose(&mut self) -> PoseRecord {
        let [u, v, w] = [self.unit(), self.unit(), self.unit()];
        let (v, w) = (v * std::f64::consts::TAU, w * std::f64::consts::TAU);
        let (p, q) = ((1.0 - u).sqrt(), u.sqrt());
        let quaternion = Quaternion::new(q * w.cos(), p * v.sin(), p * v.cos(), q * w.sin());
        let (x, y, z) = (self.unit(), self.unit(), self.unit());
        PoseRecord {
            scene: 0,
            image: 0,
            annotation: 0,
            rotation: *UnitQuaternion::from_quaternion(quaternion)
                .to_rotation_matrix()
                .matrix(),
            translation_mm: Vector3::new(600.0 * x - 300.0, 400.0 * y - 200.0, 600.0 + 600.0 * z),
        }
    }
}
