//! A WebSocket client under full control of the test, so that it can be slow and hostile.

use std::{
    collections::BTreeSet,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    time::{Duration, Instant},
};

use crate::view_process::PATIENCE;

/// How long the server may stay silent.
const LIMIT: Duration = Duration::from_secs(20);

/// An open socket.
pub struct Socket {
    stream: BufReader<TcpStream>,
}

/// A message of the server.
#[derive(Debug)]
pub enum Message {
    Text(serde_json::Value),
    Bytes(Vec<u8>),
    Closed,
}

/// Requests `path` with these headers; returns the status, and the stream after the response's headers.
pub fn request(port: u16, path: &str, headers: &[(&str, &str)]) -> (u16, BufReader<TcpStream>) {
    let stream = TcpStream::connect(("127.0.0.1", port)).expect("the page is served");
    stream.set_read_timeout(Some(LIMIT)).expect("a timeout");
    let mut text = format!("GET {path} HTTP/1.1\r\n");
    if !headers.iter().any(|(name, _)| *name == "Host") {
        text += &format!("Host: 127.0.0.1:{port}\r\n");
    }
    for (name, value) in headers {
        text += &format!("{name}: {value}\r\n");
    }
    (&stream)
        .write_all(format!("{text}\r\n").as_bytes())
        .expect("it is sent");
    let mut stream = BufReader::new(stream);
    let mut line = String::new();
    stream.read_line(&mut line).expect("a status line");
    let status = line.split(' ').nth(1).and_then(|code| code.parse().ok());
    let status = status.unwrap_or_else(|| panic!("no status: {line:?}"));
    loop {
        let mut line = String::new();
        stream.read_line(&mut line).expect("headers");
        if line.trim().is_empty() {
            return (status, stream);
        }
    }
}

/// Opens the page's socket like a browser, with further headers; returns the status, and the socket if it was opened.
pub fn open(port: u16, headers: &[(&str, &str)]) -> (u16, Option<Socket>) {
    open_at(port, "/socket", headers)
}

/// Like [`open`], at another path.
pub fn open_at(port: u16, path: &str, headers: &[(&str, &str)]) -> (u16, Option<Socket>) {
    let mut all = vec![
        ("Connection", "Upgrade"),
        ("Upgrade", "websocket"),
        ("Sec-WebSocket-Version", "13"),
        ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ];
    if !headers
        .iter()
        .any(|(name, _)| *name == "Sec-WebSocket-Protocol")
    {
        all.push(("Sec-WebSocket-Protocol", "wm.view.v1"));
    }
    all.extend(headers);
    let (status, stream) = request(port, path, &all);
    (status, (status == 101).then_some(Socket { stream }))
}

impl Socket {
    pub fn send_raw(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.stream.get_mut().write_all(bytes)
    }

    /// Sends a text, masked with zeros.
    pub fn send(&mut self, text: &str) {
        let length = u8::try_from(text.len()).ok().filter(|length| *length < 126);
        let mut frame = vec![0x81];
        match length {
            Some(length) => frame.push(0x80 | length),
            None => {
                frame.push(0x80 | 126);
                frame.extend(
                    u16::try_from(text.len())
                        .expect("a short text")
                        .to_be_bytes(),
                );
            }
        }
        frame.extend([0; 4]);
        frame.extend(text.as_bytes());
        self.send_raw(&frame).expect("it is sent");
    }

    fn take<const N: usize>(&mut self) -> std::io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.stream.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// The next message except pings.
    pub fn receive(&mut self) -> Message {
        loop {
            let Ok([kind, length]) = self.take() else {
                return Message::Closed;
            };
            let length = match length {
                126 => self
                    .take()
                    .map(|bytes| u64::from(u16::from_be_bytes(bytes))),
                127 => self.take().map(u64::from_be_bytes),
                length => Ok(u64::from(length)),
            };
            let mut payload = vec![0; usize::try_from(length.expect("a length")).expect("a size")];
            if self.stream.read_exact(&mut payload).is_err() {
                return Message::Closed;
            }
            match kind & 0x0f {
                1 => return Message::Text(serde_json::from_slice(&payload).expect("JSON")),
                2 => return Message::Bytes(payload),
                8 => return Message::Closed,
                _ => {}
            }
        }
    }

    /// The result of `pick` for the first message for which there is one; skips others.
    pub fn until<T>(&mut self, what: &str, mut pick: impl FnMut(Message) -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            match self.receive() {
                Message::Closed => panic!("{what}: the socket was closed, or silent for {LIMIT:?}"),
                message => {
                    if let Some(picked) = pick(message) {
                        return picked;
                    }
                }
            }
            assert!(start.elapsed() < PATIENCE, "{what}: not in {PATIENCE:?}");
        }
    }

    /// Like [`Self::until`], for texts with this `op`.
    pub fn until_op<T>(
        &mut self,
        op: &str,
        mut pick: impl FnMut(serde_json::Value) -> Option<T>,
    ) -> T {
        self.until(op, |message| match message {
            Message::Text(text) if text["op"] == op => pick(text),
            _ => None,
        })
    }

    /// Reads until the server has closed the socket.
    pub fn until_closed(&mut self) {
        let start = Instant::now();
        while !matches!(self.receive(), Message::Closed) {
            assert!(start.elapsed() < PATIENCE, "still open after {PATIENCE:?}");
        }
    }

    /// The next reply to a command.
    pub fn answer(&mut self) -> serde_json::Value {
        self.until_op("answer", Some)
    }

    /// The next camera picture: its stamp \[ns\], and when it arrived at the node.
    pub fn frame(&mut self) -> (i64, i64) {
        self.until("a camera picture", |message| {
            let Message::Bytes(bytes) = message else {
                return None;
            };
            let stamp =
                |at: usize| i64::from_le_bytes(bytes[at..at + 8].try_into().expect("8 bytes"));
            (bytes[1] == 0).then(|| (stamp(4), stamp(20)))
        })
    }
}

/// How long clients read next to a stalled one.
const BESIDE: Duration = Duration::from_secs(6);

/// Lets clients read with `next`, which returns stamps, and calls `beside` in between. Returns the stamps that all of
/// them received.
pub fn read_beside<C, S: Copy + Ord>(
    clients: &mut [C],
    next: impl Fn(&mut C) -> S,
    mut beside: impl FnMut(),
) -> BTreeSet<S> {
    let start = Instant::now();
    let mut seen = vec![BTreeSet::new(); clients.len()];
    while start.elapsed() < BESIDE {
        for (client, seen) in clients.iter_mut().zip(&mut seen) {
            seen.insert(next(client));
        }
        beside();
    }
    let common = seen.into_iter().reduce(|all, one| &all & &one);
    let common = common.expect("clients");
    assert!(common.len() > 50, "{}", common.len());
    common
}

/// Lets a stalled client resume: it soon reaches `newest`, and never gets the pictures in between.
pub fn catch_up<C, S: Copy + Ord>(
    client: &mut C,
    next: impl Fn(&mut C) -> S,
    common: &BTreeSet<S>,
) {
    let newest = *common.last().expect("messages");
    let mut read = 1;
    while next(client) < newest {
        read += 1;
    }
    assert!(read < common.len(), "{read} of {}", common.len());
}

/// The header of a frame whose bytes never arrive.
pub fn frame_of(bytes: u64) -> Vec<u8> {
    let mut header = vec![0x81, 0x80 | 127];
    header.extend(bytes.to_be_bytes());
    header.extend([0; 4]);
    header
}
