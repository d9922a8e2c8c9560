//! The DDS writers of a publisher, one after the other.
//!
//! A reliable writer of rustdds 0.15.1 keeps each sample until its last reader has acknowledged it, and stops when its
//! window is full. It can drop neither a reader nor samples. So one stopped reader would silence the topic for all. A
//! publisher whose slowest reader falls behind therefore starts a new DDS writer. It uses this writer as soon as all
//! readers of the old one are connected to it. It drops the old writer when the other readers have had time to take its
//! last samples.

use super::window::Window;
use crate::{
    backend::{EndpointId, RequestId},
    dds::codec::Raw,
    lock::lock,
};
use bytes::Bytes;
use futures::{FutureExt as _, future::BoxFuture, task::noop_waker_ref};
use rustdds::{
    GUID, Publisher, QosPolicies, RTPSEntity as _, SequenceNumber, Timestamp, Topic,
    WriteOptionsBuilder,
    dds::result::{CreateResult, WriteError},
    no_key::DataWriter,
    rpc::SampleIdentity,
};
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    task::Context,
    time::Duration,
};

/// How far the slowest reader may fall behind \[samples\].
const PATIENCE: usize = 256;
/// The slowest reader has also acknowledged nothing for this long: after a burst, acknowledgements are on their way.
pub(in crate::dds) const LULL: Duration = Duration::from_millis(100);
/// The upper bound if one reader lets writer after writer pass: each is announced to all participants.
const MOST_PATIENCE: usize = 2048;

/// How long the previous writer stays, for samples that other readers have not taken.
pub(in crate::dds) const RETIREMENT: Duration = Duration::from_secs(2);

/// Makes the DDS writers of a publisher.
pub(in crate::dds) struct Maker {
    pub(in crate::dds) publisher: Publisher,
    pub(in crate::dds) topic: Topic,
    pub(in crate::dds) qos: QosPolicies,
}

impl Maker {
    pub(in crate::dds) fn make(&self) -> CreateResult<DataWriter<Bytes, Raw>> {
        let qos = Some(self.qos.clone());
        self.publisher.create_datawriter_no_key(&self.topic, qos)
    }
}

/// A DDS writer and its unacknowledged samples.
pub(in crate::dds) struct Line {
    writer: Arc<DataWriter<Bytes, Raw>>,
    pub(in crate::dds) window: Window,
    /// The number of the last sample at the start of the wait, and the wait until all readers have it.
    wait: Option<(i64, BoxFuture<'static, ()>)>,
}

impl Line {
    pub(in crate::dds) fn new(writer: DataWriter<Bytes, Raw>) -> Self {
        Self {
            writer: Arc::new(writer),
            window: Window::default(),
            wait: None,
        }
    }

    pub(in crate::dds) fn id(&self) -> EndpointId {
        self.writer.guid().to_bytes()
    }

    pub(in crate::dds) const fn writer(&self) -> &Arc<DataWriter<Bytes, Raw>> {
        &self.writer
    }

    /// Sends a sample and returns its number.
    pub(in crate::dds) fn write(
        &mut self,
        sample: &Bytes,
        answers: Option<RequestId>,
        written: Timestamp,
    ) -> Result<i64, WriteError<Bytes>> {
        let related = answers.map(|request| SampleIdentity {
            writer_guid: GUID::from_bytes(request.client),
            sequence_number: SequenceNumber::from(request.sequence),
        });
        let options = WriteOptionsBuilder::new()
            .source_timestamp(written)
            .related_sample_identity_opt(related)
            .build();
        let identity = self.writer.write_with_options(sample.clone(), options)?;
        let number = identity.sequence_number.into();
        self.window.wrote(number, sample.len());
        Ok(number)
    }

    /// Updates the window from acknowledgements. Returns whether there were new ones.
    pub(in crate::dds) fn update(&mut self) -> bool {
        let mut context = Context::from_waker(noop_waker_ref());
        let mut is_acknowledged = false;
        while self.window.unacknowledged() > 0 {
            let (number, wait) = self.wait.get_or_insert_with(|| {
                let writer = Arc::clone(&self.writer);
                let wait = async move {
                    // an error means that there are no readers
                    writer.async_wait_for_acknowledgments().await.ok();
                };
                (self.window.last(), wait.boxed())
            });
            if wait.poll_unpin(&mut context).is_pending() {
                break;
            }
            let number = *number;
            self.window.acknowledged(number);
            self.wait = None;
            is_acknowledged = true;
        }
        is_acknowledged
    }
}

/// How far the slowest reader may fall behind \[samples\].
#[derive(Clone, Copy, Debug)]
pub(in crate::dds) struct Patience(usize);

impl Default for Patience {
    fn default() -> Self {
        Self(PATIENCE)
    }
}

impl Patience {
    pub(in crate::dds) const fn samples(self) -> usize {
        self.0
    }

    /// A writer was replaced.
    pub(in crate::dds) fn grow(&mut self) {
        self.0 = (self.0 * 2).min(MOST_PATIENCE);
    }

    /// All readers have all samples.
    pub(in crate::dds) const fn reset(&mut self) {
        self.0 = PATIENCE;
    }
}

/// The current DDS writer of each publisher. The first DDS writer identifies the publisher in this process.
#[derive(Default)]
pub(in crate::dds) struct Lines {
    table: Mutex<Table>,
}

#[derive(Default)]
struct Table {
    publishers: BTreeMap<EndpointId, EndpointId>,
    current: BTreeMap<EndpointId, EndpointId>,
}

impl Lines {
    /// Makes `line` the current DDS writer of `publisher`.
    pub(in crate::dds) fn set_current(&self, publisher: EndpointId, line: EndpointId) {
        lock(&self.table).current.insert(publisher, line);
    }

    /// Adds a DDS writer of `publisher`.
    pub(in crate::dds) fn add(&self, publisher: EndpointId, line: EndpointId) {
        lock(&self.table).publishers.insert(line, publisher);
    }

    pub(in crate::dds) fn remove(&self, line: &EndpointId) {
        lock(&self.table).publishers.remove(line);
    }

    pub(in crate::dds) fn remove_publisher(&self, publisher: &EndpointId) {
        lock(&self.table).current.remove(publisher);
    }

    /// The publisher of a DDS writer; any other endpoint stands for itself.
    pub(in crate::dds) fn publisher_of(&self, line: &EndpointId) -> EndpointId {
        *lock(&self.table).publishers.get(line).unwrap_or(line)
    }

    /// The current DDS writer of a publisher; any other endpoint stands for itself.
    pub(in crate::dds) fn current(&self, publisher: &EndpointId) -> EndpointId {
        *lock(&self.table)
            .current
            .get(publisher)
            .unwrap_or(publisher)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_writer_identifies_the_publisher() {
        let lines = Lines::default();
        let [first, second, other] = [1, 2, 3].map(|byte| [byte; 16]);
        assert_eq!(
            (lines.current(&first), lines.publisher_of(&first)),
            (first, first)
        );
        lines.add(first, second);
        assert_eq!(lines.publisher_of(&second), first);
        lines.set_current(first, second);
        assert_eq!(
            (lines.current(&first), lines.current(&other)),
            (second, other)
        );
        lines.remove(&second);
        lines.remove_publisher(&first);
        assert_eq!(lines.publisher_of(&second), second);
        assert_eq!(lines.current(&first), first);
    }

    #[test]
    fn patience_grows_up_to_a_bound() {
        let mut patience = Patience::default();
        assert_eq!(patience.samples(), PATIENCE);
        (0..9).for_each(|_| patience.grow());
        assert_eq!(patience.samples(), MOST_PATIENCE);
        patience.reset();
        assert_eq!(patience.samples(), PATIENCE);
    }
}
