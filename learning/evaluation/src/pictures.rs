mod moved_objects;

use std::fmt;

use anyhow::{Context as _, Result};
use candle_core::Tensor;
use rayon::prelude::*;
use wm_dataset::Dataset;
use wm_model::{Decoder, transition::LoadedTransition};

use crate::{ActionChange, CONTEXT, SquaredError, Windows};
use moved_objects::{MovedObjects, Truth};

/// Errors by step of decoded predictions, and of persistence (the last observed frame, repeated).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureErrors {
    steps: Vec<StepErrors>,
}

/// Errors of one predicted step over all windows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepErrors {
    /// Of the decoded prediction.
    pub predicted: SquaredError,
    /// Of the last observed frame.
    pub held: SquaredError,
    /// Of the decoded prediction inside the true frame's masks (gripper and objects).
    pub predicted_in_masks: SquaredError,
    /// Of the last observed frame inside the same masks.
    pub held_in_masks: SquaredError,
    /// Objects that moved, and those that the decoded prediction lost.
    pub objects: MovedObjects,
}

impl PictureErrors {
    /// Decodes the predictions of `model` for all `windows`, whose latents are those of `dataset`.
    ///
    /// # Errors
    /// If model, decoder and dataset do not fit.
    pub fn measure(
        windows: &Windows,
        model: &LoadedTransition,
        decoder: &dyn Decoder,
        dataset: &Dataset,
    ) -> Result<Self> {
        let errors_of = (0..windows.len())
            .into_par_iter()
            .map(|window| {
                let predicted =
                    windows.predict(window, model, &model.config().sampler, ActionChange::None)?;
                let frames = windows.frame_indices(window)?;
                let held = frames.get(CONTEXT - 1).context("an observed frame")?;
                let truths = frames.iter().skip(CONTEXT);
                predicted
                    .iter()
                    .zip(truths)
                    .map(|(latent, truth)| StepErrors::of(latent, *truth, *held, decoder, dataset))
                    .collect::<Result<Vec<_>>>()
            })
            .collect::<Result<Vec<_>>>()?;
        let mut errors = Self::default();
        for window in errors_of {
            errors.steps.resize(window.len(), StepErrors::default());
            for (sum, step) in errors.steps.iter_mut().zip(&window) {
                sum.add(step);
            }
        }
        Ok(errors)
    }

    /// Errors at k = 1, 2, ...
    #[must_use]
    pub fn steps(&self) -> &[StepErrors] {
        &self.steps
    }
}

impl StepErrors {
    fn of(
        latent: &Tensor,
        truth: usize,
        held: usize,
        decoder: &dyn Decoder,
        dataset: &Dataset,
    ) -> Result<Self> {
        let picture = decoder.decode(latent)?.flatten_all()?.to_vec1::<f32>()?;
        let frame = |index| {
            dataset
                .frame(index)
                .with_context(|| format!("no frame {index}"))
        };
        // Without masks, no pixel is inside one.
        let mask_of = |index| dataset.mask(index).unwrap_or_default();
        let (mask, observed_mask) = (mask_of(truth), mask_of(held));
        let (truth_frame, held) = (frame(truth)?, frame(held)?);
        let seen = Truth {
            pixels: truth_frame,
            mask,
            observed_mask,
            width: dataset.size().1,
        };
        let mut errors = Self {
            objects: MovedObjects::of(&seen, &picture),
            ..Self::default()
        };
        let mut masks = mask.iter();
        let pixels = picture
            .chunks_exact(3)
            .zip(truth_frame.chunks_exact(3))
            .zip(held.chunks_exact(3));
        for ((predicted, truth), held) in pixels {
            let error_of = |value: &dyn Fn(usize) -> f64| -> f64 {
                let truth = truth.iter().enumerate();
                truth
                    .map(|(i, truth)| (value(i) - f64::from(*truth) / 255.0).powi(2))
                    .sum()
            };
            let predicted = error_of(&|i| predicted.get(i).copied().map_or(0.0, f64::from));
            let held = error_of(&|i| held.get(i).copied().map_or(0.0, f64::from) / 255.0);
            errors.predicted.add_pixel(predicted);
            errors.held.add_pixel(held);
            if masks.next().is_some_and(|class| *class > 0) {
                errors.predicted_in_masks.add_pixel(predicted);
                errors.held_in_masks.add_pixel(held);
            }
        }
        Ok(errors)
    }

    fn add(&mut self, other: &Self) {
        self.predicted.add(&other.predicted);
        self.held.add(&other.held);
        self.predicted_in_masks.add(&other.predicted_in_masks);
        self.held_in_masks.add(&other.held_in_masks);
        self.objects.add(&other.objects);
    }
}

impl fmt::Display for PictureErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        type Psnr = fn(&StepErrors) -> Option<f64>;
        let rows: [(&str, Psnr); 4] = [
            ("predicted", |step| step.predicted.psnr()),
            ("held", |step| step.held.psnr()),
            ("predicted, masks", |step| step.predicted_in_masks.psnr()),
            ("held, masks", |step| step.held_in_masks.psnr()),
        ];
        write!(
            f,
            "PSNR [dB] of the decoded pictures, and of the last observed frame, repeated"
        )?;
        for (name, of) in rows {
            if self.steps.iter().all(|step| of(step).is_none()) {
                continue;
            }
            write!(f, "\n{name:<16} ")?;
            for step in &self.steps {
                match of(step) {
                    Some(psnr) => write!(f, "{psnr:<7.2}")?,
                    None => write!(f, "{:<7}", "-")?,
                }
            }
        }
        if self.steps.iter().any(|step| step.objects.moved > 0) {
            write!(
                f,
                "\nmoved objects that vanished, of all that moved\n{:<16} ",
                ""
            )?;
            for MovedObjects { moved, vanished } in self.steps.iter().map(|step| step.objects) {
                write!(f, "{:<7}", format!("{vanished}/{moved}"))?;
            }
        }
        Ok(())
    }
}
