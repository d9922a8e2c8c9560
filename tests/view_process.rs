//! A running `wm view` for clients, and its camera.

use std::{io::Read as _, net::TcpListener, time::Duration};

use crate::{
    harness::{Process, bundled_bag, wait_until, wm},
    websocket::{Socket, open, request},
};

/// Far longer than needed; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A free port.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    listener.local_addr().expect("an address").port()
}

/// A running view with its page.
pub struct View {
    pub port: u16,
    pub process: Process,
}

impl View {
    pub fn start(domain: u16, port: u16, args: &[&str]) -> Self {
        let port_text = port.to_string();
        let all = [&["view", "--port", &port_text], args].concat();
        let process = Process::start(wm(domain, &all));
        wait_until("the page is served", PATIENCE, || {
            std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
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
