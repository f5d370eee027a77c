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

/// Path, type and text of a file.
type File = (&'static str, &'static str, fn() -> &'static str);

const FILES: [File; 7] = [
    ("/", HTML, || include_str!("../page/index.html")),
    ("/try", HTML, || include_str!("../page/try.html")),
    ("/page.css", STYLE, || include_str!("../page/page.css")),
    ("/page.js", SCRIPT, || include_str!("../page/page.js")),
    ("/scene.js", SCRIPT, || include_str!("../page/scene.js")),
    ("/try.js", SCRIPT, || include_str!("../page/try.js")),
    ("/openapi.json", "application/json", || OPENAPI.as_str()),
];

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

pub fn router() -> Router<Arc<Service>> {
    let add = |router: Router<Arc<Service>>, (path, kind, text): File| {
        router.route(
            path,
            get(async move || ([(header::CONTENT_TYPE, kind)], text())),
        )
    };
    FILES.into_iter().fold(Router::new(), add)
}

/// Whether a path is a file of the page.
pub fn has(path: &str) -> bool {
    FILES.iter().any(|(file, _, _)| *file == path)
}
