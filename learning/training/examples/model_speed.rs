//! How long a model takes on this machine, for `benches/models.py`.
//!
//! ```text
//! cargo run --release -p wm_training --example model_speed -- pixel FOLDER bf16 5
//! cargo run --release -p wm_training --features cuda --example model_speed -- velocity FOLDER bf16 5 cuda recorded
//! ```
//!
//! Arguments:
//!
//! - what is timed, see below;
//! - a folder with `config.json`, `weights.safetensors` and `input.safetensors`;
//! - the number format: f32, bf16 or int8;
//! - the number of runs;
//! - optionally a device, or `candle` for candle's operations on the CPU in place of our kernels;
//! - `recorded`, to record passes on that device and repeat them;
//! - `--keep=FOLDER`, to keep packed weights in that folder and find them again.
//!
//! It prints the time of loading, the most memory that loading took, and the time of each run, a line each (`load_ms`,
//! `peak_mib`, `run_ms`). It writes `output.safetensors` of the last run into the folder.
//!
//! Any kind of `wm model forward` can be timed, and of the transition model
//!
//! - `velocity`: `x` (B,T,H,W,C), `tau` (B,T), `action` (B,T,A) as for `dit`, but only the last frame, after T - 1 of which
//!   keys and values are cached; gives its `velocity` (B,1,H,W,C);
//! - `frame`: a predicted frame of n candidates after a `context` (1,T,H,W,C) that is computed, too: `actions` (n,T+1,A),
//!   of which the first T - 1 of the first candidate are everyone's, `noise` (1,1,H,W,C); gives `predicted` (n,1,H,W,C).

use std::collections::HashMap;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

use candle_core::{Device, Tensor};
use wm_model::sampler::{Given, Rollout};
use wm_model::transition::{LoadedTransition, NewFrame};
use wm_model::{Compute, Kernels, NumberFormat};
use wm_zoo::kinds::{DitConfig, Kind, Loaded, Tensors};
use wm_zoo::packed_cache::CacheLimits;
use wm_zoo::{Checkpoint, PackedCache};

/// Before the folder of packed weights.
const KEEP: &str = "--keep=";

type Result<T> = std::result::Result<T, Box<dyn Error>>;
type Run<'a> = Box<dyn FnMut() -> Result<Tensors> + 'a>;

fn main() -> Result<()> {
    // As in the program `wm`.
    wm_program::process::prepare();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // On a thread of the pool, as in the nodes: another would sleep while the pool works, and be woken after each operation.
    let timed = rayon::scope(|_| time(&arguments).map_err(|error| error.to_string()));
    Ok(timed?)
}

fn time(arguments: &[String]) -> Result<()> {
    let (kept, rest): (Vec<&String>, Vec<&String>) = arguments
        .iter()
        .partition(|argument| argument.starts_with(KEEP));
    let cache = kept.first().and_then(|kept| kept.strip_prefix(KEEP));
    let [what, folder, format, runs, place @ ..] = rest.as_slice() else {
        return Err(
            "expected KIND FOLDER f32|bf16|int8 RUNS [DEVICE|candle [recorded]] [--keep=FOLDER]"
                .into(),
        );
    };
    let compute = match place.first().map(|name| name.as_str()) {
        None => Compute::default(),
        Some("candle") => Compute::on_cpu(Kernels::Candle),
        Some(device) => device.parse()?,
    };
    let is_recorded = place.get(1).is_some_and(|word| *word == "recorded");
    let format: NumberFormat = format.parse()?;
    let compute = compute.recording(is_recorded).with_format(format)?;
    compute.device()?;
    let runs: usize = runs.parse()?;
    let folder = Path::new(folder);
    let config = std::fs::read_to_string(folder.join("config.json"))?;
    let input = candle_core::safetensors::load(folder.join("input.safetensors"), &Device::Cpu)?;
    let inputs: Tensors = input.into_iter().collect();

    let cache = cache.map(|folder| PackedCache::new(folder, CacheLimits::default()));
    if let Some(cache) = cache.clone() {
        cache.use_in_process();
    }
    let before = peak_mib()?;
    let start = Instant::now();
    let checkpoint = Checkpoint::open(folder.join("weights.safetensors"))?;
    let (packed, loaded);
    let mut run: Run<'_> = if ["velocity", "frame"].contains(&what.as_str()) {
        let config = serde_json::from_str::<DitConfig>(&config)?;
        packed = config.load(&checkpoint, &compute)?;
        if *what == "velocity" {
            velocity(&packed, &inputs)?
        } else {
            Box::new(|| frame(&packed, &inputs))
        }
    } else {
        let kind: Kind = what.parse()?;
        loaded = Loaded::new(kind, &config, &checkpoint, &compute)?;
        Box::new(|| Ok(loaded.run(&inputs)?))
    };
    println!("load_ms {:.1}", start.elapsed().as_secs_f64() * 1e3);
    println!("peak_mib {:.0}", peak_mib()? - before);
    if let Some(cache) = cache {
        cache.wait();
    }
    for left in (0..runs).rev() {
        let start = Instant::now();
        let output = run()?;
        println!("run_ms {:.3}", start.elapsed().as_secs_f64() * 1e3);
        if left == 0 {
            let output: HashMap<String, Tensor> = output.into_iter().collect();
            candle_core::safetensors::save(&output, folder.join("output.safetensors"))?;
        }
    }
    Ok(())
}

/// The tensor `name` of the inputs.
fn input<'a>(inputs: &'a Tensors, name: &str) -> Result<&'a Tensor> {
    Ok(inputs.get(name).ok_or_else(|| format!("no `{name}`"))?)
}

/// Values of frame `t` of a (B, T, ..) tensor.
fn values(tensor: &Tensor, t: usize) -> Result<Vec<f32>> {
    Ok(tensor.narrow(1, t, 1)?.flatten_all()?.to_vec1()?)
}

fn velocity<'a>(model: &'a LoadedTransition, inputs: &Tensors) -> Result<Run<'a>> {
    let (x, tau) = (input(inputs, "x")?, input(inputs, "tau")?);
    let action = input(inputs, "action")?;
    let last = tau.dim(1)? - 1;
    let frames = (0..=last)
        .map(|t| Ok((values(x, t)?, values(tau, t)?, values(action, t)?)))
        .collect::<Result<Vec<_>>>()?;
    let mut contexts = Vec::new();
    for frame in frames.iter().take(last) {
        let earlier: Vec<_> = contexts.iter().collect();
        let mut pass = model.pass(&earlier, &[new_frame(frame)], 1, 1)?;
        contexts.append(&mut pass.contexts);
    }
    let frame = frames.into_iter().next_back().ok_or("no frame")?;
    let shape = x.narrow(1, last, 1)?.shape().clone();
    Ok(Box::new(move || {
        let earlier: Vec<_> = contexts.iter().collect();
        let outputs = model.pass(&earlier, &[new_frame(&frame)], 0, 0)?.outputs;
        let velocity = Tensor::from_vec(outputs.concat(), &shape, &Device::Cpu)?;
        Ok(Tensors::from([("velocity".to_owned(), velocity)]))
    }))
}

fn new_frame((latents, tau, action): &(Vec<f32>, Vec<f32>, Vec<f32>)) -> NewFrame<'_> {
    NewFrame {
        latents,
        tau,
        action,
    }
}

fn frame(model: &LoadedTransition, inputs: &Tensors) -> Result<Tensors> {
    let (context, actions) = (input(inputs, "context")?, input(inputs, "actions")?);
    let noise = input(inputs, "noise")?.squeeze(1)?;
    let observed = context.dim(1)?;
    let past = actions.get(0)?.narrow(0, 0, observed - 1)?;
    let sampler = &model.config().sampler;
    let start = Rollout::new(model, sampler, context, Some(&past), 0)?;
    let mut rollout = start.candidates(actions.dim(0)?)?;
    let of = |t| actions.narrow(1, t, 1)?.squeeze(1)?.contiguous();
    let given = Given {
        noise: Some(&noise),
        own_action: Some(&of(observed)?),
    };
    let predicted = rollout.next_given(&of(observed - 1)?, given)?;
    Ok(Tensors::from([(
        "predicted".to_owned(),
        predicted.unsqueeze(1)?,
    )]))
}

/// The most memory that this process had so far, MiB (Linux; else 0).
fn peak_mib() -> Result<f64> {
    let Ok(status) = std::fs::read_to_string("/proc/self/status") else {
        return Ok(0.0);
    };
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().next());
    Ok(kib.ok_or("no VmHWM")?.parse::<f64>()? / 1024.0)
}
