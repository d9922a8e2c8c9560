//! Connections, limited in number; silent ones end.

use axum::serve::Listener;
use socket2::SockRef;
use std::{
    future::Future as _,
    io,
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore},
    time::{Instant, Sleep},
};

/// A connection without received bytes ends after this time. Browsers answer the pings of a socket. This ends
/// unfinished requests, and clients whose network is gone.
const SILENCE: Duration = Duration::from_secs(30);
/// The kernel's buffer for a client that does not read: a few pictures.
const SEND_BUFFER: usize = 256 << 10;
/// The pause after an error, for example without file descriptors.
const PAUSE: Duration = Duration::from_millis(100);

pub(crate) struct Connections {
    listener: TcpListener,
    permits: Arc<Semaphore>,
    refused: Arc<AtomicU64>,
}

impl Connections {
    /// Accepts at most `limit` connections at a time, closes others at once, and counts them in `refused`.
    pub(crate) fn new(listener: TcpListener, limit: usize, refused: Arc<AtomicU64>) -> Self {
        Self {
            listener,
            permits: Arc::new(Semaphore::new(limit)),
            refused,
        }
    }
}

impl Listener for Connections {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            let (stream, address) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::debug!("a connection cannot be accepted: {error}");
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            let Ok(permit) = Arc::clone(&self.permits).try_acquire_owned() else {
                self.refused.fetch_add(1, Ordering::Relaxed);
                continue;
            };
            // without these it is only slower
            stream.set_nodelay(true).ok();
            SockRef::from(&stream)
                .set_send_buffer_size(SEND_BUFFER)
                .ok();
            let connection = Connection {
                stream,
                silence: Box::pin(tokio::time::sleep(SILENCE)),
                _permit: permit,
            };
            return (connection, address);
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection; frees its place when dropped.
pub(crate) struct Connection {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
    _permit: OwnedSemaphorePermit,
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Ready(result) => {
                let until = Instant::now() + SILENCE;
                self.silence.as_mut().reset(until);
                Poll::Ready(result)
            }
            Poll::Pending => {
                let silent = || io::Error::new(io::ErrorKind::TimedOut, "no data for too long");
                self.silence.as_mut().poll(context).map(|()| Err(silent()))
            }
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
