//! The writers' side of messages in parts: what is kept for the readers that have not taken it.

use super::{
    Mail, Peer,
    message::{MessageId, Outline, PartMessage},
};
use crate::backend::EndpointId;
use bytes::Bytes;
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{Duration, Instant},
};

/// An offer that nobody answers is repeated after this time, and then after twice the last.
const PAUSE: Duration = Duration::from_millis(10);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// What a writer keeps for a reader that does not take it, whatever its depth \[byte\]; one message it keeps in any case.
const MOST_BYTES: usize = 64 << 20;

/// How much a writer keeps.
#[derive(Clone, Copy, Debug)]
pub(in crate::dds) enum Keep {
    /// The last messages, at most this many, whoever has not taken the others.
    Last(usize),
    /// All, until it is full with this many.
    All(usize),
}

struct Kept {
    of: Outline,
    bytes: Bytes,
    waiting: BTreeSet<Peer>,
    /// When the offer is repeated.
    again: Instant,
    pause: Duration,
}

struct Stream {
    keep: Keep,
    base: i64,
    last: i64,
    kept: VecDeque<Kept>,
}

impl Stream {
    fn kept_bytes(&self) -> usize {
        self.kept.iter().map(|kept| kept.bytes.len()).sum()
    }
}

/// The writers of this participant that have gone over to parts.
#[derive(Default)]
pub(super) struct Outbox {
    streams: BTreeMap<EndpointId, Stream>,
}

impl Outbox {
    /// Whether this writer's messages go in parts.
    pub(super) fn has(&self, writer: &EndpointId) -> bool {
        self.streams.contains_key(writer)
    }

    /// From now on this writer's messages go in parts. `last` is the last number that it used on its topic.
    pub(super) fn open(&mut self, writer: EndpointId, keep: Keep, last: i64) {
        let kept = VecDeque::new();
        self.streams.entry(writer).or_insert(Stream {
            keep,
            base: last,
            last,
            kept,
        });
    }

    /// Whether a reader has fallen so far behind that the writer takes nothing more.
    pub(super) fn is_full(&self, writer: &EndpointId) -> bool {
        self.streams
            .get(writer)
            .is_some_and(|stream| match stream.keep {
                Keep::Last(_) => false,
                Keep::All(number) => {
                    stream.kept.len() >= number || stream.kept_bytes() >= MOST_BYTES
                }
            })
    }

    /// Offers a message; its number. `copy`: the number under which it went out on the topic, 0 where it did not.
    pub(super) fn offer(
        &mut self,
        now: Instant,
        writer: &EndpointId,
        bytes: &Bytes,
        copy: i64,
        peers: BTreeSet<Peer>,
        mail: &mut Vec<Mail>,
    ) -> Option<i64> {
        let stream = self.streams.get_mut(writer)?;
        stream.last += 1;
        let of = Outline {
            id: MessageId {
                writer: *writer,
                number: stream.last,
            },
            len: bytes.len(),
            base: stream.base,
            copy,
        };
        let head = bytes.slice(of.range(0));
        for peer in &peers {
            mail.push(stream.offer(of, head.clone(), *peer));
        }
        if !peers.is_empty() {
            stream.kept.push_back(Kept {
                of,
                bytes: bytes.clone(),
                waiting: peers,
                again: now + PAUSE,
                pause: PAUSE,
            });
        }
        if let Keep::Last(number) = stream.keep {
            let mut bytes = stream.kept_bytes();
            while stream.kept.len() > 1 && (stream.kept.len() > number || bytes > MOST_BYTES) {
                let oldest = stream.kept.pop_front();
                bytes -= oldest.map_or(0, |oldest| oldest.bytes.len());
            }
        }
        Some(stream.last)
    }

    /// A reader wants a part.
    pub(super) fn wanted(
        &mut self,
        now: Instant,
        from: Peer,
        id: MessageId,
        index: u32,
        mail: &mut Vec<Mail>,
    ) {
        let stream = self.streams.get_mut(&id.writer);
        let kept = stream.and_then(|stream| {
            let mut kept = stream.kept.iter_mut();
            kept.find(|kept| kept.of.id == id)
        });
        let message = match kept {
            Some(kept) if index < kept.of.parts() => {
                kept.again = now + kept.pause; // it is being taken
                PartMessage::Part {
                    of: kept.of,
                    index,
                    bytes: kept.bytes.slice(kept.of.range(index)),
                }
            }
            _ => PartMessage::Gone { id },
        };
        mail.push(Mail { to: from, message });
    }

    /// A reader has taken, or given up, everything up to this.
    pub(super) fn settled(&mut self, from: Peer, id: MessageId) {
        if let Some(stream) = self.streams.get_mut(&id.writer) {
            stream.release(|kept| {
                if kept.of.id.number <= id.number {
                    kept.waiting.remove(&from);
                }
            });
        }
    }

    /// Whether every reader has everything up to this number.
    pub(super) fn is_settled(&self, writer: &EndpointId, number: i64) -> bool {
        self.streams.get(writer).is_none_or(|stream| {
            let mut kept = stream.kept.iter();
            !kept.any(|kept| kept.of.id.number <= number)
        })
    }

    /// The last number of this writer.
    pub(super) fn last(&self, writer: &EndpointId) -> Option<i64> {
        self.streams.get(writer).map(|stream| stream.last)
    }

    /// Repeats the offers that nobody has answered, without their first part: the answer may only be slow. `peers` tells who is still connected to a writer.
    pub(super) fn repeat(
        &mut self,
        now: Instant,
        peers: impl Fn(&EndpointId) -> BTreeSet<Peer>,
        mail: &mut Vec<Mail>,
    ) {
        for (writer, stream) in &mut self.streams {
            if stream.kept.iter().all(|kept| kept.again > now) {
                continue;
            }
            let connected = peers(writer);
            stream.release(|kept| kept.waiting.retain(|peer| connected.contains(peer)));
            for kept in stream.kept.iter().filter(|kept| kept.again <= now) {
                let to = kept.waiting.iter();
                mail.extend(to.map(|peer| stream.offer(kept.of, Bytes::new(), *peer)));
            }
            for kept in stream.kept.iter_mut().filter(|kept| kept.again <= now) {
                kept.pause = (kept.pause * 2).min(LONGEST_PAUSE);
                kept.again = now + kept.pause;
            }
        }
    }

    /// When [`repeat`](Self::repeat) has something to do.
    pub(super) fn due(&self) -> Option<Instant> {
        let kept = self.streams.values().flat_map(|stream| &stream.kept);
        kept.map(|kept| kept.again).min()
    }

    pub(super) fn forget_writer(&mut self, writer: &EndpointId) {
        self.streams.remove(writer);
    }

    pub(super) fn forget_peer(&mut self, peer: &Peer) {
        for stream in self.streams.values_mut() {
            stream.release(|kept| {
                kept.waiting.remove(peer);
            });
        }
    }
}

impl Stream {
    fn offer(&self, of: Outline, head: Bytes, to: Peer) -> Mail {
        let mut kept = self.kept.iter();
        let oldest = kept.find(|kept| kept.waiting.contains(&to));
        let first = oldest.map_or(of.id.number, |kept| kept.of.id.number);
        let message = PartMessage::Offer { of, first, head };
        Mail { to, message }
    }

    /// Changes who waits, and lets go of what nobody waits for.
    fn release(&mut self, change: impl Fn(&mut Kept)) {
        self.kept.iter_mut().for_each(change);
        self.kept.retain(|kept| !kept.waiting.is_empty());
    }
}
