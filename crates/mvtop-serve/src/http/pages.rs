//! The page, in files of its own that the program carries: nothing comes from elsewhere.

use std::sync::Arc;

use axum::Router;
use axum::http::header;
use axum::routing::get;

use crate::service::Service;

/// Path, type and text of each file.
const FILES: [(&str, &str, &str); 7] = [
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
    (
        "/openapi.json",
        "application/json",
        include_str!("../page/openapi.json"),
    ),
];

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

pub fn router() -> Router<Arc<Service>> {
    let add = |router: Router<Arc<Service>>, (path, kind, text)| {
        router.route(
            path,
            get(async move || ([(header::CONTENT_TYPE, kind)], text)),
        )
    };
    FILES.into_iter().fold(Router::new(), add)
}

/// Whether a path is a file of the page.
pub fn has(path: &str) -> bool {
    FILES.iter().any(|(file, _, _)| *file == path)
}
