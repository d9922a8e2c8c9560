//! A participant that comes while endpoints are made: it hears of them in their order.

use super::{
    announcement::{announcement, header, words},
    harness::{PATIENCE, context, fresh_domain, node},
};
use std::{
    net::{Ipv4Addr, UdpSocket},
    time::Instant,
};
use wm_msgs::std_msgs;
use wm_ros::Qos;

/// eProsima, of Fast DDS.
const FAST_DDS: u8 = 0x0f;
/// The writer that announces writers, and its readers (DDSI-RTPS 2.5, 8.5.4).
const WRITERS: [u8; 4] = [0, 0, 3, 0xc2];
const READERS_OF_WRITERS: [u8; 4] = [0, 0, 3, 0xc7];
/// Participants of a domain on this host that are talked to.
const PARTICIPANTS: u16 = 4;

/// A participant of Fast DDS as far as this test needs it.
struct Newcomer {
    socket: UdpSocket,
    domain: u16,
    /// Of its acknowledgements.
    count: u32,
    /// The numbers of announcements of writers as they came.
    came: Vec<u32>,
}

impl Newcomer {
    fn new(domain: u16) -> Self {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        let newcomer = Self {
            socket,
            domain,
            count: 0,
            came: Vec::new(),
        };
        let port = newcomer.socket.local_addr().unwrap().port();
        newcomer.say(&announcement(FAST_DDS, Ipv4Addr::LOCALHOST, port));
        newcomer
    }

    fn say(&self, message: &[u8]) {
        for participant in 0..PARTICIPANTS {
            let port = 7400 + 250 * self.domain + 10 + 2 * participant;
            // Where nobody listens, the system may say so.
            let _ = self.socket.send_to(message, (Ipv4Addr::LOCALHOST, port));
        }
    }

    /// Asks for the announcements up to `last` that have not come.
    fn ask(&mut self, of: &[u8], last: u32) {
        let mut missing = vec![0_u32; last.div_ceil(32) as usize];
        for number in (1..=last).filter(|number| !self.came.contains(number)) {
            let bit = number - 1;
            missing[bit as usize / 32] |= 1 << (31 - bit % 32);
        }
        self.count += 1;
        let acknack = [
            &READERS_OF_WRITERS[..],
            &WRITERS,
            &words(&[0, 1, last]),
            &words(&missing),
            &words(&[self.count]),
        ]
        .concat();
        let length = (acknack.len() as u16).to_le_bytes();
        let message = [
            &header(FAST_DDS)[..],
            &[0x0e, 1, 12, 0],
            of,
            &[0x06, 1],
            &length,
            &acknack,
        ];
        self.say(&message.concat());
    }

    /// Hears the next datagram; asks for what a heartbeat says is there and has not come.
    fn hear(&mut self) {
        let mut buffer = [0; 1 << 16];
        let length = self.socket.recv(&mut buffer).unwrap();
        let datagram = &buffer[..length];
        let word = |at: usize| u32::from_le_bytes(datagram[at..at + 4].try_into().unwrap());
        let mut at = 20;
        while at + 4 <= length {
            let (kind, size) = (
                datagram[at],
                usize::from(u16::from_le_bytes([datagram[at + 2], datagram[at + 3]])),
            );
            let body = at + 4;
            match kind {
                // DATA
                0x15 if datagram[body + 8..body + 12] == WRITERS => {
                    // One that was asked for twice may come twice.
                    let number = word(body + 16);
                    if !self.came.contains(&number) {
                        self.came.push(number);
                    }
                }
                // HEARTBEAT
                0x07 if datagram[body + 4..body + 8] == WRITERS => {
                    let last = word(body + 20);
                    if (1..=last).any(|number| !self.came.contains(&number)) {
                        self.ask(&datagram[8..20], last);
                    }
                }
                _ => {}
            }
            at = body + size;
        }
    }
}

/// Whether a newcomer hears of writers in their order, one of which is made as soon as it is known.
fn hears_in_order(domain: u16) -> bool {
    let context = context(domain);
    let node = node(&context, "host", "");
    let made = |name| {
        node.publisher::<std_msgs::String>(name, Qos::reliable(1))
            .unwrap()
    };
    let _first = made("/first");
    let mut newcomer = Newcomer::new(domain);
    newcomer.hear(); // it is known
    std::thread::scope(|scope| {
        let late = scope.spawn(|| made("/late"));
        while !late.is_finished() {
            newcomer.hear();
        }
        let _late = late.join().unwrap();
        let begin = Instant::now();
        let mut all = 0;
        // The last of all comes after that: every number up to it.
        while all == 0 || newcomer.came.len() < all {
            assert!(begin.elapsed() < PATIENCE, "{:?}", newcomer.came);
            newcomer.hear();
            all = newcomer.came.iter().max().map_or(0, |last| *last as usize);
        }
    });
    newcomer.came.is_sorted()
}

/// Fast DDS drops what comes out of order without a timestamp (`catch_up`).
#[test]
fn a_newcomer_of_fast_dds_hears_of_writers_in_their_order() {
    // A machine that stands still for a quarter of a second may have it otherwise, but not three times.
    let heard = (0..3).any(|_| hears_in_order(fresh_domain()));
    assert!(
        heard,
        "a new writer was announced before those that were there"
    );
}
