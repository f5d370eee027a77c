//! Poses as a service: over HTTP with a page to look at, and over a line protocol for robot controllers.
//!
//! Models and rigs are loaded once. An exposure, one image of each camera, is decoded where it arrives and
//! waits in a bounded queue for the one thread that predicts: a prediction uses all cores by itself, so two
//! at once would only delay each other. Start reading at [`run`], then `service`.

mod accept;
mod client;
mod config;
mod exposure;
mod history;
mod http;
mod line;
mod log;
mod metrics;
mod pictures;
mod problem;
mod queue;
mod record;
mod service;
mod station;
mod streams;

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use tokio::net::TcpListener;
#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

pub use crate::config::{Config, Line, Record};
use crate::service::Service;

/// Threads that talk to clients: predictions have one of their own.
const TALKING_THREADS: usize = 2;
/// Threads that decode images, draw pictures and read files.
const BLOCKING_THREADS: usize = 4;
/// How long clients have to read their answers once all work is done and nobody may connect any more.
const GRACE: Duration = Duration::from_secs(5);

/// Serves until the process is told to end (SIGTERM or SIGINT), and finishes what runs then.
///
/// - `announce`: is told, one line each, where the service listens and when it is ready
///
/// # Errors
/// One sentence, where a rig or a model is refused, its self-test fails, or the port cannot be had.
pub fn run(config: Config, announce: impl Fn(&str) + Send + Sync + 'static) -> Result<(), String> {
    let service = Arc::new(Service::new(config)?);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(TALKING_THREADS)
        .max_blocking_threads(BLOCKING_THREADS)
        .enable_all()
        .build()
        .map_err(|cause| format!("cannot start threads: {cause}"))?;
    let served = runtime.block_on(serve(&service, Arc::new(announce)));
    // Of clients that would not end, none is waited for.
    runtime.shutdown_timeout(Duration::from_secs(1));
    service.finish();
    served
}

async fn serve(
    service: &Arc<Service>,
    announce: Arc<dyn Fn(&str) + Send + Sync>,
) -> Result<(), String> {
    let mut ends = Ends::new()?;
    let (stop, stopped) = watch::channel(false);
    let config = service.config();
    let http = listener(&config.host, config.port).await?;
    announce(&format!("listening on http://{}/", address(&http)?));
    let line = match &config.line {
        Some(line) => {
            let line = listener(&config.host, line.port).await?;
            announce(&format!("lines on {}", address(&line)?));
            Some(line)
        }
        None => None,
    };
    if config.is_open() {
        announce("warning: anyone who reaches this port may use it; set a token with --token-file");
    }
    let (failed, mut failure) = watch::channel(None);
    let loading = service.clone();
    thread::spawn(move || match loading.load() {
        Ok(()) => announce("ready"),
        Err(problem) => {
            let _ = failed.send(Some(problem));
        }
    });
    let http = tokio::spawn(http::serve(service.clone(), http, stopped.clone()));
    let line = line.map(|line| tokio::spawn(line::serve(service.clone(), line, stopped)));
    let refused = tokio::select! {
        () = ends.next() => None,
        Ok(()) = failure.changed() => failure.borrow().clone(),
    };
    service.stop();
    let _ = stop.send(true);
    let finished = async {
        let _ = http.await;
        if let Some(line) = line {
            let _ = line.await;
        }
    };
    let told = async {
        // What runs ends with its time.
        let _ = tokio::time::timeout(config.request_time, service.worked_off()).await;
        tokio::time::sleep(GRACE).await;
    };
    tokio::select! {
        () = finished => {}
        () = told => {}
        // Told twice, it does not wait.
        () = ends.next() => {}
    }
    refused.map_or(Ok(()), Err)
}

/// The signals that end the service.
#[cfg(unix)]
struct Ends {
    terminate: Signal,
    interrupt: Signal,
}

#[cfg(unix)]
impl Ends {
    fn new() -> Result<Self, String> {
        let signal =
            |kind| signal(kind).map_err(|cause| format!("cannot wait for signals: {cause}"));
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

/// Ctrl-C, which ends the service.
#[cfg(not(unix))]
struct Ends;

#[cfg(not(unix))]
impl Ends {
    fn new() -> Result<Self, String> {
        Ok(Self)
    }

    async fn next(&mut self) {
        let _ = tokio::signal::ctrl_c().await;
    }
}

async fn listener(host: &str, port: u16) -> Result<TcpListener, String> {
    TcpListener::bind((host, port)).await.map_err(|cause| {
        format!(
            "cannot listen on {host}, port {port}: {cause}; name another port, or stop what has it"
        )
    })
}

fn address(listener: &TcpListener) -> Result<SocketAddr, String> {
    let address = listener.local_addr();
    address.map_err(|cause| format!("cannot tell the address of a port: {cause}"))
}
