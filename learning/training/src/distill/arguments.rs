use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use wm_zoo::{ModelFolder, idm::TrainedIdm};

use super::{DistillRecipe, RECIPES, teacher::Teacher, train_on};
use crate::{
    arguments::RunArgs,
    model_folder::carry_encoder,
    run::{Ended, Stop},
    transition::FILE,
};

/// Trains a student that predicts in one or two steps what a trained transition model, its teacher, predicts in ten.
///
/// The student has the teacher's shape and takes its place in a model. At the end it is measured beside the teacher; if
/// it falls behind, the training fails.
#[derive(Clone, Debug, Args)]
pub struct TrainDistillArgs {
    /// What every training has.
    #[command(flatten)]
    pub run: RunArgs,
    /// The trained transition model: its weights, or the folder that has them as transition.safetensors.
    #[arg(long, value_name = "PATH")]
    pub teacher: PathBuf,
    /// The model whose frozen encoder makes the latents: tiny, or a model's folder; by default the teacher's folder.
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: Option<String>,
    /// Weights of an inverse dynamics model, to measure how well actions are told from the predictions.
    #[arg(long, value_name = "FILE")]
    pub idm: Option<PathBuf>,
    /// Keep a student that falls behind its teacher, or that there are no episodes to measure on.
    #[arg(long)]
    pub accept: bool,
}

impl TrainDistillArgs {
    /// Trains until the last step, or until `stop` asks for the end.
    ///
    /// # Errors
    /// When teacher, data, recipe, checkpoint or weights cannot be read or written, the training diverges, or the student
    /// falls behind its teacher.
    pub fn run(&self, stop: &Stop) -> Result<Ended> {
        let run = &self.run;
        let recipe: DistillRecipe = crate::recipe::load(RECIPES, &run.recipe, &run.overrides())?;
        let file = Teacher::file(&self.teacher);
        let teacher = Teacher::open(&file, recipe.teacher_steps, &run.compute()?)?;
        let written = run.out.join(FILE).canonicalize();
        if written.is_ok_and(|written| file.canonicalize().is_ok_and(|file| file == written)) {
            bail!(
                "--out {}: the student would be written over its teacher; use another folder, or move the teacher",
                run.out.display()
            );
        }
        let encoder = match &self.encoder {
            Some(encoder) => encoder.clone(),
            None => {
                // Of a bare file name the folder is empty.
                let file = file
                    .canonicalize()
                    .with_context(|| file.display().to_string())?;
                let folder = file.parent().context("the teacher has no folder")?;
                folder.display().to_string()
            }
        };
        let on = run.encoded(&*ModelFolder::open(&encoder)?.encoder()?)?;
        let idm = self.idm.as_deref().map(TrainedIdm::open).transpose()?;
        teacher.require(&on.train)?;
        carry_encoder(&encoder, &run.out)?;
        let held_out = on.held_out.as_ref();
        let gated = super::Gated {
            held_out,
            idm: idm.as_ref(),
            accept: self.accept,
        };
        train_on(run, &recipe, &teacher, &on.train, &gated, stop)
    }
}
