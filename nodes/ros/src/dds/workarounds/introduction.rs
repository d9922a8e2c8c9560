//! Announcements to the participants of this host that rustdds skips.
//!
//! Loopback usually has no multicast. rustdds 0.15.1 then announces a participant only to the first twelve participant
//! numbers of the domain: two participants with higher numbers would never discover each other. So each participant
//! sends its first announcement to the other numbers too. A receiver replies, and from then on rustdds announces itself
//! to both.

use super::{rtps, socket_filter::Ports};
use crate::backend::EndpointId;
use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    time::Duration,
};

/// The participant numbers that rustdds tries (DDSI-RTPS 2.5, 9.6.2.3).
const NUMBERS: u16 = 120;
/// The numbers to which rustdds announces itself (`SPDP_LOCALHOST_PEER_COUNT`).
const ANNOUNCED: u16 = 12;
/// Pauses between announcements; the last one repeats. Datagrams are lost if many participants start at once.
const PAUSES: [Duration; 4] = [
    Duration::from_millis(200),
    Duration::from_secs(1),
    Duration::from_secs(3),
    Duration::from_secs(10),
];

/// The largest number of participants of a domain on one host. The highest domains have fewer ports.
pub(in crate::dds) fn participants_of(domain: u16) -> u16 {
    let numbers = 0..NUMBERS;
    numbers
        .take_while(|number| Ports::new(domain, *number).fit())
        .last()
        .map_or(0, |last| last + 1)
}

/// Announces the participant `own` with this number while it exists.
pub(in crate::dds) async fn introduce(
    socket: UdpSocket,
    own: EndpointId,
    domain: u16,
    participant: u16,
) {
    let ports = Ports::new(domain, participant);
    let message = rtps::announcement(&own, ports.discovery(), ports.user());
    let mut pauses = PAUSES.iter();
    let mut pause = Duration::ZERO;
    loop {
        for other in (ANNOUNCED..participants_of(domain)).filter(|other| *other != participant) {
            let port = Ports::new(domain, other).discovery();
            let to = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
            // the number may be free, and the next round replaces a lost datagram
            if let Err(error) = socket.send_to(&message, to) {
                tracing::debug!("cannot announce to {to}: {error}");
            }
        }
        if let Some(next) = pauses.next() {
            pause = *next;
        }
        tokio::time::sleep(pause).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn highest_domains_have_fewer_participants() {
        assert_eq!([0, 100, 231].map(participants_of), [NUMBERS; 3]);
        // 7400 + 250 * 232 + 11 + 2 * 62 = 65535
        assert_eq!(participants_of(232), 63);
    }
}
