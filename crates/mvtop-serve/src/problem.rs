//! Why a request is not answered: one sentence for people, a code for programs.

use std::fmt;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use mvtop_core::error::printable;
use mvtop_core::request::SETTINGS;
use mvtop_core::{Error, ErrorKind};

/// Characters of a message, at most.
const LONGEST: usize = 2000;

/// What went wrong, as HTTP and lines tell it.
#[derive(Debug, Clone)]
pub struct Problem {
    pub kind: Kind,
    /// The thing, what was expected, what came, and the fix.
    pub message: String,
}

/// Kinds of [`Problem`]; their codes stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    BadRequest,
    Unauthorized,
    Forbidden,
    NotFound,
    NotAllowed,
    TooSlow,
    TooLarge,
    Internal,
    NotReady,
    Busy,
    TimedOut,
}

impl Kind {
    pub fn code(self) -> &'static str {
        self.told().0
    }

    /// Of HTTP.
    pub fn status(self) -> u16 {
        self.told().1
    }

    fn told(self) -> (&'static str, u16) {
        match self {
            Self::BadRequest => ("bad_request", 400),
            Self::Unauthorized => ("unauthorized", 401),
            Self::Forbidden => ("forbidden", 403),
            Self::NotFound => ("not_found", 404),
            Self::NotAllowed => ("not_allowed", 405),
            Self::TooSlow => ("too_slow", 408),
            Self::TooLarge => ("too_large", 413),
            Self::Internal => ("internal", 500),
            Self::NotReady => ("not_ready", 503),
            Self::Busy => ("busy", 503),
            Self::TimedOut => ("timed_out", 504),
        }
    }

    /// After how many seconds it is worth trying again, if it is.
    pub fn retry_after(self) -> Option<u32> {
        matches!(self, Self::NotReady | Self::Busy).then_some(1)
    }
}

impl Problem {
    pub fn new(kind: Kind, message: impl fmt::Display) -> Self {
        let mut message = printable(&message.to_string());
        // What clients send is a part of it.
        if let Some((end, _)) = message.char_indices().nth(LONGEST) {
            message.truncate(end);
            message.push_str(" ...");
        }
        Self { kind, message }
    }

    pub fn bad(message: impl fmt::Display) -> Self {
        Self::new(Kind::BadRequest, message)
    }
}

/// A part of a request, refused as a [`Problem`] where it cannot be read.
pub struct Checked<E>(pub E);

impl<S, E> FromRequestParts<S> for Checked<E>
where
    S: Send + Sync,
    E: FromRequestParts<S>,
    E::Rejection: fmt::Display,
{
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let read = E::from_request_parts(parts, state).await;
        read.map(Self).map_err(Problem::bad)
    }
}

/// Refuses the name of a setting that a request does not have.
///
/// - `others`: further names that are accepted where it came from
pub fn check_setting(name: &str, others: &[&str]) -> Result<(), Problem> {
    let known = || others.iter().chain(&SETTINGS).copied();
    if known().any(|known| known == name) {
        return Ok(());
    }
    let known: Vec<&str> = known().collect();
    Err(Problem::bad(format!(
        "`{name}`: no such setting, expected one of: {}",
        known.join(", ")
    )))
}

/// Refuses a setting that is there twice.
///
/// - `seen`: those before it
pub fn check_once(name: &str, seen: &mut Vec<String>) -> Result<(), Problem> {
    if seen.iter().any(|one| one == name) {
        return Err(Problem::bad(format!(
            "`{name}`: expected it once, got it twice; leave one out"
        )));
    }
    seen.push(name.to_owned());
    Ok(())
}

impl From<Error> for Problem {
    fn from(error: Error) -> Self {
        let kind = match error.kind() {
            ErrorKind::Interrupted => {
                let message = "ended before it was done: its time was over, or its client had gone";
                return Self::new(Kind::TimedOut, message);
            }
            ErrorKind::Runtime
            | ErrorKind::Provider
            | ErrorKind::Network
            | ErrorKind::Bundle
            | ErrorKind::Pose
            | ErrorKind::Shape => Kind::Internal,
            _ => Kind::BadRequest,
        };
        Self::new(kind, error)
    }
}

impl From<mvtop_geometry::Error> for Problem {
    fn from(error: mvtop_geometry::Error) -> Self {
        Error::from(error).into()
    }
}
