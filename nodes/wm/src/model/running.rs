//! What running any model takes: its files, and what computes it.

use crate::output::print;
use anyhow::{Context as _, Result, bail};
use candle_core::{DType, Device};
use clap::Args;
use std::collections::HashMap;
use std::path::PathBuf;
use wm_zoo::checkpoint::Average;
use wm_zoo::kinds::{Kind, Tensors};
use wm_zoo::{Checkpoint, Engine};

/// Files and engine of a model.
#[derive(Args, Debug)]
pub struct RunningArgs {
    /// Configuration, JSON: Hugging Face's config.json, or ours (`wm model forward --help`)
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Checkpoint: safetensors, or a torch file
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Input tensors, safetensors
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Output tensors, safetensors
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// What computes: `cpu`, our kernels, or `candle`, the reference
    #[arg(long, default_value_t = Engine::Cpu)]
    pub engine: Engine,
    /// Number format of the weights: f32 or bf16
    #[arg(long, default_value = "f32", value_parser = parse_dtype)]
    pub dtype: DType,
    /// Take the weights as the optimiser left them where the checkpoint has their moving average, too
    #[arg(long)]
    raw: bool,
}

/// A model's files, read.
pub struct Files {
    /// The configuration, JSON.
    pub config: String,
    /// The weights.
    pub checkpoint: Checkpoint,
    /// The input.
    pub inputs: Tensors,
}

impl RunningArgs {
    /// Reads the files of a model of `kind`.
    pub fn read(&self, kind: Kind) -> Result<Files> {
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
        })
    }

    /// Writes the output and says what it is.
    pub fn write(&self, outputs: Tensors) -> Result<()> {
        for (name, tensor) in &outputs {
            print(format_args!("{name} {:?}\n", tensor.dims()))?;
        }
        let outputs: HashMap<String, _> = outputs.into_iter().collect();
        candle_core::safetensors::save(&outputs, &self.output)
            .with_context(|| self.output.display().to_string())
    }
}

fn parse_dtype(name: &str) -> Result<DType> {
    Ok(match name {
        "f32" => DType::F32,
        "bf16" => DType::BF16,
        _ => bail!("`{name}`, expected f32 or bf16"),
    })
}
