//! Samples for rustdds: CDR bytes with their 4-byte header, of any type.

use bytes::{BufMut as _, Bytes, BytesMut};
use rustdds::{
    RepresentationIdentifier,
    no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter},
};
use std::convert::Infallible;

/// Representation identifier and options.
pub(super) const HEADER_LEN: usize = 4;

/// Passes bytes through.
pub(super) struct Raw;

/// The representations that are passed on. Readers decode them. XCDR2 is included so that a recorder can keep samples
/// that it cannot decode.
const ENCODINGS: [RepresentationIdentifier; 4] = [
    RepresentationIdentifier::CDR_LE,
    RepresentationIdentifier::CDR_BE,
    RepresentationIdentifier::XCDR2_LE,
    RepresentationIdentifier::XCDR2_BE,
];

/// Restores the header that rustdds removes.
#[derive(Clone)]
pub(super) struct RawDecoder;

impl DeserializerAdapter<Bytes> for Raw {
    type Error = Infallible;
    type Decoded = Bytes;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &ENCODINGS
    }

    fn transform_decoded(decoded: Bytes) -> Bytes {
        decoded
    }
}

impl DefaultDecoder<Bytes> for Raw {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl Decode<'_, Bytes> for RawDecoder {
    type Error = Infallible;

    fn decode_bytes(
        self,
        body: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Bytes, Infallible> {
        let mut bytes = BytesMut::with_capacity(HEADER_LEN + body.len());
        bytes.put_slice(&encoding.to_bytes());
        bytes.put_slice(&[0, 0]);
        bytes.put_slice(body);
        Ok(bytes.freeze())
    }
}

impl SerializerAdapter<Bytes> for Raw {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    /// Removes the header; the writer has checked it.
    fn to_bytes(sample: &Bytes) -> Result<Bytes, Infallible> {
        Ok(sample.slice(HEADER_LEN.min(sample.len())..))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bytes_pass_untouched(body in prop::collection::vec(any::<u8>(), 0..99)) {
            let mut sample = vec![0, 1, 0, 0];
            sample.extend(&body);
            let sample = Bytes::from(sample);
            let Ok(sent) = Raw::to_bytes(&sample);
            let Ok(received) = RawDecoder.decode_bytes(&sent, RepresentationIdentifier::CDR_LE);
            prop_assert_eq!(received, sample);
        }
    }
}
