//! The part of the next rollout that is computed before its observation arrives.

use std::sync::{Mutex, PoisonError};

use wm_model::{WorldModel, sampler::Prepared};

use crate::history::Ahead;

/// The last observation, and the computation that is ready for the next one.
#[derive(Debug, Default)]
pub(super) struct Preparation(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    observed_ns: Option<i64>,
    prepared: Option<Prepared>,
}

impl Preparation {
    /// Returns the computation that is ready for the observation of `observed_ns`, and the expected time of the next one,
    /// after the same gap as the last.
    pub(super) fn take(&self, observed_ns: i64) -> (Option<Prepared>, Option<i64>) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let since = state.observed_ns.replace(observed_ns);
        let next = since
            .filter(|before_ns| *before_ns < observed_ns)
            .and_then(|before_ns| observed_ns.checked_add(observed_ns.checked_sub(before_ns)?));
        (state.prepared.take(), next)
    }

    /// Computes the part of the next rollout that does not need its observation.
    ///
    /// # Errors
    /// Where the model does not take the context.
    pub(super) fn prepare(&self, model: &WorldModel, ahead: &Ahead) -> wm_model::Result<()> {
        let prepared = ahead.prepare(model)?;
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.prepared = Some(prepared);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_observation_is_expected_at_the_rhythm_of_the_last() {
        let preparation = Preparation::default();
        let next = |observed_ns| preparation.take(observed_ns).1;
        assert_eq!(next(200), None);
        assert_eq!(next(400), Some(600));
        assert_eq!(next(1000), Some(1600));
        assert_eq!(next(100), None, "time has jumped back");
        assert_eq!(next(100), None);
    }
}
