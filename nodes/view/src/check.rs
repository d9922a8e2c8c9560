//! Checks before the start.

use crate::{NODE, ViewError, parameters::PORT};
use anyhow::Result;
use socket2::{Domain, Socket, Type};
use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr},
};
use wm_ros::{NAMESPACE, NodeArgs};

/// Checks that the view's port is free: a launch would otherwise restart it in vain.
///
/// # Errors
/// The view's own error.
pub fn check(args: &NodeArgs) -> Result<()> {
    let ip = match args.given::<String>(NODE.name, NAMESPACE, "address")? {
        Some(address) => match address.parse() {
            Ok(ip) => ip,
            Err(_) => return Err(ViewError::Address(address).into()),
        },
        None => IpAddr::V4(Ipv4Addr::LOCALHOST),
    };
    let port = args.given::<i64>(NODE.name, NAMESPACE, "port")?;
    // an invalid port is the view's own error
    let Ok(port) = port.map_or(Ok(PORT), u16::try_from) else {
        return Ok(());
    };
    let address = SocketAddr::new(ip, port);
    bind(address).map_err(|reason| ViewError::Listen { address, reason })?;
    Ok(())
}

/// Binds a socket, for a moment. It does not listen: a browser that is waiting for the page would connect to it.
fn bind(address: SocketAddr) -> io::Result<()> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, None)?;
    // like the server's: connections of the run before do not keep the port
    socket.set_reuse_address(true)?;
    socket.bind(&address.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn error_names_a_taken_port() {
        let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = taken.local_addr().unwrap().port();
        let check = |port: u16| {
            let words = ["--ros-args", "-p", &format!("port:={port}")].map(str::to_owned);
            check(&NodeArgs::parse(words).unwrap())
        };
        let error = check(port).unwrap_err().to_string();
        assert!(error.contains(&format!("127.0.0.1:{port}")), "{error}");
        check(0).unwrap();
        drop(taken);
        check(port).unwrap();
    }
}
