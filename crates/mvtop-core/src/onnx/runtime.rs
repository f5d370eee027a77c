//! The loaded ONNX Runtime library.

use super::bounds::{Bounds, Unfinished, bounded};
use super::locate::{self, Candidate, Surroundings};
use super::{Provider, Session, SessionOptions, operator, trust};
use crate::{Error, Result, cancel};
use ort::environment::Environment;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

/// More threads than any machine has cores for would only take its memory.
const MOST_THREADS: usize = 1024;

/// Refuses a number of threads that no machine has cores for; 0 leaves it to who makes them.
///
/// # Errors
/// [`Error::Input`] for more than 1024.
pub fn check_threads(count: usize) -> Result<()> {
    match count {
        0..=MOST_THREADS => Ok(()),
        _ => Err(Error::Input(format!(
            "threads: expected 0 to {MOST_THREADS}, got {count}; 0 is one for each core"
        ))),
    }
}

/// The library of this process. Never dropped: ONNX Runtime allows one environment per process and
/// some versions crash when theirs is torn down during exit.
static LOADED: OnceLock<Loaded> = OnceLock::new();

#[derive(Debug)]
struct Loaded {
    environment: Environment,
    library: Candidate,
    attempts: Vec<String>,
}

/// ONNX Runtime, ready to load networks. All values share the one library of the process.
#[derive(Debug, Clone, Copy)]
pub struct Runtime {
    loaded: &'static Loaded,
}

impl Runtime {
    /// Finds and loads ONNX Runtime 1.20 or newer, or returns the one already loaded.
    ///
    /// Looked for in this order: `explicit`, `$ORT_DYLIB_PATH`, beside the executable, the
    /// environment that the executable is installed in, `$VIRTUAL_ENV`, `$CONDA_PREFIX`, the
    /// `onnxruntime` package of `python3`, the system's libraries. The first two are binding: if
    /// they do not load, nothing else is tried. A library that any user may change is never loaded,
    /// nor one that was not named and lies in the current folder or belongs to another user.
    ///
    /// The library's own telemetry is off; see `docs/explanation/security.md`.
    ///
    /// # Errors
    /// [`Error::Runtime`] when a library that was asked for cannot be loaded, is too old, or
    /// another one is loaded already; [`Error::RuntimeMissing`] when none is found.
    pub fn locate(explicit: Option<&Path>) -> Result<Self> {
        static LOADING: Mutex<()> = Mutex::new(());
        let _one_at_a_time = LOADING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(loaded) = LOADED.get() {
            return match explicit {
                Some(path) if !same_file(path, &loaded.library.path) => Err(Error::Runtime {
                    path: path.to_owned(),
                    problem: format!(
                        "this process has already loaded {}, and one process can use only one",
                        loaded.library.path.display()
                    ),
                }),
                _ => Ok(Self { loaded }),
            };
        }

        let mut attempts = Vec::new();
        for candidate in locate::candidates(explicit, Surroundings::of_process()) {
            let trusted = trust::check(&candidate);
            match trusted.and_then(|()| load(&candidate.path)) {
                Ok(environment) => {
                    let loaded = LOADED.get_or_init(|| Loaded {
                        environment,
                        library: candidate,
                        attempts,
                    });
                    return Ok(Self { loaded });
                }
                Err(problem) if candidate.binding => {
                    return Err(Error::Runtime {
                        path: candidate.path,
                        problem,
                    });
                }
                Err(problem) => attempts.push(format!(
                    "{} (from {}) {problem}",
                    candidate.path.display(),
                    candidate.found_in
                )),
            }
        }
        Err(Error::RuntimeMissing { attempts })
    }

    /// The file of the loaded library.
    pub fn library(&self) -> &Path {
        &self.loaded.library.path
    }

    /// The place of the search where the library was found.
    pub fn found_in(&self) -> &str {
        &self.loaded.library.found_in
    }

    /// The library's version, major and minor, for example `1.22`; `None` where it gives none.
    pub fn version(&self) -> Option<String> {
        ort::util::probe(self.library()).map(|minor| format!("1.{minor}"))
    }

    /// What the library says of how it was built.
    pub fn build(&self) -> &str {
        ort::info()
    }

    /// The providers that the library was built with. Their hardware or their own libraries may
    /// still be missing, which only shows when a graph is loaded.
    pub fn providers(&self) -> Vec<Provider> {
        let built_in = |provider: &Provider| provider.is_built_in();
        Provider::ALL.into_iter().filter(built_in).collect()
    }

    /// Libraries that were found before this one: where, and why they could not be used.
    pub fn attempts(&self) -> &[String] {
        &self.loaded.attempts
    }

    /// Loads the ONNX file at `path`, with mvtop's own operators at hand.
    ///
    /// # Errors
    /// [`Error::Input`] for more than 1024 threads;
    /// [`Error::Provider`] when the library lacks the provider or it does not start;
    /// [`Error::Network`] when the file is missing or is no graph that can be run.
    pub fn session(&self, path: &Path, options: &SessionOptions) -> Result<Session> {
        let provider = options.provider;
        check_threads(options.threads)?;
        if !provider.is_built_in() {
            return Err(Error::Provider {
                provider: provider.to_string(),
                problem: format!(
                    "the ONNX Runtime library {} was built without it, use `cpu` or install a \
                     build that has it",
                    self.library().display()
                ),
            });
        }
        let network_error = |e: &dyn fmt::Display| Error::Network {
            path: path.to_owned(),
            problem: one_line(e),
        };
        if !path.is_file() {
            return Err(network_error(&"no such file"));
        }
        let bounds = Bounds {
            // Drivers of other processors reserve much more than they use.
            memory: Bounds::STRANGERS
                .memory
                .filter(|_| provider == Provider::Cpu),
            ..Bounds::STRANGERS
        };
        let cancel = cancel::current();
        let work = {
            let (runtime, path, options) = (*self, path.to_owned(), options.clone());
            move || runtime.load(&path, &options)
        };
        // It keeps the lock that loading takes.
        static STUCK: AtomicBool = AtomicBool::new(false);
        if STUCK.load(Ordering::Relaxed) {
            return Err(network_error(
                &"cannot be loaded as another network in this process has not come to an end; start anew",
            ));
        }
        let session = bounded(bounds, &cancel, || (), work).map_err(|why| match why {
            Unfinished::Interrupted => Error::Interrupted,
            Unfinished::TooLong => {
                STUCK.store(true, Ordering::Relaxed);
                network_error(&format!(
                    "loading it took more than {} s, in which any network of mvtop's is loaded; use \
                     another bundle",
                    bounds.seconds()
                ))
            }
            Unfinished::Failed => network_error(&"loading it failed"),
        })??;
        Ok(Session::new(path, session, bounds))
    }

    fn load(&self, path: &Path, options: &SessionOptions) -> Result<ort::session::Session> {
        let provider = options.provider;
        let network_error = |e: &dyn fmt::Display| Error::Network {
            path: path.to_owned(),
            problem: one_line(e),
        };
        let mut builder = ort::session::Session::builder(&self.loaded.environment)
            .and_then(|b| Ok(b.with_intra_threads(options.threads)?))
            // Spinning saves little on an idle machine and starves everything else on a busy one.
            .and_then(|b| Ok(b.with_intra_op_spinning(false)?))
            // Else a file's ending, `.ort`, says what it is, and not what was checked.
            .and_then(|b| Ok(b.with_config_entry("session.load_model_format", "ONNX")?))
            .and_then(|b| Ok(b.with_operators(operator::domain()?)?))
            .map_err(|e| network_error(&e))?;
        if let Some(registration) = provider.registration(options.threads) {
            builder = builder
                .with_execution_providers([registration])
                .map_err(|e| Error::Provider {
                    provider: provider.to_string(),
                    problem: one_line(&e),
                })?;
        }
        let session = builder.commit_from_file(path);
        session.map_err(|e| match provider.takes() {
            Some(taken) => Error::Provider {
                provider: provider.to_string(),
                problem: format!("{} cannot be run; {taken}: {}", path.display(), end_of(&e)),
            },
            None => network_error(&e),
        })
    }
}

/// What keeps the library from writing files and from asking for a host's name. It is read while the
/// library starts: `DisableTelemetryEvents` of its API comes too late (seen in 1.31).
const NO_TELEMETRY: (&str, &str) = ("ORT_DISABLE_TELEMETRY", "1");

/// Loads a library and starts it, turning everything that can go wrong into a sentence.
fn load(path: &Path) -> Result<Environment, String> {
    let (name, value) = NO_TELEMETRY;
    // SAFETY: once in a process, as the caller holds a lock and keeps what is loaded. Rust's own
    // readers of variables wait; C's, on other threads, are as with any `os.environ[...] = ...`.
    unsafe { std::env::set_var(name, value) };
    use ort::LoadDynamicError as E;
    let start = || {
        let builder = ort::init_from(path).map_err(|e| match e {
            E::Dlopen { error, .. } => {
                let reason = std::error::Error::source(&error).map(one_line);
                let reason = reason.unwrap_or_else(|| one_line(&error));
                format!("cannot be loaded, {reason}")
            }
            E::MissingApi { .. } => "is not an ONNX Runtime library".to_owned(),
            E::InvalidVersionString => "gives a version that cannot be read".to_owned(),
            E::BadVersion { version_str, .. } => format!(
                "is version {version_str}, expected 1.{} or newer, update it with `pip install -U \
                 onnxruntime`",
                ort::MINOR_VERSION
            ),
        })?;
        let environment = builder.with_name("mvtop").build();
        let environment = environment.map_err(|e| one_line(&e))?;
        register_operators(&environment).map_err(|e| one_line(&e))?;
        Ok(environment)
    };
    // A library that lies about itself makes `ort` panic.
    catch_unwind(AssertUnwindSafe(start)).unwrap_or_else(|_| Err("does not start".to_owned()))
}

/// Makes the domain of mvtop's operators known by a first session, of a graph of one node.
///
/// Each session registers it, but the library keeps it per process, and fails where two are the
/// first at the same time (seen in 1.20.1).
fn register_operators(environment: &Environment) -> ort::Result<()> {
    const IDENTITY: &[u8] = include_bytes!("identity.onnx");
    ort::session::Session::builder(environment)?
        .with_intra_threads(1)?
        .with_operators(operator::domain()?)?
        .commit_from_memory(IDENTITY)?;
    Ok(())
}

fn one_line(error: &(impl fmt::Display + ?Sized)) -> String {
    let text = error.to_string();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The last words of an error, where it says what it is after all that it came through.
fn end_of(error: &(impl fmt::Display + ?Sized)) -> String {
    const MOST: usize = 160;
    let text: Vec<char> = one_line(error).chars().collect();
    text[text.len().saturating_sub(MOST)..].iter().collect()
}

fn same_file(a: &Path, b: &Path) -> bool {
    let resolve = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    resolve(a) == resolve(b)
}
