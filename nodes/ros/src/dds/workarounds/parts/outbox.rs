//! The writers' side of the parts protocol: keeps messages until the readers have taken them.

use super::message::{Mail, MessageId, Outline, PartMessage};
use crate::{backend::EndpointId, dds::identity::Peer};
use bytes::Bytes;
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{Duration, Instant},
};

/// The pause before an offer without a reply is repeated; it doubles each time.
const PAUSE: Duration = Duration::from_millis(10);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// The most that a writer keeps for slow readers \[byte\]; it always keeps one message.
const MOST_BYTES: usize = 64 << 20;

/// A reader that requests nothing for this long is silent: only the newest message is kept for it, until it sends
/// something.
const SILENCE: Duration = Duration::from_secs(5);

/// How much a writer keeps.
#[derive(Clone, Copy, Debug)]
pub(in crate::dds) enum Retention {
    /// The last messages, at most this many, even if readers lack older ones.
    Last(usize),
    /// All messages, at most this many: then readers that lack the oldest lose them.
    All(usize),
}

impl Retention {
    const fn most(self) -> usize {
        match self {
            Self::Last(number) | Self::All(number) => number,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::dds) struct OfferOutcome {
    pub(in crate::dds) number: i64,
    /// Older messages that were dropped for readers of a reliable writer, once for each reader.
    pub(in crate::dds) dropped: u64,
}

struct KeptMessage {
    of: Outline,
    bytes: Bytes,
    waiting: BTreeSet<Peer>,
    /// When the offer is repeated.
    again: Instant,
    pause: Duration,
}

struct Stream {
    keep: Retention,
    base: i64,
    last: i64,
    kept: VecDeque<KeptMessage>,
    /// Since when each reader with waiting messages has been silent.
    silent_since: BTreeMap<Peer, Instant>,
}

impl Stream {
    /// Readers for which only the newest message is kept.
    fn silent(&self, now: Instant) -> BTreeSet<Peer> {
        let silent = self.silent_since.iter();
        let silent = silent.filter(|(_, since)| now.saturating_duration_since(**since) >= SILENCE);
        silent.map(|(peer, _)| *peer).collect()
    }

    /// The reader has sent something.
    fn restart_silence(&mut self, now: Instant, peer: &Peer) {
        if let Some(since) = self.silent_since.get_mut(peer) {
            *since = now;
        }
    }

    /// Whether the limits are exceeded.
    fn is_over(&self, number: usize, bytes: usize) -> bool {
        number > self.keep.most() || bytes > MOST_BYTES
    }

    /// Drops messages above the limits, and all but the newest for silent readers. Returns how many.
    fn trim(&mut self, now: Instant) -> u64 {
        let mut dropped = 0;
        let silent = self.silent(now);
        if !silent.is_empty() {
            let newest = self.last;
            for kept in self
                .kept
                .iter_mut()
                .filter(|kept| kept.of.id.number < newest)
            {
                let before = kept.waiting.len();
                kept.waiting.retain(|peer| !silent.contains(peer));
                dropped += before - kept.waiting.len();
            }
            self.release(|_| {});
        }
        let mut bytes = self.kept.iter().map(|kept| kept.bytes.len()).sum();
        while self.kept.len() > 1
            && self.is_over(self.kept.len(), bytes)
            && let Some(oldest) = self.kept.pop_front()
        {
            bytes -= oldest.bytes.len();
            dropped += oldest.waiting.len();
        }
        match self.keep {
            Retention::Last(_) => 0, // best effort does not count losses
            Retention::All(_) => dropped as u64,
        }
    }
}

/// The writers of this participant that use parts.
#[derive(Default)]
pub(super) struct Outbox {
    streams: BTreeMap<EndpointId, Stream>,
}

impl Outbox {
    /// Whether this writer uses parts.
    pub(super) fn has(&self, writer: &EndpointId) -> bool {
        self.streams.contains_key(writer)
    }

    /// Switches this writer to parts. `last`: the last number that it used on its topic.
    pub(super) fn open(&mut self, writer: EndpointId, keep: Retention, last: i64) {
        let kept = VecDeque::new();
        self.streams.entry(writer).or_insert(Stream {
            keep,
            base: last,
            last,
            kept,
            silent_since: BTreeMap::new(),
        });
    }

    /// Whether one more message would drop one that a reader still requests.
    pub(super) fn is_full(&self, now: Instant, writer: &EndpointId) -> bool {
        let Some(stream) = self.streams.get(writer) else {
            return false;
        };
        if matches!(stream.keep, Retention::Last(_)) {
            return false;
        }
        let silent = stream.silent(now);
        let waits = |kept: &&KeptMessage| !kept.waiting.is_subset(&silent);
        let (number, bytes) = stream
            .kept
            .iter()
            .filter(waits)
            .fold((0, 0), |sum, kept| (sum.0 + 1, sum.1 + kept.bytes.len()));
        number >= stream.keep.most() || bytes >= MOST_BYTES
    }

    /// Offers a message. `copy`: its number on the topic, 0 if it was not sent there.
    pub(super) fn offer(
        &mut self,
        now: Instant,
        writer: &EndpointId,
        bytes: &Bytes,
        copy: i64,
        peers: BTreeSet<Peer>,
        mail: &mut Vec<Mail>,
    ) -> Option<OfferOutcome> {
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
        if !peers.is_empty() {
            for peer in &peers {
                stream.silent_since.entry(*peer).or_insert(now);
            }
            stream.kept.push_back(KeptMessage {
                of,
                bytes: bytes.clone(),
                waiting: peers.clone(),
                again: now + PAUSE,
                pause: PAUSE,
            });
        }
        let dropped = stream.trim(now);
        let (silent, head) = (stream.silent(now), bytes.slice(of.range(0)));
        for peer in peers {
            let head = match silent.contains(&peer) {
                true => Bytes::new(),
                false => head.clone(),
            };
            mail.push(stream.offer(of, head, peer));
        }
        let number = stream.last;
        Some(OfferOutcome { number, dropped })
    }

    /// A reader requests a part.
    pub(super) fn wanted(
        &mut self,
        now: Instant,
        from: Peer,
        id: MessageId,
        index: u32,
        mail: &mut Vec<Mail>,
    ) {
        let stream = self.streams.get_mut(&id.writer);
        // only readers that received the offer may request parts
        let kept = stream.and_then(|stream| {
            stream.restart_silence(now, &from);
            let mut kept = stream.kept.iter_mut();
            kept.find(|kept| kept.of.id == id && kept.waiting.contains(&from))
        });
        let message = match kept {
            Some(kept) if index < kept.of.parts() => {
                kept.again = now + kept.pause; // the reader is active
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

    /// A reader has taken or dropped every message up to this one.
    pub(super) fn settled(&mut self, now: Instant, from: Peer, id: MessageId) {
        if let Some(stream) = self.streams.get_mut(&id.writer) {
            stream.restart_silence(now, &from);
            stream.release(|kept| {
                if kept.of.id.number <= id.number {
                    kept.waiting.remove(&from);
                }
            });
            stream.forget_settled();
        }
    }

    /// Whether every reader that is not silent has all messages up to this number.
    pub(super) fn is_settled(&self, now: Instant, writer: &EndpointId, number: i64) -> bool {
        self.streams.get(writer).is_none_or(|stream| {
            let silent = stream.silent(now);
            let mut kept = stream.kept.iter();
            !kept.any(|kept| kept.of.id.number <= number && !kept.waiting.is_subset(&silent))
        })
    }

    /// The last number of this writer.
    pub(super) fn last(&self, writer: &EndpointId) -> Option<i64> {
        self.streams.get(writer).map(|stream| stream.last)
    }

    /// Repeats offers without a reply, but not their first part: the reader may be slow. `peers`: the readers that are
    /// still connected to a writer.
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
            stream.forget_settled();
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

    /// When [`repeat`](Self::repeat) is due next.
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
            stream.forget_settled();
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

    /// Changes the waiting readers, and drops messages that no reader waits for.
    fn release(&mut self, change: impl Fn(&mut KeptMessage)) {
        self.kept.iter_mut().for_each(change);
        self.kept.retain(|kept| !kept.waiting.is_empty());
    }

    /// Readers without waiting messages are not silent.
    fn forget_settled(&mut self) {
        let kept = &self.kept;
        let waits = |peer: &Peer| kept.iter().any(|kept| kept.waiting.contains(peer));
        self.silent_since.retain(|peer, _| waits(peer));
    }
}
