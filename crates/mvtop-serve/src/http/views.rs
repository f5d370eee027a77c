//! What the page and a monitor read.

use std::sync::Arc;
use std::time::UNIX_EPOCH;

use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use mvtop_core::bundle::Class;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::exposure::Exposure;
use crate::history::Entry;
use crate::pictures;
use crate::problem::{Checked, Kind, Problem};
use crate::service::Service;
use crate::station::{self, Model};

type Served = State<Arc<Service>>;

/// Points of a class that the page draws.
const MOST_POINTS: usize = 400;

pub async fn healthz() -> &'static str {
    "alive\n"
}

pub async fn readyz(State(service): Served) -> Result<&'static str, Problem> {
    service.models().map(|_| "ready\n")
}

pub async fn metrics(State(service): Served) -> Response {
    let (queue, streams) = (service.queue_length(), service.streams());
    let text = service
        .metrics
        .text(queue, streams, service.models().is_ok());
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

/// What is served, and within which bounds.
pub async fn info(State(service): Served) -> Json<Value> {
    let config = service.config();
    let models: Vec<&str> = config
        .models
        .iter()
        .map(|(name, _)| name.as_str())
        .collect();
    let rigs: Vec<&str> = config.rigs.iter().map(|(name, _)| name.as_str()).collect();
    Json(json!({
        "mvtop": env!("CARGO_PKG_VERSION"),
        "ready": service.models().is_ok(),
        "models": models,
        "rigs": rigs,
        "settings": mvtop_core::request::SETTINGS,
        "frames": {"base": config.base_from_world.is_some()},
        "waiting": config.waiting,
        "max_body_bytes": config.max_body,
    }))
}

/// A rig as its file says, in metres.
pub async fn rig(
    State(service): Served,
    Checked(Path(name)): Checked<Path<String>>,
) -> Result<Response, Problem> {
    let rig = service.rig(Some(&name)).map_err(not_found)?;
    let json = service.rigs()[rig].rig.to_json();
    Ok(([(header::CONTENT_TYPE, "application/json")], json).into_response())
}

/// A model's classes, with points to draw.
pub async fn model(
    State(service): Served,
    Checked(Path(name)): Checked<Path<String>>,
) -> Result<Json<Value>, Problem> {
    let model = &service.models()?[service.model(Some(&name)).map_err(not_found)?];
    let class = |class: &Class| {
        let step = class.points.len().div_ceil(MOST_POINTS).max(1);
        let points = class.points.iter().step_by(step);
        let points: Vec<Value> = points
            .map(|p| json!({"at": p.position, "color": p.color}))
            .collect();
        json!({"name": class.name, "id": class.id, "diameter_m": class.diameter_m, "points": points})
    };
    Ok(Json(json!({
        "name": model.name,
        "classes": model.bundle().classes.iter().map(class).collect::<Vec<_>>(),
        "calibrated": model.bundle().scorer.is_some(),
        "grasps": model.grasps.is_some(),
    })))
}

fn not_found(problem: Problem) -> Problem {
    match problem.kind {
        Kind::BadRequest => Problem::new(Kind::NotFound, problem.message),
        _ => problem,
    }
}

#[derive(Deserialize)]
pub struct After {
    /// Number of an exposure; only later ones are listed.
    #[serde(default)]
    after: String,
}

/// The last exposures, the newest first.
pub async fn exposures(
    State(service): Served,
    Checked(Query(query)): Checked<Query<After>>,
) -> Result<Json<Value>, Problem> {
    let after = match query.after.as_str() {
        "" => 0,
        number => parse(number)?,
    };
    let history = service.history();
    let later = history
        .entries()
        .take_while(|entry| entry.exposure.number > after);
    let all: Vec<Value> = later.map(|entry| summary(&service, entry)).collect();
    Ok(Json(json!({"exposures": all})))
}

/// One of them, with its answer.
pub async fn exposure(
    State(service): Served,
    Checked(Path(number)): Checked<Path<String>>,
) -> Result<Json<Value>, Problem> {
    let entry = find(&service, &number)?;
    let mut told = summary(&service, &entry);
    told["request"] = json!(entry.exposure.request);
    told["answer"] = match &entry.exposure.outcome {
        Ok(found) => serde_json::from_str(&found.json).unwrap_or_default(),
        Err(_) => Value::Null,
    };
    Ok(Json(told))
}

fn summary(service: &Service, entry: &Entry) -> Value {
    let Exposure {
        number,
        id,
        time,
        model,
        rig,
        stream,
        took_ms,
        outcome,
        ..
    } = &*entry.exposure;
    let found = outcome.as_ref().ok();
    let rig = &service.rigs()[*rig];
    let uploads = entry.uploads.iter().flat_map(|uploads| uploads.iter());
    let cameras: Vec<&str> = uploads
        .map(|upload| rig.rig.cameras()[upload.camera].id())
        .collect();
    json!({
        "number": number,
        "request_id": id,
        "unix_ms": time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64),
        "model": service.config().models[*model].0,
        "rig": rig.name,
        "stream": stream,
        "took_ms": took_ms,
        "objects": found.map_or(0, |found| found.prediction.objects.len()),
        "least_confidence": found.and_then(|found| found.least_confidence()),
        "warnings": found.map_or(0, |found| found.prediction.warnings.len()),
        "accepted": found.map(|found| found.accepted),
        "error": outcome.as_ref().err(),
        // Those whose pictures can be had.
        "cameras": cameras,
    })
}

/// A view as JPEG, with the poses drawn into it.
pub async fn picture(
    State(service): Served,
    Checked(Path((number, camera))): Checked<Path<(String, String)>>,
) -> Result<Response, Problem> {
    let entry = find(&service, &number)?;
    let gone = || {
        Problem::new(
            Kind::NotFound,
            "this exposure's images are no longer in memory; --history-mb keeps more",
        )
    };
    let uploads = entry.uploads.clone().ok_or_else(gone)?;
    let drawn = tokio::task::spawn_blocking(move || {
        let Exposure {
            model,
            rig,
            outcome,
            ..
        } = &*entry.exposure;
        let rig = &service.rigs()[*rig];
        let cameras = rig.rig.cameras().iter().map(|camera| camera.id());
        let camera = station::find("camera", Some(&camera), cameras).map_err(not_found)?;
        let upload = uploads.iter().find(|upload| upload.camera == camera);
        let upload =
            upload.ok_or_else(|| Problem::new(Kind::NotFound, "this camera gave no image"))?;
        let model: &Model = &service.models()?[*model];
        let found = outcome.as_ref().ok();
        pictures::jpeg(upload, rig, found.map(|found| (model, &found.prediction)))
    });
    let failed = |cause| Problem::new(Kind::Internal, format!("cannot draw a picture: {cause}"));
    let jpeg = drawn.await.map_err(failed)??;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

fn find(service: &Service, number: &str) -> Result<Entry, Problem> {
    let number = parse(number)?;
    service.history().get(number).ok_or_else(|| {
        let message =
            format!("no exposure {number} among the last hundred; /v1/exposures lists them");
        Problem::new(Kind::NotFound, message)
    })
}

fn parse(number: &str) -> Result<u64, Problem> {
    let wrong = |_| {
        Problem::bad(format!(
            "expected the number of an exposure, got `{number}`"
        ))
    };
    number.parse().map_err(wrong)
}
