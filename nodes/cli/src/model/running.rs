//! Options of all runs of a model: its files and a compute engine.

use crate::output::print;
use anyhow::{Context as _, Result};
use candle_core::Device;
use clap::Args;
use std::collections::HashMap;
use std::path::PathBuf;
use wm_model::{Compute, Kernels, NumberFormat};
use wm_zoo::Checkpoint;
use wm_zoo::checkpoint::Average;
use wm_zoo::kinds::{Kind, Tensors};

/// Files and engine of a model.
#[derive(Args, Debug)]
pub(super) struct RunningArgs {
    /// Configuration in JSON: a Hugging Face config.json, or wm's own format (`wm model forward --help`)
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Checkpoint: safetensors or a torch file
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Input tensors, safetensors
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Output tensors, safetensors
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// Compute engine: `cpu` (wm's own kernels) or `candle` (the reference)
    #[arg(long, default_value_t = Kernels::Cpu)]
    engine: Kernels,
    /// Device: `cpu`, or with `--engine candle` also `cuda` or `cuda:N`, an NVIDIA GPU
    #[arg(long, default_value = "cpu")]
    device: Compute,
    /// Number format of the weights: f32, bf16, or with `--engine cpu` int8
    #[arg(long, default_value_t = NumberFormat::F32)]
    dtype: NumberFormat,
    /// Take the raw weights, even if the checkpoint also has their moving average
    #[arg(long)]
    raw: bool,
}

/// A model's files in memory, and its compute engine.
pub(super) struct Files {
    /// JSON.
    pub config: String,
    pub checkpoint: Checkpoint,
    pub inputs: Tensors,
    /// Kernels, device and number format.
    pub compute: Compute,
}

impl RunningArgs {
    /// Opens the device and reads the files of a model of `kind`.
    pub(super) fn read(&self, kind: Kind) -> Result<Files> {
        let compute = self.device.clone();
        compute.device()?;
        let compute = compute.with_kernels(self.engine)?.with_format(self.dtype)?;
        let config = std::fs::read_to_string(&self.config)
            .with_context(|| self.config.display().to_string())?;
        let mut checkpoint = Checkpoint::open(&self.weights)?;
        if self.raw {
            checkpoint = kind.weights(&checkpoint, Average::Raw);
        }
        let inputs = candle_core::safetensors::load(&self.input, &Device::Cpu)
            .with_context(|| self.input.display().to_string())?;
        Ok(Files {
            config,
            checkpoint,
            inputs: inputs.into_iter().collect(),
            compute,
        })
    }

    /// Writes the output and prints its shapes.
    pub(super) fn write(&self, outputs: Tensors) -> Result<()> {
        for (name, tensor) in &outputs {
            print(format_args!("{name} {:?}\n", tensor.dims()))?;
        }
        let outputs: HashMap<String, _> = outputs.into_iter().collect();
        candle_core::safetensors::save(&outputs, &self.output)
            .with_context(|| self.output.display().to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        running: RunningArgs,
    }

    fn parse(device: &str) -> Result<RunningArgs, clap::Error> {
        let files = ["--config=c", "--weights=w", "--input=i", "--output=o"];
        let cli = Cli::try_parse_from(["wm"].into_iter().chain(files).chain(["--device", device]))?;
        Ok(cli.running)
    }

    #[test]
    fn unknown_device_is_wrong_usage() {
        let message = parse("gpu").unwrap_err().to_string();
        assert!(
            message.contains("expected cpu, cuda or cuda:N"),
            "{message}"
        );
    }

    #[test]
    #[cfg(not(feature = "cuda"))]
    fn unsupported_device_is_refused_before_files_are_read() {
        let error = parse("cuda:1").unwrap().read(Kind::Dit).err().unwrap();
        let message = error.to_string();
        assert!(
            message.contains("cuda:1") && message.contains("--features cuda"),
            "{message}"
        );
    }
}
