use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_dataset::Latents;
use wm_model::transition::{ActionAlignment, Parametrisation, TransitionConfig};
use wm_zoo::subgoals::{CONDITION_VALUES, GIVEN_FRAMES, SubgoalConfig};

use crate::{
    recipe::recipe,
    transition::{Forcing, Objective, ObjectiveRecipe, TauDistribution},
};

recipe! {
    /// Settings of the training of subgoals, explained in `recipes/*/subgoals.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct SubgoalRecipe in ["tiny"] of "subgoals" {
        pub distances: Vec<usize>,
        pub longest: usize,
        pub frame_skip: Option<usize>,
        pub tau: TauDistribution,
        pub latent_noise: f64,
        pub model: SubgoalModelRecipe,
    }
}

/// Sizes of the network; `None` means the preset's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct SubgoalModelRecipe {
    pub preset: String,
    pub hidden: Option<usize>,
    pub depth: Option<usize>,
    pub heads: Option<usize>,
    pub patch: usize,
    pub predicts: Parametrisation,
}

impl SubgoalRecipe {
    /// The network for the latents of `train`.
    ///
    /// # Errors
    /// If the sizes do not fit.
    pub fn config(
        &self,
        train: &Latents,
        subgoals: &SubgoalConfig,
        frame_skip: usize,
    ) -> Result<TransitionConfig> {
        let own = &self.model;
        let shape = train.space().shape();
        let preset = TransitionConfig::preset(&own.preset, shape, own.patch, CONDITION_VALUES)?;
        let config = TransitionConfig {
            hidden: own.hidden.unwrap_or(preset.hidden),
            depth: own.depth.unwrap_or(preset.depth),
            heads: own.heads.unwrap_or(preset.heads),
            max_frames: subgoals.frames(),
            views: train.views(),
            frame_skip,
            parametrisation: own.predicts,
            // A subgoal's condition belongs to the frame itself.
            action_alignment: ActionAlignment::WithResult,
            ..preset
        };
        config.validate()?;
        Ok(config)
    }

    /// The objective of a network of `config`.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub fn objective(&self, config: &TransitionConfig) -> Result<Objective> {
        ensure!(
            self.latent_noise >= 0.0,
            "latent_noise is {}, expected at least 0",
            self.latent_noise
        );
        let objective = Objective {
            clips: self.batch,
            micro_batch: self.micro_batch,
            shift: config.sampler.shift,
            seed: self.seed,
            recipe: ObjectiveRecipe {
                forcing: Forcing::Teacher,
                history: GIVEN_FRAMES,
                tau: self.tau,
                history_noise: self.latent_noise,
                own_history: 0.0,
                action_dropout: 0.0,
                object_weight: 0.0,
            },
        };
        objective.validate(config)?;
        Ok(objective)
    }
}
