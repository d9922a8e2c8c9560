//! The test of a new model against the present one.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_dataset::{DataOptions, Dataset, Latents};
use wm_evaluation::{ActionChange, Windows};
use wm_metrics::statistics::{SignFlip, sign_flip_test};
use wm_zoo::ModelFolder;

/// Greatest p at which the new model is accepted.
const LEVEL: f64 = 0.05;
/// Most windows of the test.
const MOST_WINDOWS: usize = 400;

/// The comparison of two models, one step ahead, on data that neither was trained on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The new model's squared latent error over that of persistence.
    pub ratio: f64,
    /// The same of the present model; 1 if it cannot predict for this camera and these actions.
    pub ratio_before: f64,
    /// Probability of so large a gain if the models were equal.
    pub p_value: f64,
    /// Windows of the test.
    pub windows: usize,
    /// Whether the new model is better.
    pub is_better: bool,
}

impl Verdict {
    /// Compares `new` with `present` on `test`.
    pub(super) fn of(
        new: &str,
        present: &str,
        test: &[PathBuf],
        options: &DataOptions,
        cache: &Path,
    ) -> Result<Self> {
        let of_new = errors(new, test, options, cache)?;
        let of_present = errors(present, test, options, cache)
            .inspect_err(|error| tracing::info!("{present} is not compared: {error:#}"));
        // Without a usable model, the last frame is all that there is.
        let of_present = of_present
            .ok()
            .filter(|errors| errors.len() == of_new.len());
        let of_present = of_present.unwrap_or_else(|| still(&of_new));
        Self::between(&of_new, &of_present)
    }

    /// Compares errors of the same windows. Latent spaces differ, so an error counts by the sum of persistence's errors in its
    /// own. Then the gains sum to the difference of the ratios: a window without motion, where every model is worse than the
    /// last frame, counts as little as it does there.
    fn between(new: &[Errors], present: &[Errors]) -> Result<Self> {
        let all = |errors: &[Errors]| errors.iter().map(|errors| errors.persistence).sum::<f64>();
        let (of_new, of_present) = (all(new), all(present));
        let gains: Vec<f64> = new
            .iter()
            .zip(present)
            .map(|(new, present)| present.model / of_present - new.model / of_new)
            .collect();
        ensure!(
            gains.iter().all(|gain| gain.is_finite()),
            "the newest recordings show no motion, or a model predicts no number"
        );
        let test = sign_flip_test(&gains, &SignFlip::default())?;
        Ok(Self {
            ratio: ratio(new),
            ratio_before: ratio(present),
            p_value: test.p,
            windows: gains.len(),
            is_better: test.p <= LEVEL && ratio(new) < ratio(present),
        })
    }
}

/// The squared errors of a window.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Errors {
    model: f64,
    persistence: f64,
}

/// Of all windows together.
fn ratio(errors: &[Errors]) -> f64 {
    let sum = |of: fn(&Errors) -> f64| errors.iter().map(of).sum::<f64>();
    sum(|errors| errors.model) / sum(|errors| errors.persistence)
}

/// The errors of a model that repeats the last frame.
fn still(errors: &[Errors]) -> Vec<Errors> {
    let still = errors.iter().map(|errors| Errors {
        model: errors.persistence,
        ..*errors
    });
    still.collect()
}

/// The errors one step ahead, by window.
fn errors(
    model: &str,
    test: &[PathBuf],
    options: &DataOptions,
    cache: &Path,
) -> Result<Vec<Errors>> {
    let folder = ModelFolder::open(model)?;
    let (encoder, world) = (folder.encoder()?, folder.world_model()?);
    let data = Dataset::held_out(test, encoder.framing(), cache, options)?;
    (world.encoding.space()).expect_same(data.action_space(), "the model", "the bags")?;
    let latents = Latents::open(&data, &*encoder, cache)?;
    let windows = Windows::new(&latents, &world.encoding, 1, MOST_WINDOWS)?;
    let sampler = &world.transition.config().sampler;
    let errors = windows.errors_of_all(&world.transition, sampler, ActionChange::None)?;
    let first = errors.iter().filter_map(|steps| steps.first());
    let errors = first.map(|(model, persistence)| Errors {
        model: *model,
        persistence: *persistence,
    });
    Ok(errors.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(ratios: impl IntoIterator<Item = f64>) -> Vec<Errors> {
        let of = |model| Errors {
            model,
            persistence: 1.0,
        };
        ratios.into_iter().map(of).collect()
    }

    #[test]
    fn only_a_surely_better_model_is_accepted() {
        let present = errors((0..30).map(|index| 0.8 + 0.01 * f64::from(index % 7)));
        let better = errors(present.iter().map(|errors| errors.model * 0.9));
        let verdict = Verdict::between(&better, &present).unwrap();
        assert!(verdict.is_better && verdict.p_value < 1e-6, "{verdict:?}");
        assert!(!Verdict::between(&present, &better).unwrap().is_better);
        assert!(!Verdict::between(&present, &present).unwrap().is_better);
        // Better in half of the windows only.
        let noisy = (0..30)
            .map(|index| 0.8 + 0.01 * f64::from(index % 7) + 0.1 * f64::from(index % 2) - 0.051);
        assert!(
            !Verdict::between(&errors(noisy), &present)
                .unwrap()
                .is_better
        );
        let first = Verdict::between(&present, &still(&present)).unwrap();
        assert!(first.is_better && first.ratio_before == 1.0, "{first:?}");
    }

    #[test]
    fn windows_without_motion_count_little() {
        // Where nothing moves, the new model errs ten times as much as the last frame; elsewhere half as much.
        let of = |index: u32| match index % 2 {
            0 => (1e-3, 1e-2),
            _ => (1.0, 0.5 + 0.01 * f64::from(index % 7)),
        };
        let new: Vec<Errors> = (0..40)
            .map(of)
            .map(|(persistence, model)| Errors { model, persistence })
            .collect();
        let verdict = Verdict::between(&new, &still(&new)).unwrap();
        assert!(verdict.is_better && verdict.ratio < 0.6, "{verdict:?}");
        assert!(Verdict::between(&errors([]), &errors([])).is_err());
        let motionless = [Errors {
            model: 0.1,
            persistence: 0.0,
        }; 3];
        assert!(Verdict::between(&motionless, &motionless).is_err());
    }
}
