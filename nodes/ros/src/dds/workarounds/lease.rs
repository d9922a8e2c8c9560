//! Leases of participants. rustdds 0.15.1 makes a temporary loss permanent in four ways:
//!
//! - **A participant loses itself.** It discovers itself by its own announcements, which multicast returns, with a
//!   lease of 50 s. It announces itself only if it knows a participant. After a cut of that length it knows none, and
//!   never announces itself again. [`OwnPort::keep_alive`] keeps its own lease.
//! - **It announces itself only every 10 s**, and at once when it discovers a participant. So it is made to discover a
//!   fictitious participant every few seconds: other participants then rediscover it sooner.
//! - **A lost Fast DDS participant is never discovered again.** Its announcements all have the number 1. rustdds
//!   accepts a number once while it is among the last 64 announcements of all participants. When a lease has run out,
//!   announcements of the fictitious participant displace them.
//! - **A participant that has lost this one, but is not lost itself, never receives the announcements of endpoints
//!   again.** rustdds assumes that its readers have them. Packet loss in one direction causes this. So its lease ends
//!   early ([`super::one_way`]), and it is discovered anew.
//!
//! All these messages go to the own participant only, in its own name or in that of the fictitious participant.

use super::rtps;
use crate::{backend::EndpointId, dds::identity::Peer};
use std::{
    io,
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    sync::atomic::{AtomicI64, Ordering},
    time::Duration,
};

/// How often Fast DDS announces a participant.
const PERIOD: Duration = Duration::from_secs(3);
/// Announcements that rustdds remembers (the limit of `TopicCache` without resource limits), and one more.
const REMEMBERED: i64 = 65;
/// rustdds removes the oldest when a number is a multiple of this.
const CLEARED_AT: i64 = 64;

/// The way to a participant of this process.
pub(in crate::dds) struct OwnPort {
    socket: UdpSocket,
    own: EndpointId,
    to: SocketAddr,
    /// The number of the fictitious participant's last announcement.
    number: AtomicI64,
}

impl OwnPort {
    /// `address`: of a used interface. From a loopback address, rustdds would send to itself by loopback alone. `port`:
    /// where the participant receives announcements.
    pub(in crate::dds) fn new(own: EndpointId, address: Ipv4Addr, port: u16) -> io::Result<Self> {
        let socket = UdpSocket::bind((address, 0))?;
        socket.set_nonblocking(true)?;
        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let number = AtomicI64::new(0);
        Ok(Self {
            socket,
            own,
            to,
            number,
        })
    }

    /// Displaces the announcements that rustdds remembers.
    pub(in crate::dds) fn forget_announcements(&self) {
        let last = self.number.fetch_add(REMEMBERED, Ordering::Relaxed);
        let numbers = (last + 1)..=(last + REMEMBERED);
        let numbers = numbers.map(|number| number * CLEARED_AT);
        self.send(&rtps::departures(&self.own, numbers));
    }

    /// Ends the lease of another participant.
    pub(in crate::dds) fn expire(&self, peer: &Peer) {
        self.send(&rtps::expiry(&self.own, peer, self.next_number()));
    }

    /// A number between those of [`Self::forget_announcements`], with room for the next.
    fn next_number(&self) -> i64 {
        self.number.fetch_add(1, Ordering::Relaxed) * CLEARED_AT + 1
    }

    /// Keeps the participant's own lease and announces it, while it exists.
    pub(in crate::dds) async fn keep_alive(&self) {
        let mut period = tokio::time::interval(PERIOD);
        loop {
            period.tick().await;
            self.send(&rtps::life_sign(&self.own));
            self.send(&rtps::visit(&self.own, self.next_number()));
        }
    }

    fn send(&self, message: &[u8]) {
        if let Err(error) = self.socket.send_to(message, self.to) {
            tracing::debug!("cannot send to the own participant: {error}");
        }
    }
}
