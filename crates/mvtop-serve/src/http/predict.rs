//! `POST /v1/predict`: images in, poses out.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::multipart::{Field, Multipart, MultipartError, MultipartRejection};
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, State};
use axum::http::header;
use axum::response::{AppendHeaders, IntoResponse, Response};
use mvtop_core::{Request, Rig};

use super::guard::RequestId;
use crate::exposure::{Exposure, Layout, Upload};
use crate::log;
use crate::problem::{self, Kind, Problem};
use crate::service::{Asked, Service};

/// Name of the part that holds the request as JSON.
const REQUEST: &str = "request";
/// Largest request as JSON, bytes: it is kept with its exposure.
const MOST_JSON: usize = 256 << 10;
/// Settings of the query that say where a request belongs.
const NAMES: [&str; 3] = ["model", "rig", "stream"];
/// How long a client waits for others to have sent their images.
const UPLOAD_WAIT: Duration = Duration::from_secs(5);

/// Settings by name, in the order of the query.
type Settings = Vec<(String, String)>;

pub async fn predict(
    State(service): State<Arc<Service>>,
    Extension(RequestId(id)): Extension<RequestId>,
    query: Result<Query<Settings>, QueryRejection>,
    parts: Result<Multipart, MultipartRejection>,
) -> Result<Response, Problem> {
    let mut counted = service.metrics.request();
    let done = answer(&service, id.clone(), query, parts).await;
    match done {
        Ok(exposure) => {
            counted.outcome = "ok";
            log::line(&format!("{id} ok {:.0} ms", exposure.took_ms));
            Ok(told(&exposure))
        }
        Err(problem) => {
            counted.outcome = problem.kind.code();
            log::line(&format!("{id} {} {}", problem.kind.code(), problem.message));
            Err(problem)
        }
    }
}

fn told(exposure: &Exposure) -> Response {
    let found = match &exposure.outcome {
        Ok(found) => found,
        // Not one that is answered.
        Err(problem) => return Problem::new(Kind::Internal, problem).into_response(),
    };
    let headers = [
        (header::CONTENT_TYPE.as_str(), "application/json".to_owned()),
        ("x-mvtop-exposure", exposure.number.to_string()),
        ("x-mvtop-accepted", found.accepted.to_string()),
    ];
    let count = found.stream_exposures;
    let of_stream = count.map(|count| ("x-mvtop-stream-exposures", count.to_string()));
    (headers, AppendHeaders(of_stream), found.json.clone()).into_response()
}

async fn answer(
    service: &Arc<Service>,
    id: String,
    query: Result<Query<Settings>, QueryRejection>,
    parts: Result<Multipart, MultipartRejection>,
) -> Result<Arc<Exposure>, Problem> {
    let began = Instant::now();
    let Query(settings) =
        query.map_err(|error| Problem::bad(format!("query: {}", error.body_text())))?;
    let mut seen = Vec::new();
    for (name, _) in &settings {
        problem::check_once(name, &mut seen)?;
    }
    let named = |what: &str| {
        let found = settings.iter().find(|(name, _)| name == what);
        found.map(|(_, value)| value.as_str())
    };
    let (model, rig) = (service.model(named("model"))?, service.rig(named("rig"))?);
    let parts = parts.map_err(|error| {
        Problem::bad(format!(
            "body: expected multipart/form-data with an image for each camera, got: {}",
            error.body_text()
        ))
    })?;
    let upload = tokio::time::timeout(UPLOAD_WAIT, service.uploads.clone().acquire_owned()).await;
    let Ok(Ok(upload)) = upload else {
        let message = "too many clients send images at once; send this again later";
        return Err(Problem::new(Kind::Busy, message));
    };
    let time = service.config().body_time;
    let read = read(parts, &service.rigs()[rig].rig, service.config().max_body);
    let read = tokio::time::timeout(time, read).await.map_err(|_| {
        let seconds = time.as_secs();
        Problem::new(
            Kind::TooSlow,
            format!(
                "body: expected all of it within {seconds} s; raise --body-seconds, or send less"
            ),
        )
    })?;
    let (mut request, uploads) = read?;
    drop(upload);
    for (name, value) in &settings {
        if !NAMES.contains(&name.as_str()) {
            problem::check_setting(name, &NAMES)?;
            request.set(name, value)?;
        }
    }
    let place = service.enter()?;
    let asked = Asked {
        id,
        model,
        rig,
        stream: named("stream").map(str::to_owned),
        request,
        began,
    };
    service.expose(place, asked, uploads).await
}

/// The request and the images of a body.
async fn read(
    mut parts: Multipart,
    rig: &Rig,
    most: usize,
) -> Result<(Request, Vec<Upload>), Problem> {
    let wrong = |error: MultipartError| match error.status().as_u16() {
        413 => Problem::new(
            Kind::TooLarge,
            format!(
                "body: expected {most} bytes at most; raise --max-body-mb, or send smaller images"
            ),
        ),
        _ => Problem::bad(format!(
            "body: expected multipart/form-data, got: {}",
            error.body_text()
        )),
    };
    let mut request: Option<Request> = None;
    let mut uploads: Vec<Upload> = Vec::new();
    while let Some(mut part) = parts.next_field().await.map_err(wrong)? {
        let name = part.name().unwrap_or_default().to_owned();
        if name == REQUEST && rig.index_of(REQUEST).is_none() {
            if request.is_some() {
                return Err(Problem::bad(
                    "part `request`: expected it once, got it twice",
                ));
            }
            let mut json = Vec::new();
            while let Some(chunk) = part.chunk().await.map_err(wrong)? {
                json.extend_from_slice(&chunk);
                if json.len() > MOST_JSON {
                    let message = format!("part `request`: expected {MOST_JSON} bytes at most");
                    return Err(Problem::new(Kind::TooLarge, message));
                }
            }
            let text = String::from_utf8(json)
                .map_err(|_| Problem::bad("part `request`: expected JSON in UTF-8"))?;
            request = Some(Request::from_json(&text)?);
            continue;
        }
        let camera = rig.find(&format!("part `{name}`"), &name)?;
        if uploads.iter().any(|upload| upload.camera == camera) {
            return Err(Problem::bad(format!(
                "camera `{name}`: expected one image, got two"
            )));
        }
        let layout = Layout::of(content_type(&part));
        let bytes = part.bytes().await.map_err(wrong)?;
        uploads.push(Upload {
            camera,
            bytes,
            layout,
        });
    }
    if uploads.is_empty() {
        let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
        return Err(Problem::bad(format!(
            "body: expected an image as a part that is named after its camera ({}), got none",
            ids.join(", ")
        )));
    }
    // The order in which they came is to change nothing.
    uploads.sort_by_key(|upload| upload.camera);
    Ok((request.unwrap_or_default(), uploads))
}

fn content_type<'a>(part: &'a Field) -> Option<&'a str> {
    part.content_type()
}
