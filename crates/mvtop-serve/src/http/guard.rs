//! What goes around every request: its id, who may ask, and how errors are told.

use std::net::IpAddr;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde_json::json;
use subtle::ConstantTimeEq;

use super::pages;
use crate::accept::Known;
use crate::config::{Config, is_local};
use crate::problem::{Kind, Problem};
use crate::service::Service;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longest id that is taken over.
const LONGEST_ID: usize = 128;
/// Paths that tell no more than that there is a service.
const OPEN: [&str; 2] = ["/healthz", "/readyz"];

/// Id of a request, the client's or a new one.
#[derive(Clone)]
pub struct RequestId(pub String);

pub async fn guard(
    State(service): State<Arc<Service>>,
    mut request: Request,
    next: Next,
) -> Response {
    let id = request_id(request.headers()).unwrap_or_else(|| service.next_id());
    request.extensions_mut().insert(RequestId(id.clone()));
    let mut response = match may(service.config(), &request) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    if let Some(problem) = response.extensions_mut().remove::<Problem>() {
        let told = json!({"error": {
            "code": problem.kind.code(),
            "message": problem.message,
            "request_id": id,
        }});
        let headers = std::mem::take(response.headers_mut());
        let mut body = (response.status(), Json(told)).into_response();
        for (name, value) in headers.iter() {
            if name != header::CONTENT_LENGTH && name != header::CONTENT_TYPE {
                body.headers_mut().insert(name.clone(), value.clone());
            }
        }
        response = body;
    }
    let headers = response.headers_mut();
    if let Ok(id) = HeaderValue::from_str(&id) {
        headers.insert(REQUEST_ID, id);
    }
    for (name, value) in [
        // The page has nothing from elsewhere, and no other page may show it.
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'self'; img-src 'self' blob:; frame-ancestors 'none'; form-action 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn request_id(headers: &HeaderMap) -> Option<String> {
    let id = headers.get(REQUEST_ID)?.to_str().ok()?;
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.:".contains(c);
    let valid = (1..=LONGEST_ID).contains(&id.len()) && id.chars().all(plain);
    valid.then(|| id.to_owned())
}

/// Refuses whom the service is not for.
fn may(config: &Config, request: &Request) -> Result<(), Problem> {
    let headers = request.headers();
    let host = text(headers, header::HOST)?.unwrap_or_default();
    let asked = request
        .uri()
        .authority()
        .map_or(host, |asked| asked.as_str());
    if !asked.eq_ignore_ascii_case(host) {
        return Err(Problem::bad(format!(
            "expected a request to `{host}`, as its header `Host` says, got one to `{asked}`; ask by the path alone"
        )));
    }
    // Pages of other hosts that a browser has open can reach this service, by its number or by a name of
    // theirs that leads here.
    if config.token.is_none() && !is_own(host, &config.host) {
        let expected = match config.is_local() {
            true => "localhost or 127.0.0.1",
            false => "an IP address or a name without a dot",
        };
        return Err(Problem::new(
            Kind::Forbidden,
            format!(
                "expected a request to {expected}, got one to `{host}`; name the interface with --host, or set a token"
            ),
        ));
    }
    if let Some(origin) = text(headers, header::ORIGIN)? {
        let from = origin.split_once("://").map_or(origin, |(_, from)| from);
        if from != host {
            return Err(Problem::new(
                Kind::Forbidden,
                format!(
                    "expected a request of this service's own page, got one of `{origin}`; send it from a program"
                ),
            ));
        }
    }
    let path = request.uri().path();
    if let Some(token) = &config.token {
        if OPEN.contains(&path) || pages::has(path) {
            return Ok(());
        }
        let shown = text(headers, header::AUTHORIZATION)?;
        let shown = shown.and_then(|value| value.strip_prefix("Bearer "));
        if !shown.is_some_and(|shown| is_token(shown, token)) {
            let message = "expected the header `Authorization: Bearer TOKEN` with this service's token; ask who runs it";
            return Err(Problem::new(Kind::Unauthorized, message));
        }
    }
    if let Some(known) = request.extensions().get::<Known>() {
        known.note();
    }
    Ok(())
}

/// A header that is there once at most, in plain text: others might read another one of several.
fn text(headers: &HeaderMap, name: HeaderName) -> Result<Option<&str>, Problem> {
    let mut all = headers.get_all(&name).iter();
    let value = all.next().map(HeaderValue::to_str).transpose();
    match (value, all.next()) {
        (Ok(value), None) => Ok(value),
        (Ok(_), Some(_)) => Err(Problem::bad(format!(
            "expected one header `{name}`, got several"
        ))),
        (Err(_), _) => Err(Problem::bad(format!(
            "header `{name}`: expected plain ASCII"
        ))),
    }
}

/// Compares in a time that does not tell where they differ.
pub fn is_token(shown: &str, token: &str) -> bool {
    shown.as_bytes().ct_eq(token.as_bytes()).into()
}

/// Whether a `Host` is one that nobody elsewhere can have led here: a number, or a name that is not in the
/// public directory.
///
/// - `listened`: name or address of the interface that is listened on
fn is_own(host: &str, listened: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|c| c.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    if is_local(listened) {
        return is_local(name);
    }
    let is_plain = !name.is_empty() && !name.contains('.');
    is_plain || name == listened || name.parse::<IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_this_machine_are_told_from_others() {
        let (local, elsewhere) = ("127.0.0.1", "example.org");
        for (host, of_local, of_network) in [
            ("localhost", true, true),
            ("localhost:8080", true, true),
            ("127.0.0.1:1", true, true),
            ("[::1]:8080", true, true),
            ("[::1]", true, true),
            ("10.0.0.1:8080", false, true),
            ("[fd00::1]:8080", false, true),
            ("cell-7:8080", false, true),
            ("example.org:8080", false, true),
            ("", false, false),
            (":8080", false, false),
            ("other.example.org", false, false),
            ("localhost.example.org:8080", false, false),
            ("127.0.0.1.example.org", false, false),
            ("cell-7.:8080", false, false),
        ] {
            assert_eq!(is_own(host, local), of_local, "{host}");
            assert_eq!(is_own(host, elsewhere), of_network, "{host}");
        }
    }

    #[test]
    fn only_plain_ids_are_taken_over() {
        let id = |text: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(REQUEST_ID, HeaderValue::from_str(text).unwrap());
            request_id(&headers)
        };
        assert_eq!(id("cell-3:17").as_deref(), Some("cell-3:17"));
        assert_eq!(id("a b"), None);
        assert_eq!(id(&"a".repeat(200)), None);
    }
}
