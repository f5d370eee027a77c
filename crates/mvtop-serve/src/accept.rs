//! Connections of a listener, only so many at once.

use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// Pause after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(50);

/// The next connection with its place, which is free again once that is dropped; `None` once stopped.
///
/// - `places`: one for each connection at once; further ones wait to be accepted
pub async fn accept(
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
