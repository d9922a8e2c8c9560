//! Large samples for readers of other DDS implementations.
//!
//! rustdds 0.15.1 sends a sample of 512 KiB over Ethernet in 400 datagrams at once. These overflow the receive buffers of
//! Linux: readers of this suite take large samples in parts instead ([`super::parts`]). rustdds then repairs eight
//! fragments of 256 bytes in 10 ms, which is less than five such samples a second need. So a sample that is not
//! acknowledged is sent again from here, in the name of its own writer and in datagrams as large as those of Fast DDS.
//! The samples after it are sent so before rustdds sends them too. Readers ignore the fragments that they have.

use super::rtps::{self, Fragments};
use crate::{
    backend::EndpointId,
    dds::{
        answers::WaitingRoom,
        codec::Raw,
        shared::{Shared, is_foreign},
    },
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

/// Smaller samples fit into the receive buffer of Linux (208 KiB, with what a datagram takes besides its bytes).
const LARGE: usize = 64 * 1024;
/// How long each transmission has to be acknowledged: rustdds asks for it with the sample, and every 100 ms.
const PAUSES: [Duration; 3] = [
    Duration::from_millis(30),
    Duration::from_millis(300),
    Duration::from_millis(600),
];
/// Fragments of a datagram.
const FRAGMENTS: u16 = 240;
/// Between two datagrams of a repetition: the receive buffer holds two.
const BETWEEN: Duration = Duration::from_millis(1);
/// So many samples are sent twice from the start after one was not acknowledged.
const CAREFUL: u32 = 256;

/// What is known of the readers of a publisher's large samples.
#[derive(Default)]
pub(in crate::dds) struct Care {
    /// Samples that are not acknowledged yet.
    places: WaitingRoom,
    /// Samples that will be sent twice from the start.
    careful: Arc<AtomicU32>,
}

/// A sample that is sent.
pub(in crate::dds) struct LargeSample {
    line: EndpointId,
    number: i64,
    time: Timestamp,
    /// CDR with its header.
    sample: Bytes,
}

impl LargeSample {
    /// The sample that the DDS writer `line` sends under this number; `None` if it needs no care.
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

    /// The datagrams for a reader.
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
    /// Of other implementations.
    fn foreign_readers(&self, line: &EndpointId) -> BTreeSet<EndpointId> {
        let mut readers = self.matched(line);
        readers.retain(|reader| is_foreign(line, reader));
        readers
    }

    /// Sends a sample before rustdds does, if samples before it were not acknowledged.
    pub(in crate::dds) fn send_ahead(&self, large: &LargeSample, care: &Care) {
        let less = |careful: u32| careful.checked_sub(1);
        let order = Ordering::Relaxed;
        if care.careful.fetch_update(order, order, less).is_err() {
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

    /// Sends a sample again for as long as the readers have not acknowledged it, a few times.
    pub(in crate::dds) fn resend(
        self: &Arc<Self>,
        writer: Weak<DataWriter<Bytes, Raw>>,
        large: LargeSample,
        care: &Care,
    ) {
        if self.foreign_readers(&large.line).is_empty() {
            return;
        }
        // rustdds repairs what has no place
        let Some(place) = care.places.enter() else {
            return;
        };
        let (shared, careful) = (Arc::clone(self), Arc::clone(&care.careful));
        self.failure
            .watch(&self.runtime, "large samples", async move {
                let _place = place;
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

    /// The message's header, INFO_DST, INFO_TS, and DATA_FRAG without its payload.
    const HEADERS: usize = 20 + 16 + 12 + 36;

    proptest! {
        #[test]
        fn the_datagrams_hold_the_whole_sample(len in LARGE + 1..LARGE + 5000) {
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
    fn small_samples_are_left_to_rustdds() {
        let sample = Bytes::from(vec![0; LARGE]);
        assert!(LargeSample::of(LINE, 3, Timestamp::now(), &sample).is_none());
    }
}
