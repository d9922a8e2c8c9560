//! `wm model convert`.

use crate::output::print;
use anyhow::{Context as _, Result, ensure};
use clap::Args;
use std::path::PathBuf;
use wm_program::progress::Progress;
use wm_zoo::Checkpoint;
use wm_zoo::checkpoint::{Average, convert};
use wm_zoo::folder::describe_autoencoder;

/// Writes a checkpoint as safetensors, or the model.json of a folder without one. Of a checkpoint, only the tensors of the
/// network are written: of `model` and `ema` the average, and no optimiser state. Nothing in a torch file is executed.
#[derive(Args, Debug)]
pub(crate) struct ConvertCommand {
    /// Checkpoint: a torch file, or safetensors; or a model folder that a training of version 0.1 wrote
    #[arg(value_name = "IN.pt|DIR")]
    input: PathBuf,
    /// File to write; not for a folder
    #[arg(value_name = "OUT.safetensors")]
    output: Option<PathBuf>,
    /// Take the raw weights instead of their moving average
    #[arg(long, conflicts_with = "all")]
    raw: bool,
    /// Take only this part of a checkpoint with several networks, for example `adapter` or `ema_encoder`
    #[arg(long, value_name = "NAME")]
    part: Option<String>,
    /// Take all tensors, with their full names
    #[arg(long)]
    all: bool,
}

impl ConvertCommand {
    pub(crate) fn run(self) -> Result<()> {
        if self.input.is_dir() {
            ensure!(
                self.output.is_none(),
                "{}: a folder gets its model.json in place; leave out the second argument",
                self.input.display()
            );
            let path = describe_autoencoder(&self.input)?;
            return print(format_args!("{}\n", path.display()));
        }
        let usage = "expected a file to write: wm model convert IN.pt OUT.safetensors";
        let output = self.output.as_deref().context(usage)?;
        let mut checkpoint = Checkpoint::open(&self.input)?;
        if let Some(part) = &self.part {
            for name in part.split('.') {
                checkpoint = checkpoint.require_part(name)?;
            }
        }
        if !self.all {
            let average = if self.raw { Average::Raw } else { Average::Ema };
            checkpoint = checkpoint.weights(average);
        }
        // The input is mapped into memory: it must stay as it is until the output is written.
        let same = std::fs::canonicalize(&self.input).ok() == std::fs::canonicalize(output).ok();
        ensure!(!same, "input and output are the same file");
        let progress = Progress::open_ended("converting", "tensors");
        let written = convert(&checkpoint, output)?;
        drop(progress);
        let part = match checkpoint.part_name() {
            "" => String::new(),
            part => format!(" of `{part}`"),
        };
        print(format_args!(
            "{}: {} tensors{part}, {:.3} M values, {:.1} MB\n",
            output.display(),
            written.tensors,
            written.parameters as f64 / 1e6,
            written.bytes as f64 / 1e6,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Tensor};
    use std::collections::HashMap;
    use std::path::Path;

    fn names(path: &Path) -> Vec<String> {
        let checkpoint = Checkpoint::open(path).unwrap();
        checkpoint.names().map(ToOwned::to_owned).collect()
    }

    #[test]
    fn averaged_weights_are_the_default() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("in"), folder.path().join("out"));
        let tensor = |value: f32| Tensor::new(&[value], &Device::Cpu).unwrap();
        let tensors: HashMap<_, _> = [
            ("model.module.w", tensor(1.0)),
            ("ema.module.w", tensor(2.0)),
            ("optimizer.state.0.exp_avg", tensor(3.0)),
        ]
        .into();
        candle_core::safetensors::save(&tensors, &input).unwrap();
        let convert = |raw, part: Option<&str>, all| {
            let command = ConvertCommand {
                input: input.clone(),
                output: Some(output.clone()),
                raw,
                part: part.map(ToOwned::to_owned),
                all,
            };
            command.run()
        };
        let value = || {
            let tensor = Checkpoint::open(&output).unwrap();
            let tensor = tensor.tensor("w", candle_core::DType::F32).unwrap();
            tensor.to_vec1::<f32>().unwrap()
        };
        convert(false, None, false).unwrap();
        assert_eq!((names(&output), value()), (vec!["w".to_owned()], vec![2.0]));
        convert(true, None, false).unwrap();
        assert_eq!(value(), [1.0]);
        convert(false, None, true).unwrap();
        assert_eq!(names(&output).len(), 3);
        convert(false, Some("optimizer.state"), false).unwrap();
        assert_eq!(names(&output), ["0.exp_avg"]);
        let message = convert(false, Some("adapter"), false)
            .unwrap_err()
            .to_string();
        assert!(message.contains("ema, model, optimizer"), "{message}");
        let same = ConvertCommand {
            input: input.clone(),
            output: Some(input.clone()),
            raw: false,
            part: None,
            all: false,
        };
        assert!(same.run().is_err());
    }

    #[test]
    fn a_folder_gets_its_model_json_in_place() {
        let folder = tempfile::tempdir().unwrap();
        let config = wm_model::AutoencoderConfig::tiny();
        let autoencoder = wm_model::Autoencoder::random(config, 1).unwrap();
        let weights = folder.path().join(wm_model::Autoencoder::FILE);
        autoencoder
            .save(weights, wm_model::weights::Precision::F16)
            .unwrap();
        let convert = |output| {
            let command = ConvertCommand {
                input: folder.path().to_owned(),
                output,
                raw: false,
                part: None,
                all: false,
            };
            command.run()
        };
        convert(None).unwrap();
        assert!(folder.path().join("model.json").is_file());
        let other = folder.path().join("other");
        assert!(convert(Some(other.clone())).is_err() && !other.exists());
    }
}
