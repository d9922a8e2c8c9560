//! Both sides of the parts protocol over a simulated network that loses, repeats and reorders, with a simulated clock.

use super::{
    inbox::{Inbox, WholeMessage},
    message::{Mail, MessageId, PART, PartMessage},
    outbox::{Outbox, Retention},
};
use crate::dds::identity::Peer;
use bytes::Bytes;
use proptest::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

const WRITER: [u8; 16] = [7; 16];
const HOME: Peer = [7; 12];
const STEP: Duration = Duration::from_millis(1);
const DEPTH: usize = 5;

/// One writer, and readers in other participants.
struct Network {
    now: Instant,
    outbox: Outbox,
    inboxes: BTreeMap<Peer, Inbox>,
    /// Readers that neither receive nor send.
    stopped: BTreeSet<Peer>,
    depth: usize,
    /// Receiver, and mail with its sender.
    flying: Vec<(Peer, Mail)>,
    got: BTreeMap<Peer, Vec<WholeMessage>>,
    /// Decides the fate of each delivery.
    fate: Box<dyn FnMut() -> Fate>,
    /// The most parts that one reader had requested at once.
    most: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    Arrives,
    Lost,
    Twice,
    Last,
}

impl Network {
    fn new(
        keep: Retention,
        depth: usize,
        readers: u8,
        fate: impl FnMut() -> Fate + 'static,
    ) -> Self {
        let mut outbox = Outbox::default();
        outbox.open(WRITER, keep, 10);
        Self {
            now: Instant::now(),
            outbox,
            inboxes: (0..readers)
                .map(|reader| ([reader; 12], Inbox::default()))
                .collect(),
            stopped: BTreeSet::new(),
            depth,
            flying: Vec::new(),
            got: BTreeMap::new(),
            fate: Box::new(fate),
            most: 0,
        }
    }

    /// Returns how many messages were dropped for slow readers.
    fn publish(&mut self, bytes: &Bytes) -> u64 {
        let (peers, mut mail) = (self.inboxes.keys().copied().collect(), Vec::new());
        let offered = self
            .outbox
            .offer(self.now, &WRITER, bytes, 0, peers, &mut mail)
            .unwrap();
        self.flying
            .extend(mail.into_iter().map(|mail| (HOME, mail)));
        offered.dropped
    }

    fn is_settled(&self) -> bool {
        self.outbox.is_settled(self.now, &WRITER, i64::MAX)
    }

    /// Advances by a millisecond: does what is due, and delivers or loses mail.
    fn step(&mut self) {
        self.now += STEP;
        let mut mail = Vec::new();
        let all: BTreeSet<Peer> = self.inboxes.keys().copied().collect();
        self.outbox.repeat(self.now, |_| all.clone(), &mut mail);
        self.flying.extend(mail.drain(..).map(|mail| (HOME, mail)));
        let mut arriving: Vec<_> = self.flying.drain(..).collect();
        let mut late = Vec::new();
        arriving.retain(|delivery| {
            let fate = (self.fate)();
            if matches!(fate, Fate::Last | Fate::Twice) {
                late.push(delivery.clone());
            }
            matches!(fate, Fate::Arrives | Fate::Twice)
        });
        let mut parts = BTreeMap::<Peer, usize>::new();
        for (from, Mail { to, message }) in arriving.into_iter().chain(late) {
            if self.stopped.contains(&from) || self.stopped.contains(&to) {
                continue;
            }
            // as on the wire
            let message = PartMessage::decode(&message.encode().unwrap()).unwrap();
            match (message, self.inboxes.get_mut(&to)) {
                (PartMessage::Offer { of, first, head }, Some(inbox)) => {
                    inbox.offered(self.now, from, (of, first, head), self.depth, &mut mail);
                }
                (PartMessage::Part { of, index, bytes }, Some(inbox)) => {
                    *parts.entry(to).or_default() += 1;
                    inbox.came(self.now, of, index, bytes);
                }
                (PartMessage::Gone { id }, Some(inbox)) => inbox.gone(&id),
                (PartMessage::Want { id, index }, None) => {
                    self.outbox.wanted(self.now, from, id, index, &mut mail);
                }
                (PartMessage::Settled { id }, None) => self.outbox.settled(self.now, from, id),
                (message, _) => panic!("{message:?} to the wrong side"),
            }
            let from = to;
            self.flying.extend(mail.drain(..).map(|mail| (from, mail)));
        }
        self.most = self.most.max(parts.values().copied().max().unwrap_or(0));
        for (peer, inbox) in &mut self.inboxes {
            if self.stopped.contains(peer) {
                continue;
            }
            let wholes = inbox.advance(self.now, &mut mail);
            self.got.entry(*peer).or_default().extend(wholes);
            self.flying.extend(mail.drain(..).map(|mail| (*peer, mail)));
        }
    }

    fn numbers(&self, reader: u8) -> Vec<i64> {
        let got = self.got.get(&[reader; 12]);
        got.into_iter()
            .flatten()
            .map(|whole| whole.of.id.number)
            .collect()
    }
}

fn message(index: usize, len: usize) -> Bytes {
    (0..len.max(1)).map(|at| (at / 7 + index) as u8).collect()
}

/// Loses, repeats or delays one delivery in four, by the generator of Steele, Lea and Flood (SplitMix64).
fn weather(mut seed: u64) -> impl FnMut() -> Fate {
    move || {
        seed = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (seed ^ (seed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        match (mixed ^ (mixed >> 31)) % 16 {
            0 | 1 => Fate::Lost,
            2 => Fate::Twice,
            3 => Fate::Last,
            _ => Fate::Arrives,
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Readers receive every message of a reliable writer once, whole and in order; then nothing is kept.
    #[test]
    fn reliable_messages_come_once_and_in_order(
        lengths in prop::collection::vec(1..4 * PART, 1..6),
        seed in any::<u64>(),
    ) {
        let mut network = Network::new(Retention::All(9), 9, 2, weather(seed));
        for (index, len) in lengths.iter().enumerate() {
            prop_assert_eq!(network.publish(&message(index, *len)), 0);
            network.step();
        }
        for _ in 0..30_000 {
            network.step();
            if network.is_settled() { break; }
        }
        prop_assert!(network.is_settled(), "not settled");
        prop_assert_eq!(network.outbox.due(), None);
        for reader in 0..2 {
            let numbers: Vec<i64> = (11..11 + lengths.len() as i64).collect();
            prop_assert_eq!(network.numbers(reader), numbers);
            for (index, whole) in network.got[&[reader; 12]].iter().enumerate() {
                prop_assert_eq!(&whole.bytes, &message(index, lengths[index]));
            }
        }
    }

    /// Readers receive messages of a best-effort writer whole, once and in order, the last one included.
    #[test]
    fn best_effort_messages_arrive_in_order_with_the_last(
        number in 1usize..20,
        seed in any::<u64>(),
    ) {
        let mut network = Network::new(Retention::Last(DEPTH), DEPTH, 1, weather(seed));
        for index in 0..number {
            network.publish(&message(index, 3 * PART));
            network.step();
        }
        for _ in 0..5_000 {
            network.step();
        }
        let numbers = network.numbers(0);
        prop_assert!(numbers.is_sorted_by(|a, b| a < b), "{:?}", numbers);
        prop_assert_eq!(numbers.last(), Some(&(10 + number as i64)));
        for whole in &network.got[&[0; 12]] {
            prop_assert_eq!(&whole.bytes, &message(whole.of.id.number as usize - 11, 3 * PART));
        }
    }
}

#[test]
fn requested_parts_fit_into_a_receive_buffer() {
    let mut network = Network::new(Retention::Last(DEPTH), DEPTH, 1, || Fate::Arrives);
    for index in 0..DEPTH {
        network.publish(&message(index, 9 * PART));
    }
    for _ in 0..40 {
        network.step();
    }
    assert_eq!(network.numbers(0), [11, 12, 13, 14, 15]);
    assert!(network.most <= 3, "{} parts at once", network.most);
}

#[test]
fn parts_are_rarely_requested_twice_on_a_slow_network() {
    const LATE: Duration = Duration::from_millis(70);
    let (mut inbox, mut outbox, mut now) = (Inbox::default(), Outbox::default(), Instant::now());
    let (reader, mut mail) = ([1; 12], Vec::new());
    outbox.open(WRITER, Retention::Last(DEPTH), 0);
    let bytes = message(0, 40 * PART);
    outbox
        .offer(now, &WRITER, &bytes, 0, [reader].into(), &mut mail)
        .unwrap();
    let Some(PartMessage::Offer { of, first, head }) = mail.pop().map(|mail| mail.message) else {
        panic!("one offer")
    };
    inbox.offered(now, HOME, (of, first, head), DEPTH, &mut mail);
    let (mut flying, mut asked, mut wholes) = (Vec::new(), 0, Vec::new());
    while wholes.is_empty() && asked < 999 {
        now += STEP;
        wholes = inbox.advance(now, &mut mail);
        for Mail { message, .. } in mail.drain(..) {
            if let PartMessage::Want { index, .. } = message {
                asked += 1;
                flying.push((now + LATE, index));
            }
        }
        flying.retain(|(arrives, index)| {
            if *arrives <= now {
                inbox.came(now, of, *index, bytes.slice(of.range(*index)));
            }
            *arrives > now
        });
    }
    assert_eq!(wholes.len(), 1);
    assert!(asked < 60, "39 parts were asked for {asked} times");
}

#[test]
fn stopped_reader_delays_no_other_and_costs_the_kept_messages() {
    let mut network = Network::new(Retention::Last(DEPTH), DEPTH, 2, || Fate::Arrives);
    network.stopped.insert([1; 12]);
    for index in 0..50 {
        network.publish(&message(index, 2 * PART));
        for _ in 0..20 {
            network.step();
        }
    }
    assert_eq!(network.numbers(0), (11..61).collect::<Vec<_>>());
    // it goes on from the first message that the writer keeps
    network.stopped.clear();
    for _ in 0..3_000 {
        network.step();
    }
    assert_eq!(network.numbers(1), [56, 57, 58, 59, 60]);
    assert!(network.is_settled());
}

#[test]
fn very_large_messages_are_kept_up_to_the_byte_limit() {
    let (mut outbox, now, mut mail) = (Outbox::default(), Instant::now(), Vec::new());
    outbox.open(WRITER, Retention::Last(DEPTH), 0);
    let bytes = message(0, 30 << 20);
    for _ in 0..3 {
        let reader = [1; 12];
        outbox
            .offer(now, &WRITER, &bytes, 0, [reader].into(), &mut mail)
            .unwrap();
    }
    mail.clear();
    for number in 1..=3 {
        let id = MessageId {
            writer: WRITER,
            number,
        };
        outbox.wanted(now, [1; 12], id, 1, &mut mail);
    }
    let is_kept: Vec<bool> = mail
        .iter()
        .map(|mail| matches!(mail.message, PartMessage::Part { .. }))
        .collect();
    assert_eq!(is_kept, [false, true, true], "64 MiB are kept");
}

#[test]
fn stopped_reliable_reader_loses_the_oldest_messages() {
    const COUNT: usize = 40;
    let mut network = Network::new(Retention::All(9), 9, 2, || Fate::Arrives);
    network.stopped.insert([1; 12]);
    let mut dropped = 0;
    for index in 0..COUNT {
        dropped += network.publish(&message(index, 2 * PART));
        for _ in 0..20 {
            network.step();
        }
    }
    assert_eq!(
        network.numbers(0),
        (11..11 + COUNT as i64).collect::<Vec<_>>()
    );
    assert_eq!(dropped, (COUNT - 9) as u64);
    assert!(network.outbox.is_full(network.now, &WRITER));
    assert!(!network.is_settled());

    // after seconds of silence, only the newest is kept
    for _ in 0..5_000 {
        network.step();
    }
    assert!(network.is_settled() && !network.outbox.is_full(network.now, &WRITER));
    dropped = network.publish(&message(COUNT, 2 * PART));
    assert_eq!(dropped, 9);

    // it goes on with the newest
    network.stopped.clear();
    for _ in 0..2_000 {
        network.step();
    }
    assert_eq!(network.numbers(1), [11 + COUNT as i64]);
    assert_eq!(network.outbox.due(), None);
    assert_eq!(network.publish(&message(0, PART)), 0);
    for _ in 0..20 {
        network.step();
    }
    assert_eq!(network.numbers(1).len(), 2);
}

#[test]
fn parts_go_only_to_readers_with_an_offer() {
    let (mut outbox, now, mut mail) = (Outbox::default(), Instant::now(), Vec::new());
    outbox.open(WRITER, Retention::Last(DEPTH), 0);
    let (reader, stranger) = ([1; 12], [2; 12]);
    let bytes = message(0, 3 * PART);
    outbox.offer(now, &WRITER, &bytes, 0, [reader].into(), &mut mail);
    mail.clear();
    let id = MessageId {
        writer: WRITER,
        number: 1,
    };
    for peer in [reader, stranger] {
        outbox.wanted(now, peer, id, 1, &mut mail);
    }
    let is_part = |mail: &Mail| matches!(mail.message, PartMessage::Part { .. });
    let parts: Vec<bool> = mail.iter().map(is_part).collect();
    assert_eq!(parts, [true, false]);
}

#[test]
fn departed_reader_is_not_awaited() {
    let mut outbox = Outbox::default();
    outbox.open(WRITER, Retention::All(9), 0);
    let (mut mail, now) = (Vec::new(), Instant::now());
    outbox
        .offer(
            now,
            &WRITER,
            &message(0, PART),
            0,
            [[1; 12]].into(),
            &mut mail,
        )
        .unwrap();
    assert!(!outbox.is_settled(now, &WRITER, 1));
    let due = outbox.due().unwrap();
    outbox.repeat(due, |_| BTreeSet::new(), &mut mail);
    assert!(outbox.is_settled(due, &WRITER, 1));
}

#[test]
fn stopped_writer_delays_no_other() {
    let (mut inbox, mut now, mut mail) = (Inbox::default(), Instant::now(), Vec::new());
    let mut outboxes = [Outbox::default(), Outbox::default()];
    for (outbox, byte) in outboxes.iter_mut().zip([1, 2]) {
        outbox.open([byte; 16], Retention::Last(1), 0);
        let bytes = message(0, 9 * PART);
        outbox
            .offer(now, &[byte; 16], &bytes, 0, [HOME].into(), &mut mail)
            .unwrap();
    }
    for Mail { message, .. } in mail.drain(..) {
        let PartMessage::Offer { of, first, head } = message else {
            continue;
        };
        let mut from = HOME;
        from.copy_from_slice(&of.id.writer[..12]);
        inbox.offered(now, from, (of, first, head), 1, &mut Vec::new());
    }
    let (mut wholes, mut wants) = (Vec::new(), Vec::new());
    for _ in 0..100 {
        wholes.extend(inbox.advance(now, &mut wants));
        for Mail { to, message } in wants.drain(..) {
            let PartMessage::Want { id, index } = message else {
                continue;
            };
            if to == [2; 12] {
                outboxes[1].wanted(now, HOME, id, index, &mut mail);
            }
        }
        for Mail { message, .. } in mail.drain(..) {
            let PartMessage::Part { of, index, bytes } = message else {
                continue;
            };
            inbox.came(now, of, index, bytes);
        }
        now += STEP;
    }
    assert_eq!(wholes.len(), 1);
    assert_eq!(wholes[0].of.id.writer, [2; 16]);
    now += Duration::from_secs(5);
    inbox.advance(now, &mut wants);
    assert!(
        wants.iter().any(
            |mail| matches!(&mail.message, PartMessage::Settled { id } if id.writer == [1; 16])
        ),
        "the other is given up"
    );
}

#[test]
fn only_the_writers_participant_may_offer_and_send() {
    let (mut outbox, mut mail) = (Outbox::default(), Vec::new());
    outbox.open(WRITER, Retention::Last(1), 0);
    let (now, bytes) = (Instant::now(), message(0, PART + 1));
    outbox
        .offer(now, &WRITER, &bytes, 0, [[1; 12]].into(), &mut mail)
        .unwrap();
    let PartMessage::Offer { of, .. } = mail[0].message else {
        panic!("an offer")
    };
    outbox.wanted(now, [1; 12], of.id, 1, &mut mail);
    outbox.wanted(now, [1; 12], of.id, 2, &mut mail);
    let senders: Vec<_> = mail
        .iter()
        .map(|mail| mail.message.required_sender())
        .collect();
    assert_eq!(
        senders,
        [Some(&WRITER); 3],
        "an offer, a part, and what is gone"
    );
    let id = of.id;
    assert_eq!(PartMessage::Want { id, index: 0 }.required_sender(), None);
    assert_eq!(PartMessage::Settled { id }.required_sender(), None);
}
