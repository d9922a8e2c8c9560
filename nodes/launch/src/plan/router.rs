//! The Zenoh router of a launch.

use super::process::Process;
use std::{
    net::{SocketAddr, TcpStream},
    time::Duration,
};

/// Loopback answers at once.
const CONNECT_LIMIT: Duration = Duration::from_millis(500);
/// A router that starts first, and ends last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Router {
    /// The addresses that programs look for it at: one of them is enough.
    pub(crate) addresses: Vec<SocketAddr>,
    /// The router itself.
    pub process: Process,
}

impl Router {
    /// Whether a program accepts connections at its address.
    pub(crate) fn is_running(&self) -> bool {
        let connects = |address| TcpStream::connect_timeout(address, CONNECT_LIMIT).is_ok();
        self.addresses.iter().any(connects)
    }
}
