//! A model of any kind, loaded once and run on any number of inputs.

use candle_core::{Device, Tensor};
use serde::de::DeserializeOwned;
use wm_model::Compute;

use super::inputs::Inputs;
use super::{DitConfig, Kind, Tensors, finite, owned, parse};
use crate::checkpoint::Average;
use crate::efficientnet_lite0::{EfficientNetLite0, EfficientNetLite0Config};
use crate::idm::Idm;
use crate::pooled_probe::{LinearProbe, ProgressProbe, TemporalProbe};
use crate::success_probe::SuccessProbe;
use crate::svae::Svae;
use crate::vae::{CosmosDecoder, PixelDecoder, SdVaeDecoder, VaVaeDecoder};
use crate::vit::SiglipText;
use crate::{Checkpoint, Loader, Result};

/// First of EfficientNet-Lite0's blocks that is given.
const FIRST_BLOCK: usize = 8;

/// The outputs of a loaded model.
type Run = Box<dyn Fn(&Inputs<'_>) -> Result<Tensors> + Send + Sync>;

/// A model of some [`Kind`]; the [module](super) says what each takes and gives.
pub struct Loaded {
    kind: Kind,
    device: Device,
    run: Run,
}

impl Loaded {
    /// Loads a model of `kind` with the configuration `config` (JSON) and the weights of `checkpoint` (the averaged
    /// ones, if it has both), which go to the device of `compute`, rounded to its number format.
    ///
    /// # Errors
    /// If the configuration is not valid, or the checkpoint's tensors are not the model's.
    pub fn new(
        kind: Kind,
        config: &str,
        checkpoint: &Checkpoint,
        compute: &Compute,
    ) -> Result<Self> {
        let checkpoint = kind.weights(checkpoint, Average::Ema);
        let source = Source {
            config,
            loader: Loader::new(&checkpoint, compute)?,
        };
        let run: Run = match kind {
            Kind::Dit => {
                let config: DitConfig = parse(config)?;
                let model = config.load(&checkpoint, compute)?;
                Box::new(move |inputs: &Inputs<'_>| {
                    let (x, tau) = (inputs.float("x")?, inputs.unit("tau")?);
                    let velocity = model.forward(&x, &tau, &inputs.float("action")?)?;
                    Ok(owned(vec![("velocity", velocity)]))
                })
            }
            Kind::Siglip2Text => {
                let model = source.load(SiglipText::load)?;
                Box::new(move |inputs: &Inputs<'_>| {
                    let mask = inputs.optional_float("text_mask")?;
                    let features = model.forward(&inputs.integers("input_ids")?, mask.as_ref())?;
                    Ok(owned(vec![("features", features)]))
                })
            }
            Kind::Sd3VaeDecoder => decoder(source.load(SdVaeDecoder::load)?, SdVaeDecoder::decode),
            Kind::VaVaeDecoder => decoder(source.load(VaVaeDecoder::load)?, VaVaeDecoder::decode),
            Kind::CosmosCi16x16Decoder => {
                decoder(source.load(CosmosDecoder::load)?, CosmosDecoder::decode)
            }
            Kind::Svae => {
                let model = source.load(Svae::load)?;
                Box::new(move |inputs: &Inputs<'_>| {
                    Ok(owned(match inputs.optional_float("features")? {
                        Some(features) => {
                            let latent = model.encode(&features)?;
                            let features = model.decode(&latent)?;
                            vec![("latent", latent), ("features", features)]
                        }
                        None => vec![("features", model.decode(&inputs.float("latent")?)?)],
                    }))
                })
            }
            Kind::Pixel => decoder(source.load(PixelDecoder::load)?, PixelDecoder::decode),
            Kind::Idm => mapped(
                ["latents", "actions"],
                source.load(Idm::load)?,
                Idm::forward,
            ),
            Kind::SuccessProbe => {
                let model = source.load(SuccessProbe::load)?;
                Box::new(move |inputs: &Inputs<'_>| {
                    let (latents, text) = (inputs.float("latents")?, inputs.float("text")?);
                    let mask = inputs.optional_float("text_mask")?;
                    let logit = model.forward(&latents, &text, mask.as_ref())?;
                    Ok(owned(vec![("logit", logit)]))
                })
            }
            Kind::LinearProbe => {
                let probe = source.load(LinearProbe::load)?;
                mapped(["latents", "logit"], probe, LinearProbe::forward)
            }
            Kind::TemporalProbe => {
                let probe = source.load(TemporalProbe::load)?;
                mapped(["latents", "logit"], probe, TemporalProbe::forward)
            }
            Kind::ProgressProbe => {
                let probe = source.load(ProgressProbe::load)?;
                mapped(["latents", "progress"], probe, ProgressProbe::forward)
            }
            Kind::EfficientNetLite0 => efficientnet_lite0(&source)?,
            kind => {
                let network = kind.encoder(config)?.load(&source.loader)?;
                source.loader.finish()?;
                Box::new(move |inputs: &Inputs<'_>| {
                    let latent = network(&inputs.float("image")?)?;
                    Ok(owned(vec![("latent", latent)]))
                })
            }
        };
        Ok(Self {
            kind,
            device: compute.device()?.clone(),
            run,
        })
    }

    /// Runs it on `inputs`, which go to its device; the outputs are on the CPU.
    ///
    /// # Errors
    /// If an input is missing, empty, not finite or of another shape, or an output would not be finite.
    pub fn run(&self, inputs: &Tensors) -> Result<Tensors> {
        finite((self.run)(&Inputs::new(
            self.kind.name(),
            inputs,
            &self.device,
        ))?)
    }
}

fn decoder<M: Send + Sync + 'static>(model: M, decode: fn(&M, &Tensor) -> Result<Tensor>) -> Run {
    mapped(["latent", "image"], model, decode)
}

/// A model with one input and one output, of these names.
fn mapped<M: Send + Sync + 'static>(
    [input, output]: [&'static str; 2],
    model: M,
    map: fn(&M, &Tensor) -> Result<Tensor>,
) -> Run {
    Box::new(move |inputs| Ok(owned(vec![(output, map(&model, &inputs.float(input)?)?)])))
}

/// Every block from [`FIRST_BLOCK`] to the configured one, each by a network up to there: it is small.
fn efficientnet_lite0(source: &Source<'_>) -> Result<Run> {
    let config: EfficientNetLite0Config = parse(source.config)?;
    // The last one first: it asks for all tensors there are to be. One that is too low is refused by the network.
    let models = (FIRST_BLOCK.min(config.block)..=config.block)
        .rev()
        .map(|block| {
            let model =
                EfficientNetLite0::load(&EfficientNetLite0Config { block }, &source.loader)?;
            source.loader.finish()?;
            Ok((format!("block_{block}"), model))
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(Box::new(move |inputs| {
        let image = inputs.float("image")?;
        let encode =
            |(name, model): &(String, EfficientNetLite0)| Ok((name.clone(), model.encode(&image)?));
        models.iter().map(encode).collect()
    }))
}

/// A model's configuration and its weights.
struct Source<'a> {
    config: &'a str,
    loader: Loader<'a>,
}

impl Source<'_> {
    /// Loads a model, and checks that the tensors are its.
    fn load<C: DeserializeOwned, M>(
        &self,
        load: impl FnOnce(&C, &Loader<'_>) -> Result<M>,
    ) -> Result<M> {
        let model = load(&parse(self.config)?, &self.loader)?;
        self.loader.finish()?;
        Ok(model)
    }
}
