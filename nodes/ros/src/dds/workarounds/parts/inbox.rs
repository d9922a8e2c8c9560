//! The readers' side of the parts protocol: requests parts, a few at a time, and assembles messages.

use super::message::{Mail, MessageId, Outline, PartMessage};
use crate::{backend::EndpointId, dds::identity::Peer};
use bytes::{Bytes, BytesMut};
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

/// Parts requested at once per participant. Three fit into half of Linux's default receive buffer of 208 KiB; the
/// kernel counts them twice.
const MOST_REQUESTS: usize = 3;

/// The wait before a part is requested again: this, or twice as long as parts of its writer take, and then twice the
/// last wait (as in RFC 6298 for TCP). On a slow network, further requests would delay a late part more.
const PATIENCE: Duration = Duration::from_millis(20);
const LONGEST_PATIENCE: Duration = Duration::from_millis(500);

/// A message without progress for this long is dropped.
const GIVE_UP: Duration = Duration::from_secs(5);

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct WholeMessage {
    pub(super) of: Outline,
    pub(super) bytes: Bytes,
}

#[derive(Clone, Copy)]
struct PartRequest {
    since: Instant,
    again: Instant,
    /// Whether it was requested more than once.
    is_late: bool,
}

/// An incomplete message.
struct Assembly {
    number: i64,
    /// `None` until a part or an offer arrives: the numbers of other messages show that this one exists.
    of: Option<Outline>,
    parts: BTreeMap<u32, Bytes>,
    wanted: BTreeMap<u32, PartRequest>,
    /// When something of it last arrived.
    seen: Instant,
}

impl Assembly {
    fn new(number: i64, now: Instant) -> Self {
        let (parts, wanted) = (BTreeMap::new(), BTreeMap::new());
        Self {
            number,
            of: None,
            parts,
            wanted,
            seen: now,
        }
    }

    fn is_whole(&self) -> bool {
        self.of
            .is_some_and(|of| self.parts.len() >= of.parts() as usize)
    }

    fn whole(&self) -> Option<WholeMessage> {
        let of = self.of.filter(|_| self.is_whole())?;
        let mut parts = self.parts.values();
        let bytes = match (self.parts.len(), parts.next()) {
            (1, Some(only)) => only.clone(),
            (_, first) => {
                let mut bytes = BytesMut::with_capacity(of.len);
                first
                    .into_iter()
                    .chain(parts)
                    .for_each(|part| bytes.extend_from_slice(part));
                bytes.freeze()
            }
        };
        Some(WholeMessage { of, bytes })
    }

    /// The next part to request.
    fn next(&self) -> Option<u32> {
        let parts = self.of.map_or(1, |of| of.parts());
        (0..parts).find(|index| !self.parts.contains_key(index) && !self.wanted.contains_key(index))
    }
}

struct Stream {
    peer: Peer,
    base: i64,
    /// Every message up to this number is delivered or dropped.
    settled: i64,
    patience: Duration,
    /// In order; only the first is requested.
    queue: VecDeque<Assembly>,
}

/// The remote writers that use parts.
#[derive(Default)]
pub(super) struct Inbox {
    streams: BTreeMap<EndpointId, Stream>,
}

impl Inbox {
    /// If this writer uses parts: its last number on the topic that counts.
    pub(super) fn base(&self, writer: &EndpointId) -> Option<i64> {
        self.streams.get(writer).map(|stream| stream.base)
    }

    /// An offer arrived, which implies all messages from `first` on. `depth`: how many may wait.
    pub(super) fn offered(
        &mut self,
        now: Instant,
        from: Peer,
        (of, first, head): (Outline, i64, Bytes),
        depth: usize,
        mail: &mut Vec<Mail>,
    ) {
        let MessageId { writer, number } = of.id;
        let stream = self.streams.entry(writer).or_insert_with(|| Stream {
            peer: from,
            base: of.base,
            // a reader begins with the first message that the writer keeps for it
            settled: first.saturating_sub(1),
            patience: PATIENCE,
            queue: VecDeque::new(),
        });
        // the writer has dropped these for this reader
        stream
            .queue
            .retain(|assembly| assembly.number >= first || assembly.is_whole());
        if stream.queue.is_empty() {
            // messages that passed without a reader
            stream.settled = stream.settled.max(first.saturating_sub(1));
        }
        if number <= stream.settled {
            mail.push(settled(from, writer, stream.settled));
            return;
        }
        let last = stream
            .queue
            .back()
            .map_or(stream.settled, |last| last.number);
        let first_missed = last
            .saturating_add(1)
            .max(number.saturating_sub(depth as i64));
        let new = first_missed..=number;
        stream
            .queue
            .extend(new.map(|number| Assembly::new(number, now)));
        // keep the incomplete message, or a slow reader would get none
        while stream.queue.len() > depth.max(1) + 1 {
            stream.queue.remove(1);
        }
        let mut queue = stream.queue.iter_mut();
        let Some(assembly) = queue.find(|assembly| assembly.number == number) else {
            return;
        };
        if assembly.of.is_none() {
            assembly.of = Some(of);
            assembly.seen = now;
        }
        if assembly.of == Some(of) && !head.is_empty() {
            assembly.parts.insert(0, head);
            assembly.wanted.remove(&0);
        }
    }

    /// A part arrived.
    pub(super) fn came(&mut self, now: Instant, of: Outline, index: u32, bytes: Bytes) {
        let Some(stream) = self.streams.get_mut(&of.id.writer) else {
            return;
        };
        let mut queue = stream.queue.iter_mut();
        let Some(assembly) = queue.find(|assembly| assembly.number == of.id.number) else {
            return;
        };
        if assembly.of.is_some_and(|known| known != of) {
            return;
        }
        let Some(wanted) = assembly.wanted.remove(&index) else {
            return;
        };
        assembly.of = Some(of);
        assembly.seen = now;
        assembly.parts.insert(index, bytes);
        if !wanted.is_late {
            // after two requests it is unclear which one this part replies to
            let took = now.saturating_duration_since(wanted.since);
            let patience = (stream.patience + 2 * took) / 2;
            stream.patience = patience.clamp(PATIENCE, LONGEST_PATIENCE);
        }
    }

    /// The writer has dropped the message.
    pub(super) fn gone(&mut self, id: &MessageId) {
        if let Some(stream) = self.streams.get_mut(&id.writer) {
            stream.queue.retain(|assembly| assembly.number != id.number);
            if stream.queue.is_empty() {
                stream.settled = stream.settled.max(id.number);
            }
        }
    }

    /// Takes complete messages, in each writer's order, and requests missing parts.
    pub(super) fn advance(&mut self, now: Instant, mail: &mut Vec<Mail>) -> Vec<WholeMessage> {
        let mut wholes = Vec::new();
        for (writer, stream) in &mut self.streams {
            let before = stream.settled;
            while let Some(first) = stream.queue.front() {
                let whole = first.whole();
                if whole.is_none() && now.saturating_duration_since(first.seen) < GIVE_UP {
                    break;
                }
                stream.settled = first.number;
                stream.queue.pop_front();
                wholes.extend(whole);
                if let Some(next) = stream.queue.front_mut() {
                    next.seen = now; // its requests begin now
                }
            }
            if stream.settled != before {
                mail.push(settled(stream.peer, *writer, stream.settled));
            }
            let Some(first) = stream.queue.front_mut() else {
                continue;
            };
            if first.wanted.values().any(|wanted| wanted.again <= now) {
                stream.patience = (stream.patience * 2).min(LONGEST_PATIENCE);
            }
            for (index, wanted) in &mut first.wanted {
                if wanted.again <= now {
                    wanted.again = now + stream.patience;
                    wanted.is_late = true;
                    mail.push(want(stream.peer, *writer, (first.number, *index)));
                }
            }
        }
        let all = self.streams.values().flat_map(|stream| &stream.queue);
        let wanted = all.flat_map(|assembly| assembly.wanted.values());
        // late parts do not count, or a stopped writer would block all others
        let mut requests = wanted.filter(|wanted| !wanted.is_late).count();
        for (writer, stream) in &mut self.streams {
            let Some(first) = stream.queue.front_mut() else {
                continue;
            };
            while requests < MOST_REQUESTS
                && let Some(index) = first.next()
            {
                let wanted = PartRequest {
                    since: now,
                    again: now + stream.patience,
                    is_late: false,
                };
                first.wanted.insert(index, wanted);
                requests += 1;
                mail.push(want(stream.peer, *writer, (first.number, index)));
            }
        }
        wholes
    }

    /// When [`advance`](Self::advance) is due next.
    pub(super) fn due(&self) -> Option<Instant> {
        let firsts = self
            .streams
            .values()
            .filter_map(|stream| stream.queue.front());
        firsts
            .flat_map(|first| {
                let wanted = first.wanted.values().map(|wanted| wanted.again);
                wanted.chain([first.seen + GIVE_UP])
            })
            .min()
    }

    pub(super) fn forget_writer(&mut self, writer: &EndpointId) {
        self.streams.remove(writer);
    }

    pub(super) fn forget_peer(&mut self, peer: &Peer) {
        self.streams.retain(|_, stream| stream.peer != *peer);
    }
}

fn want(to: Peer, writer: EndpointId, (number, index): (i64, u32)) -> Mail {
    let id = MessageId { writer, number };
    let message = PartMessage::Want { id, index };
    Mail { to, message }
}

fn settled(to: Peer, writer: EndpointId, number: i64) -> Mail {
    let id = MessageId { writer, number };
    let message = PartMessage::Settled { id };
    Mail { to, message }
}
