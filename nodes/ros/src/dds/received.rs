//! Samples as rustdds receives them.

use crate::{
    backend::{RequestId, Sample},
    payload::Payload,
};
use bytes::Bytes;
use rustdds::{SequenceNumber, Timestamp, no_key::DeserializedCacheChange};
use std::time::{Duration, Instant};

/// The sample of a change; `is_server`: a request.
pub(super) fn into_sample(change: DeserializedCacheChange<Bytes>, is_server: bool) -> Sample {
    let (writer, sequence) = (
        change.writer_guid().to_bytes(),
        i64::from(change.sequence_number),
    );
    let mut request = change.related_sample_identity().map(|identity| RequestId {
        client: identity.writer_guid.to_bytes(),
        sequence: identity.sequence_number.into(),
    });
    if is_server {
        // A client may omit its identity, or (Fast DDS) the number: the sample's own ones apply then.
        let request = request.get_or_insert(RequestId {
            client: writer,
            sequence,
        });
        if request.sequence == i64::from(SequenceNumber::UNKNOWN) {
            request.sequence = sequence;
        }
    }
    Sample {
        writer,
        sequence,
        arrived: arrival(change.receive_instant),
        request,
        payload: Payload::Cdr(change.into_value()),
    }
}

/// The monotonic time of an arrival that rustdds stamps by the wall clock. A wall clock that was set back in between
/// gives the present time.
fn arrival(received: Timestamp) -> Instant {
    // in this order a pause in between makes the arrival later, not earlier
    let age = Timestamp::now().duration_since(received).to_nanoseconds();
    let now = Instant::now();
    let age = u64::try_from(age).map_or(Duration::ZERO, Duration::from_nanos);
    now.checked_sub(age).unwrap_or(now)
}
