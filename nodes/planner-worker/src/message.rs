//! The messages between planners and workers, in CDR.

use std::fmt;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_bytes::ByteBuf;
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use wm_msgs::cdr::{self, CdrError};
use wm_planner::{CostFunction, Costs};

use crate::Identity;

/// The longest message \[byte\]: the limit of our Zenoh sessions.
const LONGEST: usize = 64 << 20;
/// The most candidates per request: far more than fit into memory with large latents.
const MOST_CANDIDATES: usize = 4096;
/// The most characters of a peer's text in logs.
const LONGEST_QUOTE: usize = 200;

/// SHA-256 of a cost function's message.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct FunctionId([u8; 32]);

impl fmt::Debug for FunctionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, ..] = self.0;
        write!(f, "{a:02x}{b:02x}{c:02x}{d:02x}")
    }
}

/// A request of a planner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Request {
    /// The worker's identity.
    Identity,
    /// The costs of candidates.
    Costs {
        /// The cost function.
        function: FunctionId,
        /// The function itself, if the worker does not know it yet.
        definition: Option<ByteBuf>,
        /// Number of candidates.
        candidates: u32,
        /// Their values, one candidate after the other: steps x searched values each.
        values: Vec<f32>,
    },
}

/// A worker's reply.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Answer {
    /// To [`Request::Identity`].
    Identity(Identity),
    /// The weighted terms of the candidates' costs, one candidate after the other.
    Costs(Vec<f32>),
    /// The request must define the function.
    UnknownFunction,
    /// The reason why the request is refused.
    Refused(String),
}

/// The reason why a message is invalid.
#[derive(Debug, Error)]
#[non_exhaustive]
pub(crate) enum MessageError {
    #[error("a message of {0} bytes; expected at most {LONGEST}")]
    Long(usize),
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// A function's hash does not match its id.
    #[error("a cost function was sent as {named:?}, but is {found:?}")]
    Misnamed {
        named: FunctionId,
        found: FunctionId,
    },
    /// No candidates, or too many.
    #[error(
        "{candidates} candidates of {values} values in all; expected 1 to {MOST_CANDIDATES} of {each}"
    )]
    Candidates {
        candidates: u32,
        /// All values received.
        values: usize,
        /// Values per candidate.
        each: usize,
    },
    /// Too few or too many costs.
    #[error("{found} costs; expected {terms} for each of {candidates} candidates")]
    Costs {
        candidates: usize,
        /// Terms per candidate.
        terms: usize,
        /// Costs received.
        found: usize,
    },
}

/// A peer's text for a log: escaped and shortened.
pub(crate) fn quoted(text: &str) -> String {
    let start = text.chars().take(LONGEST_QUOTE);
    start.flat_map(char::escape_debug).collect()
}

/// Encodes a message.
///
/// # Errors
/// [`MessageError::Long`].
pub(crate) fn encode<M: Serialize>(message: &M) -> Result<Vec<u8>, MessageError> {
    let bytes = cdr::to_bytes(message)?;
    if bytes.len() > LONGEST {
        return Err(MessageError::Long(bytes.len()));
    }
    Ok(bytes)
}

/// Decodes a message of a peer.
///
/// # Errors
/// [`MessageError`] names the fault.
pub(crate) fn decode<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, MessageError> {
    if bytes.len() > LONGEST {
        return Err(MessageError::Long(bytes.len()));
    }
    Ok(cdr::from_bytes(bytes)?)
}

/// An encoded cost function.
pub(crate) struct EncodedFunction {
    pub(crate) id: FunctionId,
    pub(crate) bytes: Vec<u8>,
    pub(crate) terms: usize,
}

impl EncodedFunction {
    pub(crate) fn of(function: &CostFunction) -> Result<Self, MessageError> {
        let bytes = encode(function)?;
        Ok(Self {
            id: FunctionId(Sha256::digest(&bytes).into()),
            terms: function.terms(),
            bytes,
        })
    }
}

/// Decodes a function and checks its hash.
///
/// # Errors
/// It is invalid, or has another hash.
pub(crate) fn decode_function(
    named: FunctionId,
    bytes: &[u8],
) -> Result<CostFunction, MessageError> {
    let found = FunctionId(Sha256::digest(bytes).into());
    if found != named {
        return Err(MessageError::Misnamed { named, found });
    }
    decode(bytes)
}

/// Splits `values` into candidates of `each` values.
///
/// # Errors
/// [`MessageError::Candidates`].
pub(crate) fn candidates(
    candidates: u32,
    values: &[f32],
    each: usize,
) -> Result<Vec<Vec<f32>>, MessageError> {
    // It saturates: counts above MOST_CANDIDATES are refused.
    let count = usize::try_from(candidates).unwrap_or(usize::MAX);
    let is_sound = (1..=MOST_CANDIDATES).contains(&count)
        && each > 0
        && count.checked_mul(each) == Some(values.len());
    if !is_sound {
        return Err(MessageError::Candidates {
            candidates,
            values: values.len(),
            each,
        });
    }
    Ok(values.chunks_exact(each).map(<[f32]>::to_vec).collect())
}

/// Checks and splits the costs of candidates.
///
/// # Errors
/// [`MessageError::Costs`].
pub(crate) fn costs(
    values: &[f32],
    candidates: usize,
    terms: usize,
) -> Result<Costs, MessageError> {
    if terms == 0 || candidates.checked_mul(terms) != Some(values.len()) {
        let found = values.len();
        return Err(MessageError::Costs {
            candidates,
            terms,
            found,
        });
    }
    let terms = values.chunks_exact(terms).map(<[f32]>::to_vec);
    Ok(Costs::of_terms(terms.collect()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::worker::tests::{function, random_function};

    fn requests() -> impl Strategy<Value = Request> {
        let definition = prop::option::of(prop::collection::vec(any::<u8>(), 0..40));
        let values = prop::collection::vec(-1e3_f32..1e3, 0..40);
        let costs = (any::<[u8; 32]>(), definition, any::<u32>(), values);
        let costs = costs.prop_map(|(id, definition, candidates, values)| Request::Costs {
            function: FunctionId(id),
            definition: definition.map(ByteBuf::from),
            candidates,
            values,
        });
        prop_oneof![Just(Request::Identity), costs]
    }

    fn answers() -> impl Strategy<Value = Answer> {
        let identity = (
            "[ -~]{0,9}",
            "[0-9a-f]{0,64}",
            "[ -~]{0,9}",
            any::<[u8; 32]>(),
        );
        let identity = identity.prop_map(|(version, model_hash, kernels, fingerprint)| {
            Answer::Identity(Identity {
                version,
                model_hash,
                kernels,
                fingerprint,
            })
        });
        prop_oneof![
            identity,
            prop::collection::vec(-1e3_f32..1e3, 0..40).prop_map(Answer::Costs),
            Just(Answer::UnknownFunction),
            "[^\\x00]{0,20}".prop_map(Answer::Refused),
        ]
    }

    proptest! {
        #[test]
        fn requests_survive(request in requests()) {
            prop_assert_eq!(decode::<Request>(&encode(&request).unwrap()).unwrap(), request);
        }

        #[test]
        fn answers_survive(answer in answers()) {
            prop_assert_eq!(decode::<Answer>(&encode(&answer).unwrap()).unwrap(), answer);
        }

        #[test]
        fn functions_survive(seed: u64, frames in 1..4_usize, horizon in 1..5_usize) {
            let function = random_function(seed, frames, horizon);
            let encoded = EncodedFunction::of(&function).unwrap();
            prop_assert_eq!(decode_function(encoded.id, &encoded.bytes).unwrap(), function);
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), header: bool) {
            let mut bytes = bytes;
            if header {
                bytes.splice(..0, [0, 1, 0, 0]);
            }
            let _ = (decode::<Request>(&bytes), decode::<Answer>(&bytes), decode::<CostFunction>(&bytes));
        }

        #[test]
        fn no_change_to_a_function_panics(at in any::<prop::sample::Index>(), byte: u8, cut in any::<prop::sample::Index>()) {
            let mut bytes = EncodedFunction::of(&function(1)).unwrap().bytes;
            let (at, cut) = (at.index(bytes.len()), cut.index(bytes.len()));
            bytes[at] = byte;
            let _ = decode::<CostFunction>(&bytes);
            let _ = decode::<CostFunction>(&bytes[..cut]);
        }
    }

    #[test]
    fn infinities_and_nans_survive_bit_for_bit() {
        let values = vec![f32::NAN, f32::INFINITY, -0.0, f32::MIN_POSITIVE / 2.0];
        let bytes = encode(&Answer::Costs(values.clone())).unwrap();
        let Answer::Costs(again) = decode(&bytes).unwrap() else {
            panic!("other than costs")
        };
        let bits = |values: &[f32]| {
            values
                .iter()
                .map(|value| value.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&again), bits(&values));
    }

    #[test]
    fn wrong_counts_are_named() {
        let of = |count, values| {
            candidates(count, &vec![0.0; values], 3)
                .unwrap_err()
                .to_string()
        };
        assert!(of(2, 5).contains("2 candidates of 5 values"));
        assert!(of(0, 0).contains("0 candidates"));
        assert!(of(5000, 15000).contains("5000 candidates"));
        assert!(candidates(2, &[0.0; 6], 3).is_ok_and(|candidates| candidates.len() == 2));
        let few = costs(&[0.0; 5], 2, 3).unwrap_err().to_string();
        assert!(few.contains("5 costs; expected 3 for each of 2"), "{few}");
        let both = costs(&[1.0, 2.0, 3.0, 4.0], 2, 2).unwrap();
        assert_eq!(
            (both.total, both.terms[1].as_slice()),
            (vec![3.0, 7.0], &[3.0, 4.0][..])
        );
        let encoded = EncodedFunction::of(&function(1)).unwrap();
        let other = EncodedFunction::of(&function(2)).unwrap();
        let misnamed = decode_function(other.id, &encoded.bytes)
            .unwrap_err()
            .to_string();
        assert!(misnamed.contains(&format!("{:?}", other.id)), "{misnamed}");
    }
}
