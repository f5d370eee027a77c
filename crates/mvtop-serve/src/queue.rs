//! The bounded queue of the thread that predicts.

use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::problem::{Kind, Problem};

/// Work that gives its place back before anybody hears that it is done.
type Task = Box<dyn FnOnce(Place) + Send>;

/// Work that waits for one thread, in the order in which it came.
pub struct Queue {
    places: Arc<Semaphore>,
    size: usize,
    worker: Mutex<Option<Worker>>,
}

struct Worker {
    tasks: Sender<(Task, Place)>,
    thread: JoinHandle<()>,
}

/// A place in the queue, given back when it is dropped.
pub type Place = OwnedSemaphorePermit;

impl Queue {
    /// - `waiting`: how many tasks may wait while one is worked on
    pub fn new(waiting: usize) -> Result<Self, String> {
        let (tasks, taken) = channel::<(Task, Place)>();
        let work = move || {
            while let Ok((task, place)) = taken.recv() {
                task(place);
            }
        };
        let thread = thread::Builder::new().name("predict".into()).spawn(work);
        let thread = thread.map_err(|cause| format!("cannot start a thread: {cause}"))?;
        let size = waiting + 1;
        Ok(Self {
            places: Arc::new(Semaphore::new(size)),
            size,
            worker: Mutex::new(Some(Worker { tasks, thread })),
        })
    }

    /// Takes a place, to be had before anything costly is done.
    pub fn enter(&self) -> Result<Place, Problem> {
        self.places.clone().try_acquire_owned().map_err(|_| {
            let size = self.size;
            Problem::new(
                Kind::Busy,
                format!("the queue of {size} is full; send this again later, or fewer at once"),
            )
        })
    }

    /// How many are worked on or wait.
    pub fn length(&self) -> usize {
        self.size - self.places.available_permits()
    }

    pub fn submit(&self, place: Place, task: Task) -> Result<(), Problem> {
        let worker = self.worker.lock().unwrap_or_else(PoisonError::into_inner);
        let sent = worker
            .as_ref()
            .map(|worker| worker.tasks.send((task, place)));
        match sent {
            Some(Ok(())) => Ok(()),
            _ => Err(Problem::new(
                Kind::NotReady,
                "the service is stopping; send this again later",
            )),
        }
    }

    /// Waits until nothing is worked on or waits.
    pub async fn worked_off(&self) {
        let _ = self.places.acquire_many(self.size as u32).await;
    }

    /// Finishes what waits, and takes nothing more.
    pub fn finish(&self) {
        let worker = self
            .worker
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(Worker { tasks, thread }) = worker {
            drop(tasks);
            let _ = thread.join();
        }
    }
}
