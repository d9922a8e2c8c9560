//! Large responses, and the socket for all datagrams that do not pass rustdds 0.15.1.
//!
//! rustdds misplaces the inline QoS of fragments by one byte, and the inline QoS names the request: **a fragmented
//! response never arrives.** So such a response leaves from here in one datagram, which the kernel fragments. rustdds
//! sends its own fragments after it, which clients ignore as a repetition.

use super::rtps;
use crate::backend::{EndpointId, RequestId};
use bytes::Bytes;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

pub(in crate::dds) struct Wire {
    socket: UdpSocket,
}

impl Wire {
    pub(in crate::dds) fn open() -> std::io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket })
    }

    /// For announcements.
    pub(in crate::dds) fn socket(&self) -> std::io::Result<UdpSocket> {
        self.socket.try_clone()
    }

    /// Sends a response to one reader.
    pub(in crate::dds) fn answer(
        &self,
        answer: &Answer,
        reader: &EndpointId,
        addresses: &[SocketAddr],
    ) {
        let Answer {
            writer,
            number,
            request,
            nanos,
            sample,
        } = answer;
        let message = rtps::answer(writer, *number, reader, request, *nanos, sample);
        for address in addresses {
            self.send(&message, *address);
        }
    }

    /// The caller repeats lost datagrams, if it matters.
    pub(in crate::dds) fn send(&self, message: &[u8], to: SocketAddr) {
        if let Err(error) = self.socket.send_to(message, to) {
            tracing::debug!("cannot send {} bytes to {to}: {error}", message.len());
        }
    }
}

/// A large response.
#[derive(Clone)]
pub(in crate::dds) struct Answer {
    pub(in crate::dds) writer: EndpointId,
    /// In the writer's numbering.
    pub(in crate::dds) number: i64,
    pub(in crate::dds) request: RequestId,
    /// When it was written \[ns since 1970\].
    pub(in crate::dds) nanos: i64,
    pub(in crate::dds) sample: Bytes,
}

/// The addresses at which a reader is reached. `own`: the addresses of this host. A loopback address counts only for
/// readers on this host; if `is_on_loopback`, only these are reached.
pub(in crate::dds) fn usable(
    announced: impl IntoIterator<Item = SocketAddr>,
    own: &[IpAddr],
    is_on_loopback: bool,
) -> Vec<SocketAddr> {
    let is_unicast = |address: &SocketAddr| {
        address.is_ipv4()
            && address.port() != 0
            && !address.ip().is_multicast()
            && !address.ip().is_unspecified()
    };
    let mut usable: Vec<_> = announced.into_iter().filter(is_unicast).collect();
    let is_here = |address: &SocketAddr| address.ip().is_loopback() || own.contains(&address.ip());
    let is_neighbor = usable.iter().all(is_here);
    usable.retain(|address| match is_neighbor {
        true => true,
        false => !is_on_loopback && !address.ip().is_loopback(),
    });
    // on this host, one address suffices
    if is_neighbor {
        usable.truncate(1);
    }
    usable
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_addresses_count_only_on_this_host() {
        let address = |text: &str| text.parse::<SocketAddr>().unwrap();
        let own = ["10.0.0.1".parse().unwrap()];
        let [lo, eth, other, group] = [
            "127.0.0.1:7411",
            "10.0.0.1:7411",
            "10.0.0.2:7411",
            "239.255.0.1:7401",
        ]
        .map(address);
        let at = |announced: &[SocketAddr], is_on_loopback| {
            usable(announced.iter().copied(), &own, is_on_loopback)
        };
        assert_eq!(at(&[group, lo], true), [lo]);
        assert_eq!(at(&[eth, lo], true), [eth]);
        assert_eq!(at(&[other, lo], false), [other], "another host's loopback");
        assert!(at(&[other, lo], true).is_empty());
    }
}
