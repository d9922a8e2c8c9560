use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use wm_zoo::{ModelFolder, idm::TrainedIdm};

use super::{DistillRecipe, teacher::Teacher, train_on};
use crate::{
    arguments::RunArgs,
    model_folder::carry_encoder,
    run::{RunEnd, Stop},
    transition::FILE,
};

/// Train a student that predicts in one or two steps like its teacher, a trained transition model, in ten
///
/// The student has the teacher's shape and replaces it in a model. At the end it is compared with the teacher; if it falls
/// behind, the training fails.
#[derive(Clone, Debug, Args)]
pub struct TrainDistillArgs {
    /// Options of every training.
    #[command(flatten)]
    pub run: RunArgs,
    /// Trained transition model: its weights, or a folder with transition.safetensors
    #[arg(long, value_name = "PATH")]
    pub teacher: PathBuf,
    /// Model whose frozen encoder makes the latents: tiny, or a model's folder [default: the teacher's folder]
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: Option<String>,
    /// Weights of an inverse dynamics model, for the correlation of inferred actions
    #[arg(long, value_name = "FILE")]
    pub idm: Option<PathBuf>,
    /// Keep a student that falls behind its teacher, or cannot be measured
    #[arg(long)]
    pub accept: bool,
}

impl TrainDistillArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If teacher, data, recipe, checkpoint or weights cannot be read or written, the training diverges, or the student
    /// falls behind its teacher.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let run = &self.run;
        let recipe: DistillRecipe = run.load_recipe([])?;
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
                // A bare file name has an empty folder.
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
        let gated = super::GateData {
            held_out,
            idm: idm.as_ref(),
            accept: self.accept,
        };
        train_on(run, &recipe, &teacher, &on.train, &gated, stop)
    }
}
