//! The page, in files of its own that the program carries: nothing comes from elsewhere.

use std::sync::{Arc, LazyLock};

use axum::Router;
use axum::http::header;
use axum::routing::get;
use mvtop_core::schema;
use serde_json::Value;

use crate::service::Service;

/// Paths; the schemas of requests and predictions are made of their types.
static OPENAPI: LazyLock<String> = LazyLock::new(|| {
    let paths = include_str!("../page/openapi.json");
    let mut api: Value = serde_json::from_str(paths).expect("a test reads it");
    if let Some(schemas) = api["components"]["schemas"].as_object_mut() {
        schemas.extend(schema::components());
    }
    format!("{api:#}\n")
});

/// Path, type and text of each file.
const FILES: [(&str, &str, &str); 6] = [
    ("/", HTML, include_str!("../page/index.html")),
    ("/try", HTML, include_str!("../page/try.html")),
    (
        "/page.css",
        "text/css; charset=utf-8",
        include_str!("../page/page.css"),
    ),
    ("/page.js", SCRIPT, include_str!("../page/page.js")),
    ("/scene.js", SCRIPT, include_str!("../page/scene.js")),
    ("/try.js", SCRIPT, include_str!("../page/try.js")),
];

const OPENAPI_PATH: &str = "/openapi.json";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

pub fn router() -> Router<Arc<Service>> {
    let add = |router: Router<Arc<Service>>, (path, kind, text)| {
        router.route(
            path,
            get(async move || ([(header::CONTENT_TYPE, kind)], text)),
        )
    };
    let api = get(async || {
        (
            [(header::CONTENT_TYPE, "application/json")],
            OPENAPI.as_str(),
        )
    });
    FILES
        .into_iter()
        .fold(Router::new(), add)
        .route(OPENAPI_PATH, api)
}

/// Whether a path is a file of the page.
pub fn has(path: &str) -> bool {
    path == OPENAPI_PATH || FILES.iter().any(|(file, _, _)| *file == path)
}
