//! A server that speaks the judges' protocol. It judges nothing, and says so in every answer.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use serde_json::{Value, json};

/// A request that was received.
#[derive(Clone, Debug)]
pub struct Request {
    pub head: String,
    pub body: Value,
}

/// The response to a request.
pub enum Response {
    /// Status, more header lines, body.
    Whole(u16, &'static str, String),
    /// More bytes are announced than are sent.
    BrokenOff(String),
    /// The connection is closed without a response.
    HangUp,
    /// Never ends, unless the client hangs up.
    Endless,
}

/// An answer of the test server with this last line.
pub fn says(end: &str) -> Response {
    let text = format!("I am a test server, not a judge. I have seen nothing.\n{end}");
    let body = json!({
        "id": "test",
        "object": "chat.completion",
        "model": "test-server",
        "choices": [{
            "index": 0,
            "message": {"role": "assistant", "content": text},
            "finish_reason": "stop",
        }],
        "usage": {"prompt_tokens": 1000, "completion_tokens": 10, "total_tokens": 1010},
    });
    Response::Whole(200, "", body.to_string())
}

pub fn fails(status: u16, header: &'static str) -> Response {
    let message = "I am a test server and refuse.\u{1b}[2J";
    let body = json!({"error": {"message": message}});
    Response::Whole(status, header, body.to_string())
}

/// Runs until it is dropped.
pub struct Server {
    address: SocketAddr,
    requests: Arc<Mutex<Vec<Request>>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Sends `script(n, request)` as the response to request number n, from 0.
    pub fn new(script: impl Fn(usize, &Request) -> Response + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let requests = Arc::new(Mutex::new(Vec::new()));
        let ended = Arc::new(AtomicBool::new(false));
        let (seen, end) = (Arc::clone(&requests), Arc::clone(&ended));
        let thread = std::thread::spawn(move || {
            for stream in listener.incoming() {
                if end.load(Ordering::SeqCst) {
                    return;
                }
                let stream = stream.unwrap();
                let Some(request) = read(&stream) else {
                    continue;
                };
                let number = {
                    let mut seen = seen.lock().unwrap();
                    seen.push(request.clone());
                    seen.len() - 1
                };
                write(stream, script(number, &request));
            }
        });
        Self {
            address,
            requests,
            ended,
            thread: Some(thread),
        }
    }

    pub fn base_url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    pub fn requests(&self) -> Vec<Request> {
        self.requests.lock().unwrap().clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        // Wakes it up.
        TcpStream::connect(self.address).ok();
        self.thread.take().unwrap().join().unwrap();
    }
}

fn read(stream: &TcpStream) -> Option<Request> {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if reader.read_line(&mut head).ok()? == 0 {
            return None;
        }
    }
    let length = head.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        let named = name.eq_ignore_ascii_case("content-length");
        named.then(|| value.trim().parse().ok())?
    });
    let mut body = vec![0; length?];
    reader.read_exact(&mut body).ok()?;
    let body = serde_json::from_slice(&body).unwrap();
    Some(Request { head, body })
}

/// The client may hang up at any time.
fn write(mut stream: TcpStream, response: Response) {
    let (status, header, length, body) = match response {
        Response::Whole(status, header, body) => (status, header, Some(body.len()), body),
        Response::BrokenOff(body) => (200, "", Some(body.len() + 1000), body),
        Response::HangUp => return,
        Response::Endless => (200, "", None, String::new()),
    };
    let length_line = length.map(|length| format!("Content-Length: {length}\r\n"));
    let head = format!(
        "HTTP/1.1 {status} Test\r\nContent-Type: application/json\r\nConnection: close\r\n{}{header}\r\n",
        length_line.unwrap_or_default()
    );
    let mut written = stream.write_all(head.as_bytes());
    written = written.and_then(|()| stream.write_all(body.as_bytes()));
    while length.is_none() && written.is_ok() {
        written = stream.write_all(&[b' '; 1 << 16]);
    }
}
