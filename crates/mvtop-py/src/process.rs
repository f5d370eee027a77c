//! Threads after a fork.
//!
//! A forked process has only the thread that forked: rayon's global pool would be waited for
//! forever, and so would the threads of a loaded network.

use std::panic::resume_unwind;
use std::process;
use std::ptr;
use std::sync::atomic::{AtomicPtr, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::Duration;

use mvtop_core::cancel::Cancel;
use mvtop_core::onnx::check_threads;
use pyo3::prelude::*;
use rayon::ThreadPool;

use crate::error::{python, value};

/// The process that loaded the module, in which rayon's global pool has its threads.
static FIRST: OnceLock<u32> = OnceLock::new();
/// As [`set_num_threads`] has it.
static THREADS: AtomicUsize = AtomicUsize::new(0);
/// The pools of forked processes, and of numbers of threads that were asked for, the latest first. A
/// pointer, because a lock may be held at the moment of a fork.
static OWN: AtomicPtr<Pool> = AtomicPtr::new(ptr::null_mut());

struct Pool {
    process: u32,
    count: usize,
    threads: ThreadPool,
    /// The one before it; none is ever taken out.
    before: *mut Pool,
}

/// Sets the number of threads that mvtop's own computations use, in this process and those that are
/// forked from it. A network's are chosen where it is loaded.
///
/// Parameters
/// ----------
/// count
///     0 for one per processor, as it is at first; 1024 at most.
///
/// Raises
/// ------
/// ValueError
///     For more.
#[pyfunction]
pub fn set_num_threads(count: usize) -> PyResult<()> {
    check_threads(count).map_err(python)?;
    THREADS.store(count, Ordering::Relaxed);
    Ok(())
}

/// To be called when the module is loaded.
pub fn note_first() {
    FIRST.get_or_init(process::id);
}

/// Does some work, in this process's own rayon threads and without Python's lock.
pub fn compute<T: Send>(py: Python, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    py.detach(|| in_pool(work))
}

/// How often Python is asked whether it was interrupted.
const LOOK: Duration = Duration::from_millis(20);

/// The same for work that Ctrl-C ends: Python notes an interrupt and raises it when its main thread asks,
/// so that this looks while another thread works. Work that panics is the caller's panic.
pub fn interruptible<T: Send>(
    py: Python,
    work: impl FnOnce() -> PyResult<T> + Send,
) -> PyResult<T> {
    let cancel = Cancel::default();
    let asked = cancel.clone();
    thread::scope(|threads| {
        let (send, done) = mpsc::channel();
        let done = Mutex::new(done);
        let worker = threads.spawn(move || {
            let result = asked.scope(work);
            drop(send);
            result
        });
        let mut interrupt = None;
        // Disconnected is done, or panicked.
        let waits = || {
            let done = done.lock().unwrap_or_else(PoisonError::into_inner);
            done.recv_timeout(LOOK) == Err::<(), _>(RecvTimeoutError::Timeout)
        };
        while py.detach(waits) {
            if interrupt.is_none()
                && let Err(raised) = py.check_signals()
            {
                cancel.ask();
                interrupt = Some(raised);
            }
        }
        let done = py.detach(|| worker.join());
        match interrupt {
            Some(raised) => Err(raised),
            None => done.unwrap_or_else(|panic| resume_unwind(panic)),
        }
    })
}

/// The same for work under a lock, to be taken outside: a thread of the pool that waits for a part
/// of its work takes up other work meanwhile, and would wait for a lock that it holds itself.
pub fn in_pool<T: Send>(work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let first = FIRST.get() == Some(&process::id());
    match THREADS.load(Ordering::Relaxed) {
        0 if first => Ok(work()),
        count => Ok(own(count)?.threads.install(work)),
    }
}

fn own(count: usize) -> PyResult<&'static Pool> {
    let process = process::id();
    if let Some(pool) = known(process, count) {
        return Ok(pool);
    }
    let threads = rayon::ThreadPoolBuilder::new().num_threads(count).build();
    let threads = threads.map_err(|cause| value(format!("{count} threads: {cause}")))?;
    let pool = Box::leak(Box::new(Pool {
        process,
        count,
        threads,
        before: OWN.load(Ordering::Acquire),
    }));
    // Two threads that come here at once make a pool each; both work, and the first that is found is
    // used from then on. A pool of another number stays, asleep: other threads may be in it, and the
    // number may come again.
    while let Err(newer) =
        OWN.compare_exchange(pool.before, pool, Ordering::AcqRel, Ordering::Acquire)
    {
        pool.before = newer;
    }
    Ok(pool)
}

/// The pool of that number of threads of this process, if it was made. Those of a process that this
/// one was forked from have no threads here.
fn known(process: u32, count: usize) -> Option<&'static Pool> {
    let mut next = OWN.load(Ordering::Acquire);
    // SAFETY: what is stored comes from `Box::leak`, and does not change once it is.
    while let Some(pool) = unsafe { next.as_ref() } {
        if (pool.process, pool.count) == (process, count) {
            return Some(pool);
        }
        next = pool.before;
    }
    None
}

/// To be called once ONNX Runtime is loaded: lets processes that are forked from this one exit.
///
/// At exit the library (seen in 1.31) waits for a thread of its own, which a forked process does not
/// have. Such a process ends before it comes to that, after Python's own cleaning up; one that
/// ends by `_exit`, as those of `multiprocessing` do, never comes to it.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn let_forks_exit() {
    use std::ffi::{c_int, c_void};
    use std::sync::Once;

    unsafe extern "C" {
        fn on_exit(function: extern "C" fn(c_int, *mut c_void), argument: *mut c_void) -> c_int;
        fn fflush(stream: *mut c_void) -> c_int;
        fn _exit(status: c_int) -> !;
    }

    extern "C" fn end(status: c_int, loaded_in: *mut c_void) {
        if loaded_in as usize != process::id() as usize {
            // SAFETY: a null pointer stands for all streams.
            unsafe {
                fflush(ptr::null_mut());
                _exit(status)
            }
        }
    }

    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // SAFETY: the argument is a number, and `end` lives as long as the process. Without memory
        // for it, forked processes hang at exit, as they would without mvtop.
        unsafe { on_exit(end, process::id() as usize as *mut c_void) };
    });
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn let_forks_exit() {}
