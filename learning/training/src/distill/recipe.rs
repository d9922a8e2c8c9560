use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_model::transition::TransitionConfig;

use crate::{
    recipe::{Span, recipe},
    transition::{Forcing, Objective, ObjectiveRecipe, TauDistribution},
};

recipe! {
    /// Settings of a distillation, explained in `recipes/*/distill.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct DistillRecipe in ["tiny", "paper"] of "distill" {
        pub steps: usize,
        pub teacher_steps: usize,
        pub huber: f64,
        pub consistency: ConsistencyRecipe,
        pub self_forcing: SelfForcingRecipe,
        pub gate: GateRecipe,
    }
}

/// Settings of the consistency distillation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct ConsistencyRecipe {
    pub history: usize,
    pub history_noise: f64,
}

/// Settings of the stage against drift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct SelfForcingRecipe {
    pub after: Span,
    pub share: f64,
    pub frames: usize,
    pub real: f64,
}

/// How far the student may fall behind its teacher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct GateRecipe {
    pub plans: usize,
    pub ratio: f64,
    pub cem: f64,
    pub idm: f64,
    pub motion: f64,
}

impl DistillRecipe {
    /// Clips for a model of `config`.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub(super) fn objective(&self, config: &TransitionConfig) -> Result<Objective> {
        let own = &self.consistency;
        ensure!(
            (1..config.max_frames).contains(&own.history),
            "consistency.history is {}, expected 1 to {}: the teacher sees {} frames",
            own.history,
            config.max_frames - 1,
            config.max_frames
        );
        // At 0 the loss has no gradient without an error.
        ensure!(
            self.huber.is_finite() && self.huber > 0.0,
            "huber is {}, expected a positive number",
            self.huber
        );
        let longest = config.max_frames - own.history;
        let drift = &self.self_forcing;
        ensure!(
            drift.share == 0.0 || (2..=longest).contains(&drift.frames),
            "self_forcing.frames is {}, expected 2 to {longest}: the rest of a clip after consistency.history",
            drift.frames
        );
        for (name, part) in [("share", drift.share), ("real", drift.real)] {
            ensure!(
                (0.0..=1.0).contains(&part),
                "self_forcing.{name} is {part}, expected 0 to 1"
            );
        }
        let objective = Objective {
            clips: self.batch,
            micro_batch: self.micro_batch,
            shift: config.sampler.shift,
            seed: self.seed,
            recipe: ObjectiveRecipe {
                forcing: Forcing::Teacher,
                history: own.history,
                tau: TauDistribution::Uniform,
                history_noise: own.history_noise,
                own_history: 0.0,
                // The sampler never uses the null action.
                action_dropout: 0.0,
                object_weight: 0.0,
            },
        };
        objective.validate(config)?;
        Ok(objective)
    }
}
