use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_model::{
    LatentSpace,
    sampler::Sampler,
    transition::{ActionAlignment, Parametrisation, TransitionConfig},
};
use wm_motion::actions::{Accumulation, ActionEncoding, ActionSpace};

use super::objective::{Objective, ObjectiveRecipe};
use crate::recipe::recipe;

/// Values that the null action adds to an action, as in the authors' release; the last one flags it.
const NULL_ACTION: usize = 3;

recipe! {
    /// Settings of transition training, explained in `recipes/*/transition.yaml`.
    pub struct TransitionRecipe in ["tiny", "paper"] of "transition" {
        /// Shape and conventions.
        pub model: ModelRecipe,
        /// The objective.
        pub objective: ObjectiveRecipe,
        /// Sampler settings.
        pub sampler: SamplerRecipe,
    }
}

/// Shape and conventions of the model; `None` means the preset's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct ModelRecipe {
    pub preset: String,
    pub hidden: Option<usize>,
    pub depth: Option<usize>,
    pub heads: Option<usize>,
    pub frames: usize,
    pub patch: Option<usize>,
    pub wide_head: Option<usize>,
    pub views: Option<usize>,
    pub predicts: Parametrisation,
    pub action_alignment: ActionAlignment,
    pub frame_skip: usize,
    pub accumulation: Accumulation,
    pub null_action: bool,
}

/// Sampler settings; `None` means the preset's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct SamplerRecipe {
    pub steps: Option<usize>,
    pub shift: Option<f64>,
    pub context_tau: Option<f64>,
}

impl TransitionRecipe {
    /// The recipe for data of `views` cameras.
    ///
    /// # Errors
    /// If it is for another number.
    pub fn of_views(&self, views: usize) -> Result<Self> {
        let own = self.model.views.unwrap_or(views);
        ensure!(
            own == views,
            "model.views is {own}, but the data have {views} cameras side by side"
        );
        let mut recipe = self.clone();
        recipe.model.views = Some(views);
        Ok(recipe)
    }

    /// Encoding of the actions of `space` for the model.
    ///
    /// # Errors
    /// If they cannot be encoded.
    pub fn encoding(&self, space: &ActionSpace) -> Result<ActionEncoding> {
        let null = if self.model.null_action {
            NULL_ACTION
        } else {
            0
        };
        Ok(ActionEncoding::new(
            space.clone(),
            space.len() + null,
            self.model.frame_skip,
            self.model.accumulation,
        )?)
    }

    /// The model for latents of `space` and actions of `encoding`.
    ///
    /// # Errors
    /// If they do not fit.
    pub fn config(
        &self,
        space: &LatentSpace,
        encoding: &ActionEncoding,
    ) -> Result<TransitionConfig> {
        let own = &self.model;
        // As published: 256 tokens per frame.
        let published = if space.height > 16 { 2 } else { 1 };
        let patch = own.patch.unwrap_or(published);
        let actions = encoding.action_dim();
        let preset = TransitionConfig::preset(&own.preset, space.shape(), patch, actions)?;
        let config = TransitionConfig {
            hidden: own.hidden.unwrap_or(preset.hidden),
            depth: own.depth.unwrap_or(preset.depth),
            heads: own.heads.unwrap_or(preset.heads),
            max_frames: own.frames,
            views: own.views.unwrap_or(1),
            wide_head: own.wide_head,
            frame_skip: own.frame_skip,
            parametrisation: own.predicts,
            action_alignment: own.action_alignment,
            sampler: Sampler {
                steps: self.sampler.steps.unwrap_or(preset.sampler.steps),
                shift: self.sampler.shift.unwrap_or(preset.sampler.shift),
                context_tau: self
                    .sampler
                    .context_tau
                    .unwrap_or(preset.sampler.context_tau),
            },
            ..preset
        };
        config.validate()?;
        Ok(config)
    }

    /// Objective of a model of `config`, with the time shift of its sampler.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub fn objective(&self, config: &TransitionConfig) -> Result<Objective> {
        ensure!(
            self.objective.action_dropout == 0.0 || self.model.null_action,
            "objective.action_dropout is {}, but model.null_action is false: there is no null action",
            self.objective.action_dropout
        );
        let objective = Objective {
            clips: self.batch,
            micro_batch: self.micro_batch,
            shift: config.sampler.shift,
            seed: self.seed,
            recipe: self.objective.clone(),
        };
        objective.validate(config)?;
        Ok(objective)
    }
}
