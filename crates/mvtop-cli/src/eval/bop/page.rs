//! `report.html`: one file with the numbers, plots and the worst poses as pictures.

use std::io::Cursor;

use askama::Template;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use mvtop_core::ViewImage;
use mvtop_core::overlay::{Drawn, Shape, contact_sheet, draw, draw_truth};
use mvtop_eval::runner::bop::{COLUMNS, InSight, Line, Plan, Results, Scored};
use mvtop_eval::runner::{self, Bounds};
use nalgebra::{Isometry3, Matrix4};
use serde_json::Value;

use crate::failure::{Failure, Result};
use crate::plot::{histogram, recall_curves};
use crate::write;

/// Poses that are drawn.
const WORST: usize = 6;
/// Widest picture, px.
const PICTURE_WIDTH: u32 = 1200;
const JPEG_QUALITY: u8 = 80;

#[derive(Template)]
#[template(path = "bop.html")]
struct Page<'a> {
    dataset: &'a str,
    split: &'a str,
    columns: Vec<&'static str>,
    rows: Vec<(String, Vec<String>)>,
    bounds: Bounds,
    confidence_columns: [&'static str; 5],
    by_confidence: Vec<[String; 5]>,
    in_sight_columns: [&'static str; 4],
    in_sight: Vec<[String; 4]>,
    /// SVG.
    plots: [String; 5],
    worst: Vec<Worst>,
    settings: Vec<(&'a String, &'a Value)>,
}

/// A pose that is far off.
struct Worst {
    what: String,
    /// JPEG in base64, all views; empty where the object or its group is asked for no more.
    picture: String,
}

/// - `about`: what was evaluated
pub fn page(about: &Value, results: &Results, lines: &[Line], plan: &Plan) -> Result<String> {
    let cells = |scores| COLUMNS.iter().map(|c| (c.cell)(scores)).collect();
    let rows = results.rows(&plan.classes);
    let page = Page {
        dataset: about["dataset"].as_str().unwrap_or_default(),
        split: about["split"].as_str().unwrap_or_default(),
        columns: COLUMNS.iter().map(|column| column.name).collect(),
        rows: rows.into_iter().map(|(name, s)| (name, cells(s))).collect(),
        bounds: results.summary.bounds,
        confidence_columns: runner::COLUMNS,
        by_confidence: results.summary.by_confidence(),
        in_sight_columns: InSight::COLUMNS,
        in_sight: results
            .by_views_in_sight
            .iter()
            .map(InSight::cells)
            .collect(),
        plots: plots(lines)?,
        worst: worst(lines, plan)?,
        settings: about.as_object().into_iter().flatten().collect(),
    };
    write::template(&page)
}

fn plots(lines: &[Line]) -> Result<[String; 5]> {
    let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
    let found = |error: fn(&Scored) -> Option<f64>, unit: f64| -> Vec<f64> {
        let errors = scored.iter().filter_map(|s| error(s));
        errors.map(|x| x * unit).collect()
    };
    // Objects that were not found are infinitely wrong.
    let all = |error: fn(&Scored) -> Option<f64>, unit: fn(&Scored) -> f64| -> Vec<f64> {
        let errors = scored
            .iter()
            .map(|s| (error(s).unwrap_or(f64::INFINITY), unit(s)));
        errors.map(|(error, unit)| error / unit).collect()
    };
    let (mm, diameters) = (|_: &Scored| 1e-3, |s: &Scored| s.diameter_m);
    let [rotation, translation, add] = [
        found(|s| s.outcome.rot_deg, 1.0),
        found(|s| s.outcome.trans_m, 1e3),
        found(|s| s.outcome.add_m, 1e3),
    ];
    let in_mm = [
        ("ADD", all(|s| s.outcome.add_m, mm)),
        ("ADD-S", all(|s| s.add_s_m, mm)),
    ];
    let in_diameters = [
        ("ADD-(S)", all(Scored::add_or_add_s, diameters)),
        ("MSSD", all(|s| s.mssd_m, diameters)),
    ];
    Ok([
        histogram("Rotation error", "degrees", &rotation)?,
        histogram("Translation error", "mm", &translation)?,
        histogram("ADD", "mm", &add)?,
        recall_curves("Recall", "threshold, mm", 100.0, &in_mm)?,
        recall_curves("Recall", "threshold, diameters", 0.5, &in_diameters)?,
    ])
}

/// The objects that are farthest off, drawn into all their views.
fn worst(lines: &[Line], plan: &Plan) -> Result<Vec<Worst>> {
    let objects = lines
        .iter()
        .flat_map(|line| line.objects.iter().map(move |s| (line, s)));
    let mut objects: Vec<(&Line, &Scored)> = objects.collect();
    objects.sort_by(|a, b| b.1.badness().total_cmp(&a.1.badness()));
    let worst = objects.into_iter().take(WORST).map(|(line, scored)| {
        let error = match scored.add_or_add_s() {
            Some(error) => format!("ADD-(S) {:.1} mm", error * 1e3),
            None => "not found".into(),
        };
        let rotation = scored.outcome.rot_deg;
        let rotation = rotation.map_or(String::new(), |deg| format!(", rotation off by {deg:.1}°"));
        Ok(Worst {
            what: format!("{} {}: {error}{rotation}", line.group, scored.outcome.class),
            picture: picture(line, scored, plan)?,
        })
    });
    worst.collect()
}

fn picture(line: &Line, scored: &Scored, plan: &Plan) -> Result<String> {
    let Some(group) = plan.group(&line.group) else {
        return Ok(String::new());
    };
    let sample = plan.load(group)?;
    let (Some(known), Some(model)) = (
        sample.truth.get(scored.outcome.object),
        plan.models.get(&scored.obj_id),
    ) else {
        return Ok(String::new());
    };
    let predicted = scored.outcome.t_world_obj.map(|rows| {
        let matrix = Matrix4::from_fn(|i, j| rows[i][j]);
        nalgebra::try_convert::<_, Isometry3<f64>>(matrix)
    });
    let views: Vec<image::RgbImage> = sample
        .images
        .iter()
        .map(|ViewImage { camera, image }| {
            let camera = &sample.rig.cameras()[*camera];
            let drawn = predicted.flatten().map(|world_from_obj| Drawn {
                cam_from_obj: camera.world_from_cam().inv_mul(&world_from_obj),
                shape: Shape::Mesh(&model.mesh),
                diameter_m: model.diameter_m,
                bbox: None,
                label: scored.outcome.class.clone(),
                instance: 0,
            });
            let image = draw(image, camera, drawn.as_slice());
            draw_truth(&image, camera, &known.world_from_obj, model.diameter_m)
        })
        .collect();
    let mut sheet = contact_sheet(&views);
    if sheet.width() > PICTURE_WIDTH {
        let height = (sheet.height() * PICTURE_WIDTH / sheet.width()).max(1);
        sheet = resize(&sheet, PICTURE_WIDTH, height, FilterType::Triangle);
    }
    let mut jpeg = Cursor::new(Vec::new());
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
        .encode_image(&sheet)
        .map_err(|cause| Failure(format!("cannot encode a picture: {cause}")))?;
    Ok(BASE64_STANDARD.encode(jpeg.into_inner()))
}
