//! Samples as rustdds receives them.

use crate::{
    backend::{RequestId, Sample},
    payload::Payload,
};
use bytes::Bytes;
use rustdds::{SequenceNumber, no_key::DeserializedCacheChange};

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
        request,
        payload: Payload::Cdr(change.into_value()),
    }
}
