//! `wm model calibrate`: measures the input ranges of a model's matrices on bags, and the error of int8.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use candle_core::Tensor;
use clap::Args;
use wm_dataset::{ClipSource, DataOptions, Dataset, FrameValues as _};
use wm_model::{Compute, Decoder, Encoder, WorldModel};
use wm_zoo::calibration::{FILE, Origin, STRENGTH};
use wm_zoo::folder::DescribedFolder;
use wm_zoo::{Calibration, ModelFolder};

use crate::CONTEXT;
use crate::subject::predict;
use crate::windows::SEED;

/// Predicted frames per context.
const PREDICTED: usize = 2;

/// Calibrate a model's int8 input ranges, for `"dtype": "int8"` in its model.json
///
/// Runs the model in f32 on frames and actions spread evenly over the bags. Writes the largest absolute value of every
/// matrix input beside the model.json, where loading in int8 finds it. As many other frames measure the error of int8
/// against f32, with and without calibration.
#[derive(Args, Clone, Debug)]
pub struct CalibrateArgs {
    /// The model's folder, with a model.json
    #[arg(value_name = "DIR")]
    model: String,
    /// Bags, folders of bags, or folders that `wm dataset` prepared
    #[arg(long = "bag", required = true, num_args = 1.., value_name = "PATH")]
    bags: Vec<PathBuf>,
    /// Frames to run the model on; fewer if the bags have fewer
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Share of the inputs' range that moves to the weights, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = STRENGTH, value_parser = strength)]
    strength: f32,
    /// Replace an existing calibration
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    options: DataOptions,
}

fn strength(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("expected a number from 0 to 1".to_owned()),
    }
}

/// The parts of a model that process frames.
struct Parts {
    encoder: Box<dyn Encoder>,
    world: Option<WorldModel>,
    decoder: Option<Box<dyn Decoder>>,
}

/// Frames one model step apart.
struct Sample {
    /// (N, H, W, 3), in 0..1.
    pictures: Tensor,
    /// (N, A): motion after each frame; `None` for a model without prediction.
    actions: Option<Tensor>,
}

/// Outputs of the parts for a sample.
struct Outputs {
    latents: Tensor,
    predicted: Option<Tensor>,
    pictures: Option<Tensor>,
}

impl CalibrateArgs {
    /// Runs the command.
    ///
    /// # Errors
    /// Names the unusable file.
    pub fn run(&self) -> Result<()> {
        let folder = Path::new(&self.model);
        let path = folder.join(FILE);
        ensure!(
            self.overwrite || !path.exists(),
            "{} exists; replace it with --overwrite",
            path.display()
        );
        let recorded = self.open()?.recorded();
        let exact = Parts::load(&recorded)?;
        let samples = self.samples(&exact)?;
        // Every other sample is for measuring.
        let known: Vec<&Sample> = samples.iter().step_by(2).collect();
        let mut frames = 0;
        for sample in known {
            exact.run(sample, None)?;
            frames += sample.pictures.dim(0)?;
        }
        let calibration = recorded.calibration(Origin {
            bags: self.bags.iter().map(|bag| name(bag)).collect(),
            frames,
            strength: self.strength,
        })?;
        calibration.write(folder)?;
        let matrices: Vec<String> = calibration
            .matrices()
            .map(|(part, count)| format!("{part} {count}"))
            .collect();
        println!(
            "{}: {frames} frames; matrices: {}",
            path.display(),
            matrices.join(", ")
        );

        let others: Vec<&Sample> = samples.iter().skip(1).step_by(2).collect();
        if others.is_empty() {
            println!("the bags are too short to measure the error of int8");
            return Ok(());
        }
        let expected = others.iter().map(|sample| exact.run(sample, None));
        let expected: Vec<Outputs> = expected.collect::<Result<_>>()?;
        let count = others.len() * others.first().map_or(0, |s| s.pictures.dims()[0]);
        println!("\nrelative error of int8 against f32 on {count} other frames:\n");
        println!("| | latents | predicted | pictures |\n|---|---|---|---|");
        for (what, calibration) in [("not calibrated", None), ("calibrated", Some(calibration))] {
            let errors = self.errors(calibration, &others, &expected)?;
            let cells = errors.map(|error| match error {
                Some(error) => format!("{error:.4}"),
                None => "-".to_owned(),
            });
            println!("| {what} | {} |", cells.join(" | "));
        }
        Ok(())
    }

    fn open(&self) -> Result<DescribedFolder> {
        let model = ModelFolder::open(&self.model)?;
        model.into_described().with_context(|| {
            format!(
                "{}: its encoder is an autoencoder, which computes in f32; int8 is for published networks",
                self.model
            )
        })
    }

    /// Up to twice the requested number of frames, in evenly spread samples.
    fn samples(&self, model: &Parts) -> Result<Vec<Sample>> {
        let cache = tempfile::tempdir()?;
        let framing = model.encoder.framing();
        let dataset = Dataset::held_out(&self.bags, framing, cache.path(), &self.options)?;
        let requested = self.frames as usize * 2;
        let Some(world) = &model.world else {
            let episodes = dataset.episodes().iter();
            let count: usize = episodes.map(|episode| episode.frame_count).sum();
            let (height, width) = framing.size;
            let indices = (0..count).step_by(count.div_ceil(requested).max(1));
            let samples = indices.map(|index| {
                let mut values = Vec::new();
                dataset.read(index, &mut values)?;
                let shape = (1, height, width, 3);
                Ok(Sample {
                    pictures: Tensor::from_vec(values, shape, &candle_core::Device::Cpu)?,
                    actions: None,
                })
            });
            return samples.collect();
        };
        (world.encoding.space()).expect_same(dataset.action_space(), "the model", "the bags")?;
        let clip = CONTEXT + PREDICTED;
        let source = ClipSource::new(&dataset, &world.encoding, clip)?;
        let clips = source.all();
        let step = clips.len().div_ceil(requested.div_ceil(clip)).max(1);
        let samples = clips.into_iter().step_by(step).map(|clip| {
            let (pictures, actions) = source.tensors(&[clip])?;
            Ok(Sample {
                pictures: pictures.squeeze(0)?,
                actions: Some(actions.squeeze(0)?),
            })
        });
        samples.collect()
    }

    /// Error of int8 against `expected`: of latents, of predictions from the same latents, and of pictures of the same
    /// predictions.
    fn errors(
        &self,
        calibration: Option<Calibration>,
        samples: &[&Sample],
        expected: &[Outputs],
    ) -> Result<[Option<f64>; 3]> {
        let parts = Parts::load(&self.open()?.quantised(calibration))?;
        let mut errors = [RelativeError::default(); 3];
        for (sample, expected) in samples.iter().zip(expected) {
            let found = parts.run(sample, Some(expected))?;
            errors[0].add(Some(&found.latents), Some(&expected.latents))?;
            errors[1].add(found.predicted.as_ref(), expected.predicted.as_ref())?;
            errors[2].add(found.pictures.as_ref(), expected.pictures.as_ref())?;
        }
        Ok(errors.map(RelativeError::of_norm))
    }
}

/// A bag's name without its folders, which may be private.
fn name(bag: &Path) -> String {
    let absolute = std::path::absolute(bag).ok();
    let name = absolute.as_deref().and_then(Path::file_name);
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

impl Parts {
    fn load(folder: &DescribedFolder) -> Result<Self> {
        let compute = Compute::default();
        Ok(Self {
            encoder: folder.encoder(&compute)?,
            world: match folder.has_transition() {
                true => Some(folder.world_model(&compute)?),
                false => None,
            },
            decoder: folder.decoder(&compute)?,
        })
    }

    /// Runs all parts; predicts and decodes from the outputs of `given`, if given.
    fn run(&self, sample: &Sample, given: Option<&Outputs>) -> Result<Outputs> {
        let count = sample.pictures.dim(0)?;
        // One frame at a time, as in the nodes.
        let latents = (0..count).map(|at| {
            Ok(self
                .encoder
                .encode(&sample.pictures.narrow(0, at, 1)?.contiguous()?)?)
        });
        let latents = Tensor::cat(&latents.collect::<Result<Vec<_>>>()?, 0)?;
        let observed = given.map_or(&latents, |given| &given.latents);
        let predicted = match (&self.world, &sample.actions) {
            (Some(world), Some(actions)) => {
                let sampler = &world.transition.config().sampler;
                Some(predict(world, sampler, (observed, actions), SEED)?)
            }
            _ => None,
        };
        let to_decode = match given {
            Some(given) => given.predicted.as_ref().unwrap_or(&given.latents),
            None => predicted.as_ref().unwrap_or(&latents),
        };
        let decode = |decoder: &dyn Decoder| -> Result<Tensor> {
            let pictures = (0..to_decode.dim(0)?)
                .map(|at| Ok(decoder.decode(&to_decode.narrow(0, at, 1)?.contiguous()?)?));
            Ok(Tensor::cat(&pictures.collect::<Result<Vec<_>>>()?, 0)?)
        };
        let pictures = self.decoder.as_deref().map(decode).transpose()?;
        Ok(Outputs {
            latents,
            predicted,
            pictures,
        })
    }
}

/// Sums of squares.
#[derive(Clone, Copy, Default)]
struct RelativeError {
    difference: f64,
    expected: f64,
}

impl RelativeError {
    fn add(&mut self, found: Option<&Tensor>, expected: Option<&Tensor>) -> Result<()> {
        let (Some(found), Some(expected)) = (found, expected) else {
            return Ok(());
        };
        let values = |x: &Tensor| x.flatten_all()?.to_vec1::<f32>();
        for (found, expected) in values(found)?.into_iter().zip(values(expected)?) {
            self.difference += (f64::from(found) - f64::from(expected)).powi(2);
            self.expected += f64::from(expected).powi(2);
        }
        Ok(())
    }

    /// Norm of the difference over the expected norm, if anything was added.
    fn of_norm(self) -> Option<f64> {
        (self.expected > 0.0).then(|| (self.difference / self.expected).sqrt())
    }
}
