//! The process that listens on a port of this host, for errors.

use std::collections::BTreeSet;
use std::fs;

/// The kernel's tables of sockets, and there the state of a socket that listens.
struct Tables {
    paths: [&'static str; 2],
    state: &'static str,
}

const TCP: Tables = Tables {
    paths: ["/proc/net/tcp", "/proc/net/tcp6"],
    state: "0A",
};
/// A socket of UDP listens as long as it is not connected.
const UDP: Tables = Tables {
    paths: ["/proc/net/udp", "/proc/net/udp6"],
    state: "07",
};

/// The tables for the protocol of an endpoint.
fn tables(endpoint: &str) -> Tables {
    match endpoint.split_once('/') {
        Some(("quic" | "udp", _)) => UDP,
        _ => TCP,
    }
}

/// A port that is in use, and the processes that listen on it.
pub(super) fn of(endpoint: &str) -> Option<String> {
    let port = port(endpoint)?;
    let mut sockets = BTreeSet::new();
    let tables = tables(endpoint);
    for path in tables.paths {
        // a kernel without IPv6 has no second table
        let text = fs::read_to_string(path).unwrap_or_default();
        sockets.extend(sockets_of(&text, port, tables.state));
    }
    if sockets.is_empty() {
        return None;
    }
    let processes = processes_with(&sockets);
    let who = if processes.is_empty() {
        "a process of another user".to_owned()
    } else {
        processes.join(", ")
    };
    Some(format!("port {port} is in use by {who}"))
}

/// The port of an endpoint such as `tcp/[::]:7447#iface=eth0`.
fn port(endpoint: &str) -> Option<u16> {
    let address = endpoint.split(['?', '#']).next()?;
    address.rsplit_once(':')?.1.parse().ok()
}

/// The inodes of the sockets of `port` in this state, from the text of a table.
fn sockets_of(text: &str, port: u16, state: &str) -> Vec<String> {
    let of_line = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (_, hexadecimal) = fields.get(1)?.rsplit_once(':')?;
        let is_port = u16::from_str_radix(hexadecimal, 16) == Ok(port);
        let is_listening = fields.get(3) == Some(&state);
        let inode = fields.get(9).filter(|_| is_port && is_listening)?;
        Some((*inode).to_owned())
    };
    text.lines().filter_map(of_line).collect()
}

/// The processes of this user, or for root of all users, with one of these sockets.
fn processes_with(sockets: &BTreeSet<String>) -> Vec<String> {
    let has_socket = |id: u32| {
        let files = fs::read_dir(format!("/proc/{id}/fd")).ok();
        let mut links = files
            .into_iter()
            .flatten()
            .filter_map(|file| fs::read_link(file.ok()?.path()).ok());
        links.any(|link| {
            let link = link.to_string_lossy();
            let inode = link
                .strip_prefix("socket:[")
                .and_then(|link| link.strip_suffix(']'));
            inode.is_some_and(|inode| sockets.contains(inode))
        })
    };
    let described = |id: u32| {
        let words = fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        let words = String::from_utf8_lossy(&words).replace('\0', " ");
        format!(
            "process {id} ({})",
            wm_ros::logging::of_others(words.trim())
        )
    };
    let entries = fs::read_dir("/proc").into_iter().flatten();
    let ids = entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    ids.filter(|id| has_socket(*id)).map(described).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, UdpSocket};

    #[test]
    fn listener_is_named_by_its_process() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}#iface=lo", listener.local_addr().unwrap());
        let text = of(&endpoint).unwrap();
        let own = format!("process {} (", std::process::id());
        assert!(text.contains(&own), "{text}");
        drop(listener);
        assert_eq!(of(&endpoint), None);
        assert_eq!(of("unixsock-stream//tmp/x"), None);

        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("quic/{}", socket.local_addr().unwrap());
        let text = of(&endpoint).unwrap();
        assert!(text.contains(&own), "{text}");
    }

    #[test]
    fn only_listening_sockets_of_the_port_count() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n\
            0: 0100007F:1D17 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 42 1 0 100 0\n\
            1: 0100007F:1D17 0100007F:C350 01 00000000:00000000 00:00000000 00000000     0        0 43 1 0 100 0\n\
            2: 0100007F:1D18 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 44 1 0 100 0\n\
            3: broken\n";
        assert_eq!(sockets_of(table, 7447, TCP.state), ["42"]);
    }
}
