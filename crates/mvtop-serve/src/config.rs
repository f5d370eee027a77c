//! What is served, where, and within which bounds.

use std::path::PathBuf;
use std::time::Duration;

use mvtop_core::Options;

/// How the service runs. Sizes are bytes.
pub struct Config {
    /// Name or address of the interface that is listened on, `127.0.0.1` for this machine alone.
    pub host: String,
    /// Port of HTTP; 0 for any that is free.
    pub port: u16,
    /// Models by name, each with its bundle's folder; the first is used where none is asked for.
    pub models: Vec<(String, PathBuf)>,
    /// How networks are run.
    pub options: Options,
    /// Rigs by name, each with its file; the first is used where none is asked for.
    pub rigs: Vec<(String, PathBuf)>,
    /// World frame to the robot's base frame, for requests that do not say.
    pub base_from_world: Option<[[f64; 4]; 4]>,
    /// What clients must show, if anything.
    pub token: Option<String>,
    /// Exposures that may wait while one is worked on.
    pub waiting: usize,
    /// Largest body of a request.
    pub max_body: usize,
    /// How long a client may take to send its images.
    pub body_time: Duration,
    /// How long an exposure may take, waiting included, before the client is told so.
    pub request_time: Duration,
    /// Images that are kept in memory for the page.
    pub history_bytes: usize,
    /// Where doubtful exposures are kept.
    pub record: Option<Record>,
    /// The line protocol.
    pub line: Option<Line>,
}

impl Config {
    /// Whether others than this machine's users may use the service without a token.
    pub(crate) fn is_open(&self) -> bool {
        self.token.is_none() && !self.is_local()
    }

    /// Whether this machine alone reaches the service.
    pub(crate) fn is_local(&self) -> bool {
        is_local(&self.host)
    }
}

/// Whether a name or an address is that of a machine for itself.
pub(crate) fn is_local(host: &str) -> bool {
    let address = host.parse::<std::net::IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.is_loopback())
}

/// Exposures that are kept for a look: those that failed, gave nothing or were not certain.
pub struct Record {
    /// Folder, made where it is not there.
    pub dir: PathBuf,
    /// Most exposures; the oldest ones make way.
    pub most: usize,
    /// Most bytes of all, likewise.
    pub most_bytes: u64,
    /// Confidence below which a pose is not certain, where the request names none.
    pub below: f64,
}

/// The line protocol over TCP.
pub struct Line {
    /// Port; 0 for any that is free.
    pub port: u16,
    /// Folder where a camera program puts images, named after cameras, for `FIND`.
    pub images: Option<PathBuf>,
}
