//! `report.html`: one file with the numbers, plots and the worst poses as pictures.

use std::fmt::Write;
use std::io::Cursor;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use mvtop_core::ViewImage;
use mvtop_core::overlay::{Drawn, contact_sheet, draw, draw_truth};
use nalgebra::{Isometry3, Matrix4};
use serde_json::Value;

use super::dataset::Results;
use super::journal::Line;
use super::plan::Plan;
use super::plot::{histogram, recall_curves};
use super::score::{Areas, Scored, Scores};
use crate::failure::{Failure, Result};
use crate::svg::escape;

/// Poses that are drawn.
const WORST: usize = 6;
/// Widest picture, px.
const PICTURE_WIDTH: u32 = 1200;
const JPEG_QUALITY: u8 = 80;

const STYLE: &str = "body{font:14px sans-serif;margin:24px;max-width:1240px}\
    table{border-collapse:collapse;margin:12px 0}td,th{border:1px solid #ccc;padding:3px 8px;\
    text-align:right}th{background:#f4f4f4}td:first-child,th:first-child{text-align:left}\
    svg{margin:4px}img{max-width:100%;display:block;margin:4px 0 20px}";

/// - `about`: what was evaluated
pub fn page(about: &Value, results: &Results, lines: &[Line], plan: &Plan) -> Result<String> {
    let scored: Vec<&Scored> = lines.iter().flat_map(|line| &line.objects).collect();
    let found = |error: &dyn Fn(&Scored) -> Option<f64>, unit: f64| -> Vec<f64> {
        let errors = scored.iter().filter_map(|s| error(s));
        errors.map(|x| x * unit).collect()
    };
    let all = |error: &dyn Fn(&Scored) -> Option<f64>, in_diameters: bool| -> Vec<f64> {
        let unit = |s: &Scored| if in_diameters { s.diameter_m } else { 1e-3 };
        let errors = scored.iter();
        errors
            .map(|s| error(s).unwrap_or(f64::INFINITY) / unit(s))
            .collect()
    };
    let plots = [
        histogram(
            "Rotation error",
            "degrees",
            &found(&|s| s.outcome.rot_deg, 1.0),
        ),
        histogram(
            "Translation error",
            "mm",
            &found(&|s| s.outcome.trans_m, 1e3),
        ),
        histogram("ADD", "mm", &found(&|s| s.outcome.add_m, 1e3)),
        recall_curves(
            "Recall",
            "threshold, mm",
            100.0,
            &[
                ("ADD", all(&|s| s.outcome.add_m, false)),
                ("ADD-S", all(&|s| s.add_s_m, false)),
            ],
        ),
        recall_curves(
            "Recall",
            "threshold, diameters",
            0.5,
            &[
                ("ADD-(S)", all(&Scored::add_or_add_s, true)),
                ("MSSD", all(&|s| s.mssd_m, true)),
            ],
        ),
    ];
    let mut html = format!(
        "<!DOCTYPE html><html lang=\"en\"><meta charset=\"utf-8\"><title>mvtop: {0} {1}</title>\
         <style>{STYLE}</style><h1>{0}, {1}</h1>",
        escape(about["dataset"].as_str().unwrap_or_default()),
        escape(about["split"].as_str().unwrap_or_default())
    );
    html += &table(plan, results);
    html += "<p>Objects that were not found count as wrong, except in medians and histograms. \
             Recall: error below 0.1 diameters. AUC: up to 0.1 m, as PoseCNN computes it. \
             ADD-(S): ADD-S for objects with symmetries. AR: mean recall over BOP's thresholds. \
             Rotation errors are the least over the object's symmetries.</p>";
    html += &plots.concat();
    html += &worst(lines, plan)?;
    html += "<h2>Settings</h2><table>";
    for (key, value) in about.as_object().into_iter().flatten() {
        let value = escape(&value.to_string());
        let _ = write!(html, "<tr><td>{}</td><td>{value}</td></tr>", escape(key));
    }
    html += "</table></html>\n";
    Ok(html)
}

fn table(plan: &Plan, results: &Results) -> String {
    let mut html = String::from(
        "<table><tr><th>object</th><th>of truth</th><th>found</th><th>rotation, median °</th>\
         <th>translation, median mm</th><th>ADD recall</th><th>ADD-S recall</th>\
         <th>ADD-(S) recall</th><th>ADD AUC</th><th>ADD-S AUC</th><th>ADD-(S) AUC</th>\
         <th>AR MSSD</th><th>AR MSPD</th><th>AR VSD</th><th>AR</th></tr>",
    );
    for (id, scores) in &results.objects {
        let class = plan.classes.get(id).map_or("", |name| name);
        html += &row(&format!("{id} {}", escape(class)), scores);
    }
    html += &row("all", &results.all);
    html + "</table>"
}

fn row(name: &str, scores: &Scores) -> String {
    let percent = |x: Option<f64>| x.map_or("–".into(), |x| format!("{:.1} %", 100.0 * x));
    let number = |x: Option<f64>, unit: f64| x.map_or("–".into(), |x| format!("{:.2}", x * unit));
    let areas = [&scores.add, &scores.add_s, &scores.add_or_add_s];
    let of_areas = |pick: fn(&Areas) -> Option<f64>| areas.map(|a| percent(pick(a)));
    let [add, add_s, add_or_add_s] = of_areas(|a| a.recall_01d);
    let [auc_add, auc_add_s, auc_add_or_add_s] = of_areas(|a| a.auc_posecnn);
    let cells = [
        name.to_owned(),
        scores.objects.to_string(),
        scores.found.to_string(),
        number(scores.rot_median_deg, 1.0),
        number(scores.trans_median_m, 1e3),
        add,
        add_s,
        add_or_add_s,
        auc_add,
        auc_add_s,
        auc_add_or_add_s,
        percent(scores.ar_mssd),
        percent(scores.ar_mspd),
        percent(scores.ar_vsd),
        percent(scores.ar),
    ];
    format!("<tr><td>{}</td></tr>", cells.join("</td><td>"))
}

/// The objects that are farthest off, drawn into all their views.
fn worst(lines: &[Line], plan: &Plan) -> Result<String> {
    let objects = lines
        .iter()
        .flat_map(|line| line.objects.iter().map(move |s| (line, s)));
    let mut objects: Vec<(&Line, &Scored)> = objects.collect();
    objects.sort_by(|a, b| b.1.badness().total_cmp(&a.1.badness()));
    let mut html = String::from(
        "<h2>Worst poses</h2><p>Colored: predicted. Thin white axes that end in a dot: the \
         truth.</p>",
    );
    for (line, scored) in objects.into_iter().take(WORST) {
        let error = match scored.add_or_add_s() {
            Some(error) => format!("ADD-(S) {:.1} mm", error * 1e3),
            None => "not found".into(),
        };
        let rotation = scored.outcome.rot_deg;
        let rotation = rotation.map_or(String::new(), |deg| format!(", rotation off by {deg:.1}°"));
        let _ = write!(
            html,
            "<p>{} {}: {error}{rotation}</p>{}",
            escape(&line.group),
            escape(&scored.outcome.class),
            picture(line, scored, plan)?
        );
    }
    Ok(html)
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
                points: model.mesh.vertices(),
                diameter_m: model.diameter_m,
                bbox: None,
                label: scored.outcome.class.clone(),
            });
            let image = draw(image, camera, drawn.as_slice());
            draw_truth(&image, camera, &known.world_from_obj, model.diameter_m)
        })
        .collect();
    let mut sheet = contact_sheet(&views);
    if sheet.width() > PICTURE_WIDTH {
        let height =
            u64::from(sheet.height()) * u64::from(PICTURE_WIDTH) / u64::from(sheet.width());
        sheet = resize(
            &sheet,
            PICTURE_WIDTH,
            height.max(1) as u32,
            FilterType::Triangle,
        );
    }
    let mut jpeg = Cursor::new(Vec::new());
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
        .encode_image(&sheet)
        .map_err(|cause| Failure(format!("cannot encode a picture: {cause}")))?;
    let text = BASE64_STANDARD.encode(jpeg.into_inner());
    Ok(format!(
        "<img src=\"data:image/jpeg;base64,{text}\" alt=\"\">"
    ))
}
