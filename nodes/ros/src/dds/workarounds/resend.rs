//! Large samples for readers of other DDS implementations.
//!
//! rustdds 0.15.1 sends a sample of 512 KiB over Ethernet in 400 datagrams at once, which overflow the receive buffers
//! of Linux. Readers of this suite take parts instead ([`super::parts`]). rustdds repairs eight fragments of 256 bytes
//! in 10 ms, too slowly for five such samples a second. So this module repeats unacknowledged samples in datagrams as
//! large as those of Fast DDS. It also sends the samples after them once before rustdds does. Readers ignore fragments
//! that they have.

use super::rtps::{self, Fragments};
use crate::{
    backend::EndpointId,
    dds::{codec::Raw, identity::is_foreign, shared::Shared},
};
use bytes::Bytes;
use rustdds::{Timestamp, no_key::DataWriter};
use std::{
    collections::BTreeSet,
    sync::{
        Arc, Weak,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};
use tokio::sync::Semaphore;

/// Smaller samples fit into the receive buffer of Linux (208 KiB, with the overhead of datagrams).
const LARGE: usize = 64 * 1024;
/// How long each transmission has to be acknowledged: rustdds requests it with the sample, and every 100 ms.
const PAUSES: [Duration; 3] = [
    Duration::from_millis(30),
    Duration::from_millis(300),
    Duration::from_millis(600),
];
/// Fragments per datagram.
const FRAGMENTS: u16 = 240;
/// Between two datagrams of a repetition: the receive buffer holds two.
const BETWEEN: Duration = Duration::from_millis(1);
/// Samples that are sent twice from the start, after one was not acknowledged.
const CAREFUL: u32 = 256;

/// Large samples of one publisher that wait for acknowledgement at once.
const MOST_PENDING: usize = 64;

/// Acknowledgements of a publisher's large samples.
pub(in crate::dds) struct RepeatState {
    /// Limits the samples that wait for acknowledgement.
    pending: Arc<Semaphore>,
    /// Samples that will be sent twice from the start.
    careful: Arc<AtomicU32>,
}

impl Default for RepeatState {
    fn default() -> Self {
        Self {
            pending: Arc::new(Semaphore::new(MOST_PENDING)),
            careful: Arc::default(),
        }
    }
}

pub(in crate::dds) struct LargeSample {
    line: EndpointId,
    number: i64,
    time: Timestamp,
    /// CDR with its header.
    sample: Bytes,
}

impl LargeSample {
    /// `line`: its DDS writer, with the number there. `None` if it is small.
    pub(in crate::dds) fn of(
        line: EndpointId,
        number: i64,
        time: Timestamp,
        sample: &Bytes,
    ) -> Option<Self> {
        (sample.len() > LARGE).then(|| Self {
            line,
            number,
            time,
            sample: sample.clone(),
        })
    }

    fn datagrams(&self, reader: &EndpointId) -> impl Iterator<Item = Bytes> {
        let fragments = self.sample.len().div_ceil(rtps::FRAGMENT) as u32; // of at most some MiB
        let firsts = (1..=fragments).step_by(usize::from(FRAGMENTS));
        firsts.map(|first| {
            let fragments = Fragments {
                number: self.number,
                time: self.time,
                first,
                count: FRAGMENTS,
            };
            rtps::fragments(&self.line, reader, &fragments, &self.sample)
        })
    }
}

impl Shared {
    /// Readers of other implementations.
    fn foreign_readers(&self, line: &EndpointId) -> BTreeSet<EndpointId> {
        let mut readers = self.matched(line);
        readers.retain(|reader| is_foreign(line, reader));
        readers
    }

    /// Sends a sample before rustdds does, if earlier samples were not acknowledged.
    pub(in crate::dds) fn send_ahead(&self, large: &LargeSample, state: &RepeatState) {
        let less = |careful: u32| careful.checked_sub(1);
        let order = Ordering::Relaxed;
        if state.careful.fetch_update(order, order, less).is_err() {
            return;
        }
        for (reader, addresses) in self.addresses_of(&self.foreign_readers(&large.line)) {
            for datagram in large.datagrams(&reader) {
                for address in &addresses {
                    self.wire.send(&datagram, *address);
                }
            }
        }
    }

    /// Repeats a sample a few times until the readers have acknowledged it.
    pub(in crate::dds) fn resend(
        self: &Arc<Self>,
        writer: Weak<DataWriter<Bytes, Raw>>,
        large: LargeSample,
        state: &RepeatState,
    ) {
        if self.foreign_readers(&large.line).is_empty() {
            return;
        }
        // without a permit, rustdds repairs the sample
        let Ok(permit) = Arc::clone(&state.pending).try_acquire_owned() else {
            return;
        };
        let (shared, careful) = (Arc::clone(self), Arc::clone(&state.careful));
        self.failure
            .watch(&self.runtime, "large samples", async move {
                let _permit = permit;
                for pause in PAUSES {
                    {
                        let Some(writer) = writer.upgrade() else {
                            return;
                        };
                        let acknowledged = writer.async_wait_for_acknowledgments();
                        if tokio::time::timeout(pause, acknowledged).await.is_ok() {
                            return;
                        }
                    }
                    careful.store(CAREFUL, Ordering::Relaxed);
                    let readers = shared.foreign_readers(&large.line);
                    for (reader, addresses) in shared.addresses_of(&readers) {
                        for datagram in large.datagrams(&reader) {
                            for address in &addresses {
                                shared.wire.send(&datagram, *address);
                            }
                            tokio::time::sleep(BETWEEN).await;
                        }
                    }
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LINE: EndpointId = [1, 0x18, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 0, 0, 2, 3];
    const READER: EndpointId = [1, 0x0f, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 0, 0, 1, 4];

    /// The header, INFO_DST, INFO_TS, and DATA_FRAG without its payload.
    const HEADERS: usize = 20 + 16 + 12 + 36;

    proptest! {
        #[test]
        fn datagrams_contain_the_whole_sample(len in LARGE + 1..LARGE + 5000) {
            let sample: Vec<u8> = (0..len).map(|index| (index / 7) as u8).collect();
            let sample = Bytes::from(sample);
            let sent = LargeSample::of(LINE, 3, Timestamp::now(), &sample).unwrap();
            let mut joined = Vec::new();
            for datagram in sent.datagrams(&READER) {
                prop_assert!(datagram.len() <= 65_500, "{}", datagram.len());
                joined.extend_from_slice(&datagram[HEADERS..]);
            }
            prop_assert_eq!(joined, &sample[..]);
        }
    }

    #[test]
    fn small_samples_are_not_repeated() {
        let sample = Bytes::from(vec![0; LARGE]);
        assert!(LargeSample::of(LINE, 3, Timestamp::now(), &sample).is_none());
    }
}
