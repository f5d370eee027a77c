//! A request to end a computation before its time.

use std::cell::RefCell;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::{Error, Result};

/// Ends the computations of a thread, when another thread asks for it.
///
/// ```
/// use mvtop_core::cancel::Cancel;
///
/// let cancel = Cancel::default();
/// std::thread::scope(|threads| {
///     threads.spawn(|| cancel.scope(|| "estimator.predict(...) gives Error::Interrupted"));
///     cancel.ask();
/// });
/// assert!(cancel.is_asked());
/// ```
#[derive(Clone, Default)]
pub struct Cancel(Arc<State>);

type Stop = Box<dyn Fn() + Send>;

#[derive(Default)]
struct State {
    asked: AtomicBool,
    /// Ends what runs at the moment, where it does not look at `asked` itself.
    stop: Mutex<Option<Stop>>,
}

thread_local! {
    /// What ends the computations of this thread.
    static CURRENT: RefCell<Option<Cancel>> = const { RefCell::new(None) };
}

impl Cancel {
    /// Asks the computations to end: they give [`Error::Interrupted`] soon after.
    pub fn ask(&self) {
        self.0.asked.store(true, Ordering::SeqCst);
        if let Some(stop) = &*self.lock() {
            stop();
        }
    }

    /// Whether that was asked.
    pub fn is_asked(&self) -> bool {
        self.0.asked.load(Ordering::SeqCst)
    }

    /// Does some work, whose computations on this thread end when it is asked.
    pub fn scope<T>(&self, work: impl FnOnce() -> T) -> T {
        let before = CURRENT.replace(Some(self.clone()));
        // Also where the work panics.
        let _restore = Restore(before);
        work()
    }

    /// Does some work that `stop` ends.
    #[cfg(feature = "onnx")]
    pub(crate) fn stopping<T>(
        &self,
        stop: impl Fn() + Send + 'static,
        work: impl FnOnce() -> T,
    ) -> T {
        *self.lock() = Some(Box::new(stop));
        if self.is_asked() {
            self.ask();
        }
        let done = work();
        *self.lock() = None;
        done
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Stop>> {
        self.0.stop.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for Cancel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Cancel(asked: {})", self.is_asked())
    }
}

struct Restore(Option<Cancel>);

impl Drop for Restore {
    fn drop(&mut self) {
        CURRENT.set(self.0.take());
    }
}

/// What ends the computations of this thread; one that nobody asks where there is none.
pub(crate) fn current() -> Cancel {
    CURRENT.with_borrow(|current| current.clone().unwrap_or_default())
}

/// Refuses to go on where this thread's computations are to end.
pub(crate) fn check() -> Result<()> {
    match current().is_asked() {
        true => Err(Error::Interrupted),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_holds_within_its_scope_alone() {
        let (outer, inner) = (Cancel::default(), Cancel::default());
        outer.scope(|| {
            inner.ask();
            inner.scope(|| assert!(matches!(check(), Err(Error::Interrupted))));
            assert!(check().is_ok());
            outer.ask();
            assert!(check().is_err());
        });
        assert!(check().is_ok());
    }

    #[test]
    fn what_runs_is_stopped_whether_asked_before_or_meanwhile() {
        let stopped = Arc::new(AtomicBool::new(false));
        for before in [true, false] {
            stopped.store(false, Ordering::SeqCst);
            let (cancel, flag) = (Cancel::default(), stopped.clone());
            if before {
                cancel.ask();
            }
            cancel.stopping(
                move || flag.store(true, Ordering::SeqCst),
                || {
                    if !before {
                        std::thread::scope(|threads| threads.spawn(|| cancel.ask()).join().ok());
                    }
                },
            );
            assert!(stopped.load(Ordering::SeqCst));
        }
    }
}
