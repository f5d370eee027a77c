//! What a graph may take at most where it is loaded and first run: a bundle may be a stranger's.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use crate::cancel::Cancel;

/// Bounds of one load or first run.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    /// Longest time that is waited.
    pub time: Duration,
    /// Most memory beside what the process has already, bytes; `None` where it is not to be bounded.
    pub memory: Option<u64>,
}

impl Bounds {
    /// Far above what any network of mvtop's takes.
    pub const STRANGERS: Self = Self {
        time: Duration::from_secs(300),
        memory: Some(8 << 30),
    };

    /// For the sentence of an error.
    pub fn seconds(self) -> u64 {
        self.time.as_secs()
    }
}

/// How long what was asked to end is waited for.
const GRACE: Duration = Duration::from_secs(5);
/// How often it is looked whether it is to end.
const LOOK: Duration = Duration::from_millis(20);

/// Why there is no result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unfinished {
    /// It took longer than it may.
    TooLong,
    /// It was asked to end.
    Interrupted,
    /// It panicked, or no thread could be had for it.
    Failed,
}

/// Does some work on a thread of its own within bounds. Where it takes too long, it is stopped, and
/// if it does not heed that, left to itself.
///
/// - `cancel`: ends it before its time
/// - `stop`: ends the work, if it can
pub fn bounded<T: Send + 'static>(
    bounds: Bounds,
    cancel: &Cancel,
    stop: impl Fn(),
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Unfinished> {
    let (send, done) = mpsc::channel();
    let spawned = thread::Builder::new()
        .name("mvtop-bounded".into())
        .spawn(move || {
            let limit = bounds.memory.and_then(memory::Limit::set);
            let result = work();
            // Before the other side goes on.
            drop(limit);
            send.send(result).ok();
        });
    if spawned.is_err() {
        return Err(Unfinished::Failed);
    }
    let start = Instant::now();
    let mut stopped: Option<(Instant, Unfinished)> = None;
    loop {
        match done.recv_timeout(LOOK) {
            Ok(result) => {
                return match stopped {
                    // It may have come to its end all the same.
                    Some((_, why)) => Err(why),
                    None => Ok(result),
                };
            }
            Err(RecvTimeoutError::Disconnected) => return Err(Unfinished::Failed),
            Err(RecvTimeoutError::Timeout) => {}
        }
        match stopped {
            Some((since, why)) if since.elapsed() > GRACE => return Err(why),
            Some(_) => {}
            None => {
                let why = match cancel.is_asked() {
                    true => Unfinished::Interrupted,
                    false if start.elapsed() > bounds.time => Unfinished::TooLong,
                    false => continue,
                };
                stop();
                stopped = Some((Instant::now(), why));
            }
        }
    }
}

#[cfg(target_os = "linux")]
mod memory {
    //! The process's limit, as long as bounded work runs: an allocation beyond it fails, and ONNX
    //! Runtime gives that as an error.

    use std::sync::{Mutex, PoisonError};

    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

    /// How many hold a limit, and the one before the first.
    static HELD: Mutex<(usize, Option<Rlimit>)> = Mutex::new((0, None));

    pub struct Limit;

    impl Limit {
        /// `None` where memory cannot be bounded.
        pub fn set(more: u64) -> Option<Self> {
            let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
            if held.0 == 0 {
                let before = getrlimit(Resource::Data);
                let most = in_use()?.saturating_add(more);
                if before.current.is_none_or(|current| current > most) {
                    let limit = Rlimit {
                        current: Some(before.maximum.map_or(most, |maximum| most.min(maximum))),
                        ..before
                    };
                    setrlimit(Resource::Data, limit).ok()?;
                    held.1 = Some(before);
                }
            }
            held.0 += 1;
            Some(Self)
        }
    }

    impl Drop for Limit {
        fn drop(&mut self) {
            let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
            held.0 -= 1;
            if held.0 == 0 {
                let before = held.1.take();
                before.and_then(|limit| setrlimit(Resource::Data, limit).ok());
            }
        }
    }

    /// What counts towards the limit, bytes.
    fn in_use() -> Option<u64> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmData:"));
        let kibibytes: u64 = line?.trim().trim_end_matches("kB").trim().parse().ok()?;
        Some(kibibytes << 10)
    }
}

#[cfg(not(target_os = "linux"))]
mod memory {
    /// Memory is not bounded here.
    pub struct Limit;

    impl Limit {
        pub fn set(_: u64) -> Option<Self> {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    const SHORT: Bounds = Bounds {
        time: Duration::from_millis(50),
        memory: None,
    };

    #[test]
    fn work_that_does_not_end_is_stopped() {
        let stopped = Arc::new(AtomicBool::new(false));
        let (stop, seen) = (stopped.clone(), stopped.clone());
        let work = move || {
            while !seen.load(Ordering::SeqCst) {
                thread::sleep(Duration::from_millis(1));
            }
        };
        let stop = move || stop.store(true, Ordering::SeqCst);
        let done = bounded(SHORT, &Cancel::default(), stop, work);
        assert_eq!(done, Err(Unfinished::TooLong));
        assert!(stopped.load(Ordering::SeqCst));
    }

    #[test]
    fn work_within_bounds_gives_its_result_and_a_panic_none() {
        let cancel = Cancel::default();
        assert_eq!(bounded(SHORT, &cancel, || (), || 7), Ok(7));
        let panics = || -> usize { std::panic::panic_any(0) };
        assert_eq!(
            bounded(SHORT, &cancel, || (), panics),
            Err(Unfinished::Failed)
        );
    }

    #[test]
    fn asked_to_end_it_does_not_wait_for_its_time() {
        let cancel = Cancel::default();
        cancel.ask();
        let work = || thread::sleep(Duration::from_millis(200));
        let long = Bounds::STRANGERS;
        assert_eq!(
            bounded(long, &cancel, || (), work),
            Err(Unfinished::Interrupted)
        );
    }
}
