//! The readers' side of messages in parts: asks for the parts, a few at a time, and puts them together.

use super::{
    Mail, Peer,
    message::{MessageId, Outline, PartMessage},
};
use crate::backend::EndpointId;
use bytes::{Bytes, BytesMut};
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

/// Parts that a participant has on the way at once: three fit into half of Linux's default receive buffer of 208 KiB,
/// which counts for twice as much, so that there is room for all else.
const FLYING: usize = 3;

/// A part that does not come is requested again after this time, or twice as long as parts of its writer take, and then
/// after twice the last (as RFC 6298 has it for TCP): on a slow network what is late is not lost, and to ask for it
/// again would make it later.
const PATIENCE: Duration = Duration::from_millis(20);
const LONGEST_PATIENCE: Duration = Duration::from_millis(500);

/// A message of which nothing comes for this long is given up.
const GIVE_UP: Duration = Duration::from_secs(5);

/// A whole message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Whole {
    pub(super) of: Outline,
    pub(super) bytes: Bytes,
}

#[derive(Clone, Copy)]
struct Wanted {
    since: Instant,
    again: Instant,
    /// Whether it has been asked for more than once.
    is_late: bool,
}

/// A message on its way.
struct Assembly {
    number: i64,
    /// `None` until something of it came: that it is there is known from the numbers of the others.
    of: Option<Outline>,
    parts: BTreeMap<u32, Bytes>,
    wanted: BTreeMap<u32, Wanted>,
    /// The last sign of it.
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

    fn whole(&self) -> Option<Whole> {
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
        Some(Whole { of, bytes })
    }

    /// A part to ask for that is neither here nor on its way.
    fn next(&self) -> Option<u32> {
        let parts = self.of.map_or(1, |of| of.parts());
        (0..parts).find(|index| !self.parts.contains_key(index) && !self.wanted.contains_key(index))
    }
}

struct Stream {
    peer: Peer,
    base: i64,
    /// Everything up to this is taken or given up.
    settled: i64,
    patience: Duration,
    /// In order; the first is on its way.
    queue: VecDeque<Assembly>,
}

/// The writers of other participants whose messages come in parts.
#[derive(Default)]
pub(super) struct Inbox {
    streams: BTreeMap<EndpointId, Stream>,
}

impl Inbox {
    /// The last number of this writer whose sample on the topic counts, where its messages come in parts.
    pub(super) fn base(&self, writer: &EndpointId) -> Option<i64> {
        self.streams.get(writer).map(|stream| stream.base)
    }

    /// A message is offered, and with it all from `first` on. `depth`: how many may wait.
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
            // a reader begins where the writer first knew of it
            settled: first.saturating_sub(1),
            patience: PATIENCE,
            queue: VecDeque::new(),
        });
        // what the writer does not keep for this reader any more will not come
        stream
            .queue
            .retain(|assembly| assembly.number >= first || assembly.is_whole());
        if stream.queue.is_empty() {
            // what went by while nobody read here
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
        // what is on its way stays, or a reader that is slow for long would get nothing
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

    /// A part came.
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
            // of a part that was asked for twice, nobody knows which came
            let took = now.saturating_duration_since(wanted.since);
            let patience = (stream.patience + 2 * took) / 2;
            stream.patience = patience.clamp(PATIENCE, LONGEST_PATIENCE);
        }
    }

    /// The writer does not keep the message any more.
    pub(super) fn gone(&mut self, id: &MessageId) {
        if let Some(stream) = self.streams.get_mut(&id.writer) {
            stream.queue.retain(|assembly| assembly.number != id.number);
            if stream.queue.is_empty() {
                stream.settled = stream.settled.max(id.number);
            }
        }
    }

    /// Takes what is whole, in each writer's order, and asks for what is not.
    pub(super) fn advance(&mut self, now: Instant, mail: &mut Vec<Mail>) -> Vec<Whole> {
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
                    next.seen = now; // its turn begins
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
        // what is late is not on its way, or a writer that has stopped would hold up all others
        let mut flying = wanted.filter(|wanted| !wanted.is_late).count();
        for (writer, stream) in &mut self.streams {
            let Some(first) = stream.queue.front_mut() else {
                continue;
            };
            while flying < FLYING
                && let Some(index) = first.next()
            {
                let wanted = Wanted {
                    since: now,
                    again: now + stream.patience,
                    is_late: false,
                };
                first.wanted.insert(index, wanted);
                flying += 1;
                mail.push(want(stream.peer, *writer, (first.number, index)));
            }
        }
        wholes
    }

    /// When [`advance`](Self::advance) has something to do by itself.
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
