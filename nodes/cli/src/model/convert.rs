//! `wm model convert`.

use crate::output::print;
use anyhow::{Result, ensure};
use clap::Args;
use std::path::PathBuf;
use wm_program::progress::Progress;
use wm_zoo::Checkpoint;
use wm_zoo::checkpoint::{Average, convert};

/// Writes a checkpoint as safetensors. Only the tensors of the network are written: of `model` and `ema` the average,
/// and no optimiser state. Nothing in a torch file is executed.
#[derive(Args, Debug)]
pub struct ConvertCommand {
    /// Checkpoint: a torch file, or safetensors
    #[arg(value_name = "IN.pt")]
    input: PathBuf,
    /// File to write
    #[arg(value_name = "OUT.safetensors")]
    output: PathBuf,
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
    /// Runs it.
    pub fn run(self) -> Result<()> {
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
        let same =
            std::fs::canonicalize(&self.input).ok() == std::fs::canonicalize(&self.output).ok();
        ensure!(!same, "input and output are the same file");
        let progress = Progress::open_ended("converting", "tensors");
        let written = convert(&checkpoint, &self.output)?;
        drop(progress);
        let part = match checkpoint.part_name() {
            "" => String::new(),
            part => format!(" of `{part}`"),
        };
        print(format_args!(
            "{}: {} tensors{part}, {:.3} M values, {:.1} MB\n",
            self.output.display(),
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
    fn the_average_is_taken_unless_told_otherwise() {
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
                output: output.clone(),
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
            output: input.clone(),
            raw: false,
            part: None,
            all: false,
        };
        assert!(same.run().is_err());
    }
}
