//! A worker without its network: requests in, replies out.

use std::collections::VecDeque;

use serde_bytes::ByteBuf;
use thiserror::Error;
use wm_model::transition::LoadedTransition;
use wm_planner::{Evaluator, PlanError};

use crate::{
    Answer, FunctionId, Identity, MessageError, Request,
    message::{candidates, decode, decode_function},
};

/// The most cost functions, each with the model's results for its context: enough for a few planners, each of which
/// needs one at a time.
const KEPT: usize = 8;

/// The model and the most recent cost functions.
#[derive(Debug)]
pub(crate) struct Worker<'m> {
    model: &'m LoadedTransition,
    identity: Identity,
    /// In the order of their last use, the latest last.
    functions: VecDeque<CachedFunction<'m>>,
}

#[derive(Debug)]
struct CachedFunction<'m> {
    id: FunctionId,
    /// Values per candidate.
    each: usize,
    evaluator: Evaluator<'m>,
}

/// The reason why a request is refused.
#[derive(Debug, Error)]
enum Refusal {
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Plan(#[from] PlanError),
}

impl<'m> Worker<'m> {
    /// A worker with a model and its `identity`.
    pub(crate) fn new(model: &'m LoadedTransition, identity: Identity) -> Self {
        Self {
            model,
            identity,
            functions: VecDeque::new(),
        }
    }

    /// Answers the bytes of a [`Request`]; any bytes have an answer.
    pub(crate) fn answer(&mut self, request: &[u8]) -> Answer {
        let answer = match decode(request) {
            Ok(Request::Identity) => Ok(Answer::Identity(self.identity.clone())),
            Ok(Request::Costs {
                function,
                definition,
                candidates,
                values,
            }) => self.costs(function, definition, candidates, &values),
            Err(error) => Err(error.into()),
        };
        answer.unwrap_or_else(|refusal| Answer::Refused(refusal.to_string()))
    }

    fn costs(
        &mut self,
        function: FunctionId,
        definition: Option<ByteBuf>,
        count: u32,
        values: &[f32],
    ) -> Result<Answer, Refusal> {
        let place = self.functions.iter().position(|known| known.id == function);
        let known = place.and_then(|place| self.functions.remove(place));
        let known = match (known, definition) {
            (Some(known), _) => known,
            (None, None) => return Ok(Answer::UnknownFunction),
            (None, Some(definition)) => {
                let definition = decode_function(function, &definition)?;
                CachedFunction {
                    id: function,
                    each: definition.candidate_len(),
                    evaluator: definition.with(self.model)?,
                }
            }
        };
        if self.functions.len() >= KEPT {
            self.functions.pop_front();
        }
        self.functions.push_back(known);
        let Some(known) = self.functions.back_mut() else {
            return Ok(Answer::UnknownFunction);
        };
        let candidates = candidates(count, values, known.each)?;
        let costs = known.evaluator.costs(&candidates)?;
        Ok(Answer::Costs(costs.terms.into_iter().flatten().collect()))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::LazyLock;

    use candle_core::{Device, Tensor};
    use wm_model::transition::{Transition, TransitionConfig};
    use wm_planner::{
        ActionSize, CostFunction, Objective, SearchSpace, Target, TransitionDynamics,
    };

    use super::*;
    use crate::message::{EncodedFunction, encode};

    static MODEL: LazyLock<LoadedTransition> = LazyLock::new(|| {
        let config = TransitionConfig {
            hidden: 32,
            depth: 1,
            heads: 1,
            ..TransitionConfig::preset("tiny", (2, 2, 4), 2, 7).unwrap()
        };
        Transition::random(config, 3).unwrap().pack().unwrap()
    });

    fn waves(shape: &[usize], pitch: f32) -> Tensor {
        let count = shape.iter().product::<usize>();
        let values: Vec<f32> = (0..count).map(|i| (i as f32 * pitch).sin()).collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    pub(crate) fn random_function(seed: u64, frames: usize, horizon: usize) -> CostFunction {
        let pitch = seed as f32 / u64::MAX as f32 + 0.1;
        let context = waves(&[1, frames, 2, 2, 4], pitch);
        let past = (frames > 1).then(|| waves(&[frames - 1, 7], pitch));
        let sampler = &MODEL.config().sampler;
        let dynamics = TransitionDynamics::new(&MODEL, sampler, &context, past.as_ref(), seed);
        let objective = Objective::of(Target::LastStep(waves(&[2, 2, 4], 2.0 * pitch)));
        let space = SearchSpace::bounded(&[(-1.0, 1.0); 3], 7).unwrap();
        let objective = objective.and(0.5, ActionSize);
        CostFunction::of(&dynamics.unwrap(), &objective, &space, horizon).unwrap()
    }

    pub(crate) fn function(seed: u64) -> CostFunction {
        random_function(seed, 2, 2)
    }

    fn worker() -> Worker<'static> {
        let identity = Identity {
            version: "1".into(),
            model_hash: "abc".into(),
            kernels: "x86_64 avx2".into(),
            fingerprint: [7; 32],
        };
        Worker::new(&MODEL, identity)
    }

    /// Two candidates of six values.
    fn request(function: &EncodedFunction, is_defined: bool) -> Vec<u8> {
        let definition = is_defined.then(|| ByteBuf::from(function.bytes.clone()));
        let values = (0..12).map(|i| (i as f32).sin()).collect();
        encode(&Request::Costs {
            function: function.id,
            definition,
            candidates: 2,
            values,
        })
        .unwrap()
    }

    #[test]
    fn costs_are_those_of_the_function_once_it_is_defined() {
        let (mut worker, function) = (worker(), function(1));
        let encoded = EncodedFunction::of(&function).unwrap();
        assert_eq!(
            worker.answer(&request(&encoded, false)),
            Answer::UnknownFunction
        );
        let Answer::Costs(costs) = worker.answer(&request(&encoded, true)) else {
            panic!("no costs")
        };
        assert_eq!(
            worker.answer(&request(&encoded, false)),
            Answer::Costs(costs.clone())
        );
        let candidates: Vec<Vec<f32>> = (0..2)
            .map(|c| (0..6).map(|i| ((6 * c + i) as f32).sin()).collect())
            .collect();
        let own = function.with(&MODEL).unwrap().costs(&candidates).unwrap();
        assert_eq!(costs, own.terms.concat());
    }

    #[test]
    fn only_recently_used_functions_are_kept() {
        let mut worker = worker();
        let functions: Vec<EncodedFunction> = (0..=KEPT as u64)
            .map(|seed| EncodedFunction::of(&function(seed)).unwrap())
            .collect();
        for encoded in &functions[..KEPT] {
            worker.answer(&request(encoded, true));
        }
        // The first function is used again, so the second one is dropped.
        worker.answer(&request(&functions[0], false));
        worker.answer(&request(&functions[KEPT], true));
        let is_known = |worker: &mut Worker<'_>, index: usize| {
            let answer = worker.answer(&request(&functions[index], false));
            answer != Answer::UnknownFunction
        };
        assert!(is_known(&mut worker, 0) && !is_known(&mut worker, 1));
        assert_eq!(worker.functions.len(), KEPT);
    }

    #[test]
    fn invalid_requests_are_refused_with_a_reason() {
        let mut worker = worker();
        let mut refused = |request: &[u8]| match worker.answer(request) {
            Answer::Refused(reason) => reason,
            other => panic!("{other:?}"),
        };
        assert!(refused(b"no").contains("CDR header"));
        let encoded = EncodedFunction::of(&function(1)).unwrap();
        let candidates = |candidates, values| {
            encode(&Request::Costs {
                function: encoded.id,
                definition: Some(ByteBuf::from(encoded.bytes.clone())),
                candidates,
                values,
            })
            .unwrap()
        };
        assert!(refused(&candidates(3, vec![0.0; 6])).contains("3 candidates of 6 values"));
        assert!(refused(&candidates(1, vec![f32::NAN; 6])).contains("finite"));
    }
}
