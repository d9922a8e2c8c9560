//! Leases of participants, where rustdds 0.15.1 makes a temporary loss permanent.
//!
//! - **A participant loses itself.** It knows itself by its own announcements, which multicast brings back, and by their
//!   lease of 50 s. It announces itself where it knows participants. After a cut of that length it knows none, and never
//!   announces itself again. So it receives a sign of life from here.
//! - **It announces itself every 10 s only**, and at once when it discovers a participant. So that others discover it
//!   sooner after a cut, it discovers a fictitious participant every few seconds.
//! - **A participant of Fast DDS that was lost is never discovered again.** Its announcements all have the number 1.
//!   rustdds takes each number once, for as long as it is among the last 64 announcements of all participants. So
//!   announcements of the fictitious participant displace them when a lease has run out.
//! - **A participant that has lost this one, and is not lost itself, never receives the announcements of the endpoints
//!   again.** rustdds assumes that its readers have them. Packets that are lost in one direction cause this. So the lease
//!   of a participant ends here once it has acknowledged nothing for longer than that lease, and it is discovered anew.
//!
//! All this goes to the participant of this process only, in its own name or in that of the fictitious participant.

use super::{parts::Peer, rtps};
use crate::backend::EndpointId;
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
/// It clears out the oldest when a number is a multiple of this.
const CLEARED_AT: i64 = 64;

/// The way to a participant of this process.
pub(in crate::dds) struct OwnPort {
    socket: UdpSocket,
    own: EndpointId,
    to: SocketAddr,
    /// Of the fictitious participant's last announcement.
    number: AtomicI64,
}

impl OwnPort {
    /// `address`: of the interface that it uses. If it received from loopback, rustdds would send to itself by loopback
    /// alone. `port`: where it receives announcements.
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

    /// Keeps the participant's own lease, and announces it, for as long as it exists.
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
