//! The samples of a subscription, from the middleware to the queue.

use super::{Gaps, PublisherId, Received, known_publishers::KnownPublishers};
use crate::{
    Clock, Diagnostics, Durability, Reliability,
    backend::{Backend, DiscoveredEndpoint, EndpointId, Sample, Sink},
    lifecycle::{Gate, GatedEndpoint},
    lock::lock,
    mailbox::Mailbox,
    payload::Payload,
};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};
use wm_msgs::cdr::CdrError;

/// Reads a message from a payload.
pub(super) type Read<T> = fn(Payload) -> Result<T, CdrError>;

/// State shared by the receiving thread and the reader of a subscription.
pub(crate) struct Intake {
    pub(super) topic: String,
    pub(super) mailbox: Mailbox<Received<Payload>>,
    undecodable: AtomicU64,
    lost: AtomicU64,
    /// Locked from the arrival of a sample until it is queued: two threads may serve the readers, and the gate may open
    /// in between.
    incoming: Mutex<Incoming>,
    pub(super) diagnostics: Diagnostics,
    clock: Clock,
    /// The gate of a managed node.
    gate: Option<Gate>,
}

/// The state that decides whether a sample is queued.
struct Incoming {
    gaps: Gaps<EndpointId>,
    /// Whether the node is active.
    is_open: bool,
    /// When a managed node became active.
    opened: Option<Instant>,
    /// The newest sample of each latching publisher, for the next activation of a managed node.
    latched: BTreeMap<EndpointId, Latched>,
    /// The number of the last sample of each publisher that arrived at an inactive node. The reader of latched samples
    /// may deliver the same one after the activation.
    skipped: BTreeMap<EndpointId, i64>,
}

/// A latched sample.
struct Latched {
    received: Received<Payload>,
    /// Whether its publisher was discovered: the sample may come first.
    is_publisher_known: bool,
}

/// The most remembered latching publishers: far more than a topic has.
const MAX_LATCHING: usize = 16;

impl Intake {
    pub(crate) fn new(
        topic: String,
        depth: usize,
        diagnostics: Diagnostics,
        clock: Clock,
        gate: Option<Gate>,
    ) -> Arc<Self> {
        let (undecodable, lost) = (AtomicU64::new(0), AtomicU64::new(0));
        let intake = Arc::new(Self {
            topic,
            mailbox: Mailbox::new(depth),
            undecodable,
            lost,
            incoming: Mutex::new(Incoming {
                gaps: Gaps::default(),
                is_open: gate.as_ref().is_none_or(Gate::is_open),
                opened: None,
                latched: BTreeMap::new(),
                skipped: BTreeMap::new(),
            }),
            diagnostics,
            clock,
            gate,
        });
        if let Some(gate) = &intake.gate {
            let gated: Arc<dyn GatedEndpoint> = intake.clone();
            gate.add(Arc::downgrade(&gated));
        }
        intake
    }

    /// The sink that the middleware calls for each sample.
    pub(crate) fn sink(self: &Arc<Self>) -> Sink {
        let intake = Arc::clone(self);
        Box::new(move |sample| match sample {
            Ok(sample) => {
                let mut incoming = intake.incoming();
                let lost = incoming.gaps.after(sample.writer, sample.sequence);
                intake.queue(&mut incoming, sample, lost);
            }
            Err(reason) => intake.refuse(&reason),
        })
    }

    /// As [`sink`](Self::sink), for one of two readers of the same publishers: skips samples that the other has
    /// received, and older ones.
    pub(crate) fn sink_of_two(self: &Arc<Self>) -> Sink {
        let intake = Arc::clone(self);
        Box::new(move |sample| match sample {
            Ok(sample) => {
                let mut incoming = intake.incoming();
                if let Some(lost) = incoming.gaps.after_new(sample.writer, sample.sequence) {
                    intake.queue(&mut incoming, sample, lost);
                }
            }
            Err(reason) => intake.refuse(&reason),
        })
    }

    /// As [`sink_of_two`](Self::sink_of_two), for the reader that serves best-effort publishers. It is connected to
    /// reliable publishers too, but may miss their samples; the other reader gets these late, so they are left to it.
    pub(crate) fn sink_of_best_effort(self: &Arc<Self>, backend: &Arc<dyn Backend>) -> Sink {
        let mut sink = self.sink_of_two();
        let mut reliable = KnownPublishers::new(backend, |publisher| {
            publisher.qos.reliability == Reliability::Reliable
        });
        Box::new(move |sample| {
            if let Ok(sample) = &sample
                && reliable.get(&sample.writer) == Some(true)
            {
                return;
            }
            sink(sample);
        })
    }

    /// As [`sink_of_two`](Self::sink_of_two), for the reader of latching publishers only. On activation, a managed node
    /// receives the latched samples, as a new subscription would.
    pub(crate) fn sink_of_latched(self: &Arc<Self>, backend: &Arc<dyn Backend>) -> Sink {
        if self.gate.is_none() {
            return self.sink_of_two();
        }
        self.sink_that_remembers(KnownPublishers::new(backend, |_| true))
    }

    /// `discovered`: the publishers in the graph.
    fn sink_that_remembers(self: &Arc<Self>, mut discovered: KnownPublishers) -> Sink {
        let intake = Arc::clone(self);
        Box::new(move |sample| match sample {
            Ok(sample) => {
                let is_publisher_known = discovered.get(&sample.writer).is_some();
                let received = intake.received(sample.clone());
                let mut incoming = intake.incoming();
                incoming.remember(Latched {
                    received,
                    is_publisher_known,
                });
                let is_skipped = incoming.skipped.get(&sample.writer) == Some(&sample.sequence);
                let lost = incoming.gaps.after_new(sample.writer, sample.sequence);
                if let Some(lost) = lost.or(is_skipped.then_some(0))
                    && incoming.is_open
                {
                    intake.deliver(sample, lost);
                }
            }
            Err(reason) => intake.refuse(&reason),
        })
    }

    /// As [`sink_of_latched`](Self::sink_of_latched), for the only reader of a subscription: samples of volatile
    /// publishers are not repeated on activation.
    pub(crate) fn sink_of_any(self: &Arc<Self>, backend: &Arc<dyn Backend>) -> Sink {
        let (mut latched, mut volatile) = (self.sink_of_latched(backend), self.sink_of_two());
        let mut latching = KnownPublishers::new(backend, |publisher| {
            publisher.qos.durability == Durability::TransientLocal
        });
        Box::new(move |sample| match &sample {
            // a latched sample may arrive before its publisher is discovered
            Ok(known) if latching.get(&known.writer) == Some(false) => volatile(sample),
            _ => latched(sample),
        })
    }

    /// A panic elsewhere leaves usable state.
    fn incoming(&self) -> MutexGuard<'_, Incoming> {
        lock(&self.incoming)
    }

    /// Samples that arrived at an inactive node are skipped, and are no loss.
    fn queue(&self, incoming: &mut Incoming, sample: Sample, lost: u64) {
        let is_late = incoming
            .opened
            .is_some_and(|opened| sample.arrived < opened);
        if incoming.is_open && !is_late {
            self.deliver(sample, lost);
        } else {
            incoming.skip(&sample);
        }
    }

    fn deliver(&self, sample: Sample, lost: u64) {
        if lost > 0 {
            self.lost.fetch_add(lost, Ordering::Relaxed);
            self.diagnostics
                .count_drops(&format!("{}: lost in transport", self.topic), lost);
        }
        self.diagnostics.received(&self.topic);
        let received = self.received(sample);
        if !self.mailbox.push(received) {
            self.diagnostics
                .count_drop(&format!("{}: queue full", self.topic));
        }
    }

    fn received(&self, sample: Sample) -> Received<Payload> {
        Received {
            message: sample.payload,
            received: self.clock.now(),
            at: sample.arrived,
            publisher: PublisherId(sample.writer),
        }
    }

    /// Number of samples that never arrived, by gaps in their publishers' sequence numbers.
    pub(super) fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Number of samples that could not be decoded.
    pub(super) fn undecodable(&self) -> u64 {
        self.undecodable.load(Ordering::Relaxed)
    }

    /// The message that `read` decodes; `None`, counted, if it fails.
    pub(super) fn read<T>(&self, sample: Received<Payload>, read: Read<T>) -> Option<Received<T>> {
        let mut refused = None;
        let read = sample.map(|payload| read(payload).map_err(|error| refused = Some(error)).ok());
        if let Some(error) = refused {
            self.refuse(&error.to_string());
        }
        let Received {
            message,
            received,
            at,
            publisher,
        } = read;
        message.map(|message| Received {
            message,
            received,
            at,
            publisher,
        })
    }

    /// Counts an undecodable sample, and reports the first.
    fn refuse(&self, reason: &str) {
        if self.undecodable.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{}: a sample is skipped, as will be others like it: {reason}",
                self.topic
            );
        }
        self.diagnostics
            .count_drop(&format!("{}: undecodable", self.topic));
    }
}

impl Incoming {
    fn remember(&mut self, sample: Latched) {
        let PublisherId(writer) = sample.received.publisher;
        insert_bounded(&mut self.latched, writer, sample);
    }

    fn skip(&mut self, sample: &Sample) {
        insert_bounded(&mut self.skipped, sample.writer, sample.sequence);
    }

    /// Forgets the samples of publishers that are gone: discovered earlier, and not in the graph now. A publisher that
    /// was never discovered gets until the next activation.
    fn forget_departed(&mut self, seen: &[DiscoveredEndpoint]) {
        self.latched.retain(|writer, latched| {
            let is_there = seen.iter().any(|seen| seen.id == *writer);
            let is_kept = is_there || !latched.is_publisher_known;
            latched.is_publisher_known = true;
            is_kept
        });
    }
}

/// Keeps at most [`MAX_LATCHING`] publishers.
fn insert_bounded<T>(of: &mut BTreeMap<EndpointId, T>, publisher: EndpointId, value: T) {
    if of.len() >= MAX_LATCHING && !of.contains_key(&publisher) {
        of.pop_first();
    }
    of.insert(publisher, value);
}

impl GatedEndpoint for Intake {
    fn opened(&self, backend: &dyn Backend) {
        self.opened_with(|| backend.seen());
    }

    fn closed(&self) {
        let mut incoming = self.incoming();
        incoming.is_open = false;
        self.mailbox.clear();
    }
}

impl Intake {
    /// `seen`: the endpoints in the graph, which are asked for under the lock: with an earlier answer, the publisher of a
    /// sample that arrived since would seem to be gone.
    fn opened_with(&self, seen: impl FnOnce() -> Vec<DiscoveredEndpoint>) {
        let mut incoming = self.incoming();
        self.mailbox.clear();
        if !incoming.latched.is_empty() {
            incoming.forget_departed(&seen());
        }
        for latched in incoming.latched.values() {
            self.mailbox.push(latched.received.clone());
        }
        incoming.opened = Some(Instant::now());
        incoming.is_open = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{cdr, std_msgs};

    fn sample(sequence: i64, bytes: Vec<u8>) -> Result<Sample, String> {
        Ok(Sample {
            payload: Payload::Cdr(bytes.into()),
            writer: [1; 16],
            sequence,
            arrived: Instant::now(),
            request: None,
        })
    }

    fn report_of(diagnostics: &Diagnostics) -> wm_msgs::diagnostic_msgs::DiagnosticStatus {
        struct Alone;

        impl crate::diagnostics::Graph for Alone {
            fn matched(&self, _: &crate::backend::EndpointId) -> usize {
                0
            }

            fn foreign(&self, _: &crate::backend::EndpointId) -> usize {
                0
            }

            fn mismatches(&self, _: &crate::backend::EndpointId) -> Vec<String> {
                Vec::new()
            }

            fn published_alike(
                &self,
                _: &crate::backend::EndpointId,
            ) -> std::collections::BTreeSet<String> {
                std::collections::BTreeSet::new()
            }
        }
        let now = std::time::Instant::now();
        diagnostics.report(now, &Alone).swap_remove(0)
    }

    fn gated() -> Arc<Intake> {
        let (diagnostics, gate) = (Diagnostics::new("/wm/test"), Gate::default());
        Intake::new("/wm/goal".into(), 4, diagnostics, Clock::new(), Some(gate))
    }

    #[test]
    fn an_activated_node_skips_what_arrived_before() {
        let intake = gated();
        let mut sink = intake.sink();
        sink(sample(1, Vec::new()));
        let late = sample(2, Vec::new());
        intake.opened_with(Vec::new);
        sink(late);
        sink(sample(3, vec![3]));
        let queued = intake.mailbox.try_pop().unwrap();
        assert_eq!(queued.message.into_cdr().unwrap().as_ref(), [3]);
        assert!(intake.mailbox.try_pop().is_none());
        assert_eq!(intake.lost.load(Ordering::Relaxed), 0);
    }

    /// Both readers of a goal receive it. The one for new samples skips it if it arrived before the activation; the
    /// other may come to it later.
    #[test]
    fn a_latched_sample_is_delivered_whichever_reader_is_first() {
        for is_early in [true, false] {
            let intake = gated();
            let nothing = KnownPublishers::of_nothing(|_| true);
            let mut latched = intake.sink_that_remembers(nothing);
            let mut new = intake.sink_of_two();
            let goal = || sample(1, vec![7]);
            if is_early {
                new(goal());
            }
            let late = goal();
            intake.opened_with(Vec::new);
            new(late);
            latched(goal());
            new(goal());
            let queued = intake.mailbox.try_pop().unwrap();
            assert_eq!(queued.message.into_cdr().unwrap().as_ref(), [7]);
            assert!(intake.mailbox.try_pop().is_none());
        }
    }

    #[test]
    fn latched_samples_of_departed_publishers_are_forgotten() {
        let intake = gated();
        let mut incoming = intake.incoming();
        for (writer, is_publisher_known) in [(1, true), (2, false)] {
            let mut sample = sample(1, Vec::new()).unwrap();
            sample.writer = [writer; 16];
            let received = intake.received(sample);
            incoming.remember(Latched {
                received,
                is_publisher_known,
            });
        }
        let remembered = |incoming: &Incoming| incoming.latched.keys().copied().collect::<Vec<_>>();
        // the second may not be discovered yet
        incoming.forget_departed(&[]);
        assert_eq!(remembered(&incoming), [[2; 16]]);
        incoming.forget_departed(&[]);
        assert_eq!(remembered(&incoming), [[0; 16]; 0]);
    }

    /// A subscription to goals has two readers: one for latched samples, one for new ones.
    #[test]
    fn of_two_readers_each_sample_is_taken_once_whoever_is_first() {
        const SAMPLES: i64 = 20_000;
        let (diagnostics, depth) = (Diagnostics::new("/wm/test"), 40_000);
        let intake = Intake::new("/wm/goal".into(), depth, diagnostics, Clock::new(), None);
        let together = std::sync::Barrier::new(2);
        std::thread::scope(|threads| {
            for _ in 0..2 {
                let (mut sink, together) = (intake.sink_of_two(), &together);
                threads.spawn(move || {
                    together.wait();
                    for sequence in 1..=SAMPLES {
                        sink(sample(sequence, Vec::new()));
                    }
                });
            }
        });
        let taken = std::iter::from_fn(|| intake.mailbox.try_pop()).count();
        let lost = intake.lost.load(Ordering::Relaxed);
        // Samples that one reader delivers late are skipped: neither duplicated nor counted as lost.
        assert_eq!((taken as u64, lost), (SAMPLES as u64, 0));
    }

    #[test]
    fn lost_dropped_and_undecodable_samples_are_counted() {
        let diagnostics = Diagnostics::new("/wm/test");
        let intake = Intake::new(
            "/wm/text".into(),
            2,
            diagnostics.clone(),
            Clock::new(),
            None,
        );
        let mut sink = intake.sink();
        let text = |text: &str| cdr::to_bytes(&std_msgs::String { data: text.into() }).unwrap();
        sink(sample(1, text("dropped")));
        sink(sample(2, vec![0, 1, 0, 0, 9, 9, 9, 9]));
        sink(sample(7, text("kept")));
        sink(Err("an unknown representation".into()));
        let report = report_of(&diagnostics);
        assert!(
            report
                .message
                .contains("dropped 4: /wm/text: lost in transport"),
            "{}",
            report.message
        );
        assert!(
            report.message.contains("dropped 1: /wm/text: queue full"),
            "{}",
            report.message
        );

        let mailbox = &intake.mailbox;
        let mut decoded = Vec::new();
        while let Some(received) = mailbox.try_pop() {
            match received.message.into_message::<std_msgs::String>() {
                Ok(message) => decoded.push(message.data.clone()),
                Err(error) => intake.refuse(&error.to_string()),
            }
        }
        assert_eq!(decoded, ["kept"]);
        assert_eq!(intake.undecodable.load(Ordering::Relaxed), 2);
        assert_eq!(mailbox.dropped(), 1);
    }
}
