//! Computation of a model on this machine: parameters, operations, time, memory. The only suite whose figures vary
//! between runs.

use std::time::Instant;

use anyhow::Result;
use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};
use wm_metrics::findings::{Better, Metric, Section, Suite, TextTable};
use wm_model::sampler::Rollout;
use wm_zoo::cost;

use crate::{CONTEXT, Subject};

/// Timed runs, after one warm-up.
const RUNS: usize = 15;

/// Cost of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelCost {
    /// Trained parameters of the transition model.
    pub transition_parameters: usize,
    /// Operations of one velocity evaluation for a frame.
    pub transition_operations: usize,
    /// Euler steps of a predicted frame.
    pub euler_steps: usize,
    /// Times of the parts \[ms\].
    pub parts: Vec<(String, Vec<f64>)>,
    /// Peak memory of this process \[MB\], if known.
    pub peak_megabytes: Option<f64>,
    /// Name of the processor, if known.
    pub machine: String,
}

/// Counts and times.
///
/// # Errors
/// If a part fails.
pub fn measure(subject: &Subject) -> Result<ModelCost> {
    let model = &subject.world.transition;
    let config = model.config();
    let (height, width) = subject.encoder.input_size();
    let picture = Tensor::full(0.5f32, (1, height, width, 3), &Device::Cpu)?;
    let latent = subject.encoder.encode(&picture)?;
    let context = Tensor::stack(&vec![latent.squeeze(0)?; CONTEXT], 0)?.unsqueeze(0)?;
    let past = Tensor::zeros((CONTEXT - 1, config.action_dim), DType::F32, &Device::Cpu)?;
    let action = Tensor::zeros((1, config.action_dim), DType::F32, &Device::Cpu)?;
    let mut parts = vec![
        (
            "encode a frame".to_owned(),
            times(|| {
                subject
                    .encoder
                    .encode(&picture)
                    .map(drop)
                    .map_err(Into::into)
            })?,
        ),
        (
            "predict a frame".to_owned(),
            times(|| {
                let mut rollout = Rollout::new(model, subject.sampler(), &context, Some(&past), 0)?;
                rollout.next(&action).map(drop).map_err(Into::into)
            })?,
        ),
    ];
    if let Some(decoder) = &subject.decoder {
        let decode = times(|| decoder.decode(&latent).map(drop).map_err(Into::into))?;
        parts.push(("decode a frame".to_owned(), decode));
    }
    Ok(ModelCost {
        transition_parameters: config.parameter_count(),
        transition_operations: cost::transition_of(config)?.operations,
        euler_steps: subject.sampler().steps,
        parts,
        peak_megabytes: peak_megabytes(),
        machine: machine(),
    })
}

/// Sorted times of some runs \[ms\].
fn times(run: impl Fn() -> Result<()>) -> Result<Vec<f64>> {
    run()?;
    let timed = (0..RUNS).map(|_| {
        let started = Instant::now();
        run()?;
        Ok(started.elapsed().as_secs_f64() * 1e3)
    });
    let mut times = timed.collect::<Result<Vec<_>>>()?;
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// `VmHWM` of /proc/self/status.
fn peak_megabytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}

fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let mut lines = info.lines();
    let name = lines.find_map(|line| line.strip_prefix("model name")?.split(':').nth(1));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let name = name.map_or("unknown processor", str::trim);
    format!("{name}, {cores} threads")
}

/// Findings of the only unit.
#[must_use]
pub fn summarise(units: &[(String, ModelCost)]) -> Section {
    let mut section = Section::new(Suite::Cost);
    let Some((_, found)) = units.first() else {
        return section;
    };
    section.metric(
        "transition_parameters",
        Metric::plain(
            found.transition_parameters as f64 / 1e6,
            1,
            Better::Lower,
            "trained parameters of the transition model",
        )
        .in_unit("M"),
    );
    section.metric(
        "transition_gflops",
        Metric::plain(
            found.transition_operations as f64 / 1e9,
            1,
            Better::Lower,
            "operations of one velocity evaluation for a frame, by the paper's convention",
        )
        .in_unit("GFLOPs"),
    );
    section.metric(
        "euler_steps",
        Metric::plain(
            found.euler_steps as f64,
            1,
            Better::Lower,
            "velocity evaluations of a predicted frame",
        ),
    );
    let mut rows = Vec::new();
    for (part, times) in &found.parts {
        let at = |share: f64| {
            let place = (share * times.len().saturating_sub(1) as f64).round() as usize;
            // Without runs there is no time; NaN is reported as missing.
            times.get(place).copied().unwrap_or(f64::NAN)
        };
        let name = part.replace(" a ", "_").replace(' ', "_");
        let about = format!("median time to {part} on this machine, other suites not running");
        section.metric(
            &format!("{name}_ms"),
            Metric::plain(at(0.5), times.len(), Better::Lower, &about).in_unit("ms"),
        );
        let text = |share| format!("{:.2}", at(share));
        rows.push(vec![part.clone(), text(0.5), text(0.95), text(1.0)]);
    }
    section.tables.push(TextTable {
        title: format!("Times on {} [ms], n = {RUNS}", found.machine),
        header: ["part", "p50", "p95", "most"].map(String::from).into(),
        rows,
    });
    match found.peak_megabytes {
        Some(megabytes) => section.metric(
            "peak_memory",
            Metric::plain(
                megabytes,
                1,
                Better::Lower,
                "peak memory of the evaluation so far, including data and earlier suites",
            )
            .in_unit("MB"),
        ),
        None => section.absent("peak_memory", "this system does not report it"),
    }
    section.notes.push(
        "Parameters and operations of encoders, adapters and decoders of published models: wm model check, wm model info."
            .into(),
    );
    section
}
