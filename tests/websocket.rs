//! A client of a WebSocket that does only what it is told, so that it can be as slow and as hostile as a test wants.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    time::Duration,
};

/// How long the server may take to say anything.
const LIMIT: Duration = Duration::from_secs(20);

/// A socket that was opened.
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

/// Asks for `path` with these headers; gives the status, and what comes after the headers of the answer.
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

/// What a browser sends to open the page's socket, with further headers; the status, and the socket where there is one.
pub fn open(port: u16, headers: &[(&str, &str)]) -> (u16, Option<Socket>) {
    open_at(port, "/socket", headers)
}

/// The same under another path.
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
    /// Sends bytes as they are.
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

    /// The next message that is no ping.
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

    /// The next answer to a command.
    pub fn answer(&mut self) -> serde_json::Value {
        loop {
            match self.receive() {
                Message::Text(text) if text["op"] == "answer" => return text,
                Message::Closed => panic!("the socket was closed"),
                _ => {}
            }
        }
    }

    /// The next camera picture: its stamp \[ns\], and when it arrived at the node.
    pub fn frame(&mut self) -> (i64, i64) {
        loop {
            match self.receive() {
                Message::Bytes(bytes) if bytes[1] == 0 => {
                    let stamp = |at: usize| {
                        i64::from_le_bytes(bytes[at..at + 8].try_into().expect("8 bytes"))
                    };
                    return (stamp(4), stamp(20));
                }
                Message::Closed => panic!("the socket was closed"),
                _ => {}
            }
        }
    }
}

/// The header of a frame of this many bytes that never come.
pub fn frame_of(bytes: u64) -> Vec<u8> {
    let mut header = vec![0x81, 0x80 | 127];
    header.extend(bytes.to_be_bytes());
    header.extend([0; 4]);
    header
}
