//! HTTP: connections, and what answers which path.

mod guard;
mod pages;
mod predict;
mod unread;
mod views;

pub use self::guard::is_token;

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request};
use axum::http::{StatusCode, header};
use axum::middleware::{from_fn_with_state, map_request};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::accept::{self, Known};
use crate::client::Client;
use crate::problem::{Kind, Problem};
use crate::service::Service;

/// Connections at once; further ones wait to be accepted.
const MOST_CONNECTIONS: usize = 256;
/// How long a client may take to send a request's head, and stay connected without one.
const HEAD_TIME: Duration = Duration::from_secs(30);

/// Serves until `stopped`, then until all requests are answered.
pub async fn serve(service: Arc<Service>, listener: TcpListener, stopped: watch::Receiver<bool>) {
    let app = TowerToHyperService::new(router(service));
    let talk = |client, known| talk(app.clone(), client, known, stopped.clone());
    accept::each(listener, MOST_CONNECTIONS, stopped.clone(), talk).await;
}

async fn talk(
    app: TowerToHyperService<Router>,
    client: Client,
    known: Known,
    mut stopped: watch::Receiver<bool>,
) {
    let app = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(known.clone());
        app.call(request)
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME);
    let mut connection = pin!(http.serve_connection(TokioIo::new(client), app));
    tokio::select! {
        // What a client does to its connection is its own matter.
        _ = &mut connection => return,
        _ = stopped.changed() => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = connection.await;
}

fn router(service: Arc<Service>) -> Router {
    let most = service.config().max_body;
    Router::new()
        .route("/v1/predict", post(predict::predict))
        .layer(DefaultBodyLimit::max(most))
        .route("/v1/info", get(views::info))
        .route("/v1/rigs/{name}", get(views::rig))
        .route("/v1/models/{name}", get(views::model))
        .route("/v1/exposures", get(views::exposures))
        .route("/v1/exposures/{number}", get(views::exposure))
        .route("/v1/exposures/{number}/views/{camera}", get(views::picture))
        .route("/healthz", get(views::healthz))
        .route("/readyz", get(views::readyz))
        .route("/metrics", get(views::metrics))
        .merge(pages::router())
        .fallback(async || Problem::new(Kind::NotFound, "no such path; /openapi.json lists all"))
        .method_not_allowed_fallback(async || {
            Problem::new(
                Kind::NotAllowed,
                "no such method of this path; /openapi.json lists all",
            )
        })
        .layer(from_fn_with_state(service.clone(), guard::guard))
        .layer(map_request(unread::read_rest))
        .with_state(service)
}

impl IntoResponse for Problem {
    /// Without a body: [`guard::guard`] writes it, which knows the request's id.
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.kind.status());
        let mut response = status
            .unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
            .into_response();
        if let Some(seconds) = self.kind.retry_after() {
            response
                .headers_mut()
                .insert(header::RETRY_AFTER, seconds.into());
        }
        if self.kind == Kind::Unauthorized {
            let scheme = header::HeaderValue::from_static("Bearer");
            response
                .headers_mut()
                .insert(header::WWW_AUTHENTICATE, scheme);
        }
        response.extensions_mut().insert(self);
        response
    }
}
