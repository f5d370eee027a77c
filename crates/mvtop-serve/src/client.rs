//! A connection whose client has to read what it is sent.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

/// How long a client may take to read answers beyond those that its connection holds, until it has read
/// them all: robots and browsers do at once, and a slow link carries a picture in that time.
const WRITE_TIME: Duration = Duration::from_secs(10);

/// A connection to which writing fails when its client does not read in time.
pub struct Client {
    stream: TcpStream,
    /// Ends when all has to be written; there while something is not.
    late: Option<Pin<Box<Sleep>>>,
}

impl Client {
    pub fn new(stream: TcpStream) -> Self {
        // Answers are short: none waits to be sent with more.
        let _ = stream.set_nodelay(true);
        Self { stream, late: None }
    }

    fn in_time(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        if written.is_pending() {
            let late = self.late.get_or_insert_with(|| Box::pin(sleep(WRITE_TIME)));
            if late.as_mut().poll(context).is_ready() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
        }
        written
    }
}

impl AsyncRead for Client {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Client {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.in_time(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, pieces);
        self.in_time(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    /// Asked for once all is written.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.late = None;
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;
    use tokio::time::timeout;

    /// More than a connection holds.
    const MUCH: usize = 1 << 26;

    async fn connected() -> (Client, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let other = TcpStream::connect(listener.local_addr().unwrap());
        let (accepted, other) = tokio::join!(listener.accept(), other);
        (Client::new(accepted.unwrap().0), other.unwrap())
    }

    fn run(test: impl Future<Output = ()>) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_all().build().unwrap();
        runtime.block_on(test);
    }

    #[test]
    fn who_does_not_read_is_not_waited_for() {
        run(async {
            let (mut client, _silent) = connected().await;
            let sent = timeout(2 * WRITE_TIME, client.write_all(&vec![0; MUCH])).await;
            assert_eq!(sent.unwrap().unwrap_err().kind(), io::ErrorKind::TimedOut);
        });
    }

    #[test]
    fn who_reads_a_little_now_and_then_is_not_waited_for() {
        run(async {
            let (mut client, mut slow) = connected().await;
            let reads = async {
                let mut some = vec![0; 1 << 16];
                loop {
                    sleep(WRITE_TIME / 20).await;
                    slow.read_exact(&mut some).await.unwrap();
                }
            };
            let bytes = vec![0; MUCH];
            let sent = tokio::select! {
                sent = timeout(2 * WRITE_TIME, client.write_all(&bytes)) => sent,
                () = reads => unreachable!(),
            };
            assert_eq!(sent.unwrap().unwrap_err().kind(), io::ErrorKind::TimedOut);
        });
    }

    #[test]
    fn each_answer_has_its_own_time() {
        run(async {
            let (mut client, mut other) = connected().await;
            let bytes = vec![0; MUCH];
            for _ in 0..2 {
                let reads = async {
                    // Long enough that it waits to be read.
                    sleep(WRITE_TIME * 3 / 5).await;
                    let mut all = vec![0; MUCH];
                    other.read_exact(&mut all).await.unwrap();
                };
                let sends = async {
                    client.write_all(&bytes).await.unwrap();
                    client.flush().await.unwrap();
                };
                tokio::join!(reads, sends);
            }
        });
    }
}
