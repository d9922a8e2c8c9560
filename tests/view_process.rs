//! A running `wm view` for clients, and its camera.

use std::{io::Read as _, time::Duration};

use crate::{
    harness::{Process, bundled_bag, wm},
    websocket::{Socket, open, request},
};

/// Far longer than needed; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A running view with its page.
pub struct View {
    pub port: u16,
    pub process: Process,
}

impl View {
    /// A view on a port that the system chooses.
    pub fn start(domain: u16, args: &[&str]) -> Self {
        Self::start_at(domain, 0, args)
    }

    /// A view on `port`, once it serves its page.
    pub fn start_at(domain: u16, port: u16, args: &[&str]) -> Self {
        let port = port.to_string();
        let process = Process::start(wm(domain, &[&["view", "--port", &port], args].concat()));
        let port = page_port(&process);
        Self { port, process }
    }

    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    pub fn open(&self) -> Socket {
        let (status, socket) = open(self.port, &[]);
        socket.unwrap_or_else(|| panic!("the socket is refused with {status}"))
    }
}

/// The port of the page that `process`, a view or the launch of one, serves.
pub fn page_port(process: &Process) -> u16 {
    let url = process.printed("the page is at http://", PATIENCE);
    let (host, _) = url.split_once('/').unwrap_or_else(|| panic!("{url}"));
    let port = host.rsplit(':').next().and_then(|port| port.parse().ok());
    port.unwrap_or_else(|| panic!("no port: {url}"))
}

/// A camera: the bundled bag in a loop with current stamps, at a multiple of its 5 Hz.
pub fn player(domain: u16, rate: &str) -> Process {
    let bag = bundled_bag();
    let bag = bag.to_string_lossy();
    let args = ["bag", "play", "--loop", "--restamp", "--rate", rate, &bag];
    Process::start(wm(domain, &args))
}

/// The body of the response for a path.
pub fn body(port: u16, path: &str, headers: &[(&str, &str)]) -> (u16, Vec<u8>) {
    let (status, mut stream) = request(port, path, &[headers, &[("Connection", "close")]].concat());
    let mut body = Vec::new();
    stream.read_to_end(&mut body).expect("a body");
    (status, body)
}
