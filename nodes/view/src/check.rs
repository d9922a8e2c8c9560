//! Checks that are possible before anything starts.

use crate::{NODE, ViewError, parameters::PORT};
use anyhow::Result;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use wm_ros::{NAMESPACE, NodeArgs};

/// Whether a view with these arguments can have its port at present: a launch that starts it again and again would only
/// repeat that it cannot.
///
/// # Errors
/// As the view would say it.
pub fn check(args: &NodeArgs) -> Result<()> {
    let ip = match args.given::<String>(NODE.name, NAMESPACE, "address")? {
        Some(address) => match address.parse() {
            Ok(ip) => ip,
            Err(_) => return Err(ViewError::Address(address).into()),
        },
        None => IpAddr::V4(Ipv4Addr::LOCALHOST),
    };
    let port = args.given::<i64>(NODE.name, NAMESPACE, "port")?;
    // The view names a number that is no port.
    let Ok(port) = port.map_or(Ok(PORT), u16::try_from) else {
        return Ok(());
    };
    let address = SocketAddr::new(ip, port);
    TcpListener::bind(address).map_err(|reason| ViewError::Listen { address, reason })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_taken_is_named() {
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
