//! How a model takes pictures of several cameras.

use anyhow::{Context as _, Result, ensure};
use wm_model::Framing;
use wm_motion::actions::ActionSpace;
use wm_zoo::ModelFolder;

use super::{matcher::Rules, parameters::Parameters};

/// The rule of the model's training.
#[derive(Clone, Debug)]
pub(super) struct Rule {
    pub framing: Framing,
    pub rules: Rules,
    /// Space of the arm's actions.
    pub actions: ActionSpace,
}

impl Rule {
    /// Reads it from the model's files. It may block.
    ///
    /// # Errors
    /// Names a missing or invalid file, or the number of cameras if it is not the model's.
    pub fn of_model(parameters: &Parameters) -> Result<Self> {
        let name = &parameters.model;
        let load = || {
            let folder = ModelFolder::open(name)?;
            let framing = folder.framing()?;
            let (expected, found) = (framing.views, parameters.cameras.len());
            ensure!(
                expected == found,
                "the model takes {expected} camera(s) side by side, but parameter cameras names {found}: name those of the \
                 training, or train with --camera for each of them"
            );
            let encoding = folder.action_encoding()?;
            let actions =
                encoding.map_or_else(ActionSpace::bridge, |encoding| encoding.space().clone());
            Ok((framing, actions))
        };
        let loaded: Result<(Framing, ActionSpace)> = load();
        let (framing, actions) =
            loaded.with_context(|| format!("parameter model is \"{name}\""))?;
        // Times of a minute at most fit.
        let nanos = |seconds: f64| (seconds * 1e9) as i64;
        let tolerance_s = match parameters.tolerance.is_zero() {
            true => 0.5 / actions.rate(),
            false => parameters.tolerance.as_secs_f64(),
        };
        Ok(Self {
            framing,
            rules: Rules {
                tolerance_ns: nanos(tolerance_s),
                longest_wait_ns: nanos(parameters.longest_wait.as_secs_f64()),
                queue: parameters.queue_size,
            },
            actions,
        })
    }
}
