//! Connections of a listener: only so many at once, and nobody is waited for without end.

use std::future::pending;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::client::Client;

/// Pause after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(50);
/// How long a client may stay that is not [`Known`]: its first request, which shows it, takes no second.
const STRANGER_TIME: Duration = Duration::from_secs(10);

/// Whether a client has shown that the service is for it: by the token, or by a request where there is none.
#[derive(Clone, Default)]
pub struct Known(Arc<AtomicBool>);

impl Known {
    pub fn note(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub fn is_so(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Ends when a stranger has stayed too long.
    async fn overstays(&self) {
        tokio::time::sleep(STRANGER_TIME).await;
        if self.is_so() {
            pending().await
        }
    }
}

/// Talks to each who connects until `stopped`, then until all conversations have ended.
///
/// - `most`: connections at once; further ones wait to be accepted
pub async fn each<T: Future<Output = ()> + Send + 'static>(
    listener: TcpListener,
    most: usize,
    mut stopped: watch::Receiver<bool>,
    talk: impl Fn(Client, Known) -> T,
) {
    let places = Arc::new(Semaphore::new(most));
    while let Some((stream, place)) = accept(&listener, &places, &mut stopped).await {
        let known = Known::default();
        let talk = talk(Client::new(stream), known.clone());
        tokio::spawn(async move {
            tokio::select! {
                () = talk => {}
                () = known.overstays() => {}
            }
            drop(place);
        });
    }
    drop(listener);
    // All places are free once all connections have ended.
    let _ = places.acquire_many(most as u32).await;
}

/// The next connection with its place, which is free again once that is dropped; `None` once stopped.
async fn accept(
    listener: &TcpListener,
    places: &Arc<Semaphore>,
    stopped: &mut watch::Receiver<bool>,
) -> Option<(TcpStream, OwnedSemaphorePermit)> {
    loop {
        let accepted = async {
            let place = places.clone().acquire_owned().await;
            (listener.accept().await, place)
        };
        let accepted = tokio::select! {
            accepted = accepted => accepted,
            _ = stopped.changed() => return None,
        };
        if let (Ok((stream, _)), Ok(place)) = accepted {
            return Some((stream, place));
        }
        // No file handles left, for example: other connections end meanwhile.
        tokio::time::sleep(PAUSE).await;
    }
}
