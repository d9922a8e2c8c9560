use std::{
    io::{self, ErrorKind, Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

use crate::run::Stop;

/// Longest time between two checks of a [`Stop`].
const CHECK: Duration = Duration::from_millis(100);

/// A TCP connection whose reads and writes end in time, however slowly the other side sends or receives.
#[derive(Debug)]
pub struct Connection(TcpStream);

impl Connection {
    /// Takes over a connected stream.
    ///
    /// # Errors
    /// If its options cannot be set.
    pub fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        // Small messages are not to wait for acknowledgements.
        stream.set_nodelay(true)?;
        Ok(Self(stream))
    }

    /// Reads and writes for `limit`, all calls together.
    pub fn within(&self, limit: Duration) -> Timed<'_> {
        Timed {
            stream: &self.0,
            until: Instant::now() + limit,
            stop: None,
        }
    }
}

/// Reads and writes until a time; then they fail with [`ErrorKind::TimedOut`].
#[derive(Debug)]
pub struct Timed<'a> {
    stream: &'a TcpStream,
    until: Instant,
    stop: Option<&'a Stop>,
}

impl<'a> Timed<'a> {
    /// Fails as soon as `stop` is set, too.
    pub fn or_stop(self, stop: &'a Stop) -> Self {
        Self {
            stop: Some(stop),
            ..self
        }
    }

    /// Repeats `attempt` until it succeeds or fails, with the time left as timeout.
    fn repeat<T>(
        &self,
        set_timeout: impl Fn(Option<Duration>) -> io::Result<()>,
        mut attempt: impl FnMut() -> io::Result<T>,
    ) -> io::Result<T> {
        loop {
            let left = self.until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(ErrorKind::TimedOut.into());
            }
            let timeout = match self.stop {
                Some(stop) if stop.is_asked() => return Err(io::Error::other("stopped")),
                Some(_) => left.min(CHECK),
                None => left,
            };
            set_timeout(Some(timeout))?;
            match attempt() {
                // The system reports a timeout as either.
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                done => return done,
            }
        }
    }
}

impl Read for Timed<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut stream = self.stream;
        self.repeat(
            |timeout| self.stream.set_read_timeout(timeout),
            || stream.read(buffer),
        )
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut stream = self.stream;
        self.repeat(
            |timeout| self.stream.set_write_timeout(timeout),
            || stream.write(bytes),
        )
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
