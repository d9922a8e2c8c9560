//! What planners and workers say to each other, in CDR.

use std::fmt;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_bytes::ByteBuf;
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use wm_msgs::cdr::{self, CdrError};
use wm_planner::{CostFunction, Costs};

use crate::Identity;

/// The longest message \[byte\]: what Zenoh puts together for us.
const LONGEST: usize = 64 << 20;
/// The most candidates that are costed at once for others: far more than fit into memory with large latents.
const MOST_CANDIDATES: usize = 4096;
/// Characters of others' text that are logged.
const LONGEST_QUOTE: usize = 200;

/// SHA-256 of a cost function's message.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FunctionId([u8; 32]);

impl fmt::Debug for FunctionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, ..] = self.0;
        write!(f, "{a:02x}{b:02x}{c:02x}{d:02x}")
    }
}

/// What a planner asks of a worker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Which costs it would find.
    Identity,
    /// What candidates cost.
    Costs {
        /// By which function.
        function: FunctionId,
        /// The function itself, for a worker that does not know it yet.
        definition: Option<ByteBuf>,
        /// How many candidates.
        candidates: u32,
        /// Their values, one candidate after the other: steps x searched values each.
        values: Vec<f32>,
    },
}

/// What a worker answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// To [`Request::Identity`].
    Identity(Identity),
    /// The terms of the candidates' costs, weighted, one candidate after the other.
    Costs(Vec<f32>),
    /// The function has to be told.
    UnknownFunction,
    /// Why it does not answer.
    Refused(String),
}

/// What is wrong with a message.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MessageError {
    /// Longer than anything that is meant.
    #[error("a message of {0} bytes; expected at most {LONGEST}")]
    Long(usize),
    /// Not of its form.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// A function under a name that is not its own.
    #[error("a cost function was sent as {named:?}, but is {found:?}")]
    Misnamed {
        /// The name that it came under.
        named: FunctionId,
        /// Its own.
        found: FunctionId,
    },
    /// Candidates that are none, or too many.
    #[error(
        "{candidates} candidates of {values} values in all; expected 1 to {MOST_CANDIDATES} of {each}"
    )]
    Candidates {
        /// How many there are said to be.
        candidates: u32,
        /// Values that came.
        values: usize,
        /// Values that each has.
        each: usize,
    },
    /// Costs that are too few or too many.
    #[error("{found} costs; expected {terms} for each of {candidates} candidates")]
    Costs {
        /// Candidates that were asked about.
        candidates: usize,
        /// Terms that each has.
        terms: usize,
        /// Costs that came.
        found: usize,
    },
}

/// Text of others, for a log: escaped, and not all of it.
pub(crate) fn quoted(text: &str) -> String {
    let start = text.chars().take(LONGEST_QUOTE);
    start.flat_map(char::escape_debug).collect()
}

/// A message as bytes.
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

/// The message in bytes of others.
///
/// # Errors
/// [`MessageError`] says what is wrong with them.
pub(crate) fn decode<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, MessageError> {
    if bytes.len() > LONGEST {
        return Err(MessageError::Long(bytes.len()));
    }
    Ok(cdr::from_bytes(bytes)?)
}

/// A cost function as it is sent.
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

/// The function that came as `named`.
///
/// # Errors
/// Where it is another, or none.
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

/// Candidates of `each` values.
///
/// # Errors
/// [`MessageError::Candidates`].
pub(crate) fn candidates(
    candidates: u32,
    values: &[f32],
    each: usize,
) -> Result<Vec<Vec<f32>>, MessageError> {
    // Saturating: no more than MOST_CANDIDATES pass.
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

/// The costs of so many candidates, of so many terms.
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
    fn infinities_and_nothings_survive_to_the_bit() {
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
    fn what_is_too_many_or_too_few_is_named() {
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
