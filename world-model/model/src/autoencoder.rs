//! A convolutional autoencoder of the TAESD family: frames to latents and back.

mod config;
mod network;
mod normalisation;

pub use config::AutoencoderConfig;
pub use network::Network;
pub use normalisation::{MEAN, Normalisation, STD};

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use crate::ops::GridSize;
use crate::weights::{Precision, WeightsBuilder, hex};
use crate::{Decoder, Encoder, Error, Framing, LatentSpace, Result, Weights};

/// Height and width at which the published halves are used.
const TAEF2_SIZE: (usize, usize) = (256, 256);
/// Metadata entry with the configuration as JSON.
const CONFIG: &str = "config";
/// Metadata entry with the hash of the latent space.
const SPACE_HASH: &str = "latent_space";

/// An encoder and the decoder that belongs to it.
#[derive(Clone, Debug)]
pub struct Autoencoder {
    config: AutoencoderConfig,
    encoder: Network,
    decoder: Network,
    normalisation: Normalisation,
    space: LatentSpace,
}

impl Autoencoder {
    /// Name of the weights in a folder.
    pub const FILE: &str = "autoencoder.safetensors";
    /// Names of TAEF2's published halves in a folder, the encoder first.
    pub const TAEF2_FILES: [&str; 2] = ["taef2_encoder.safetensors", "taef2_decoder.safetensors"];

    /// Opens a file that [`Autoencoder::save`] wrote, or a folder: of such a file called
    /// `autoencoder.safetensors`, or else of the published `taef2_encoder.safetensors` and
    /// `taef2_decoder.safetensors`, which are then used at 256x256.
    ///
    /// # Errors
    /// If a file cannot be read, or anything in it is missing, misshapen or too much.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        if !path.is_dir() {
            return Self::from_weights(Weights::open(path)?);
        }
        let [encoder, decoder] = Self::TAEF2_FILES.map(|name| path.join(name));
        let whole = path.join(Self::FILE);
        if !whole.exists() && encoder.exists() {
            return Self::from_taef2(Weights::open(encoder)?, Weights::open(decoder)?, TAEF2_SIZE);
        }
        Self::from_weights(Weights::open(whole)?)
    }

    /// Reads both halves, the normalisation and the configuration from one file.
    ///
    /// # Errors
    /// If anything in the file is missing, misshapen or too much, or the latent space that the file
    /// states is not the one that it holds.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        let config: AutoencoderConfig = weights.json(CONFIG)?;
        config.validate()?;
        let encoder = Network::load(&config.encoder_stages(), &weights, "encoder.")?;
        let decoder = Network::load(&config.decoder_stages(), &weights, "decoder.")?;
        let normalisation = Normalisation::load(&weights, config.latent_channels)?;
        let autoencoder = Self::assemble(config, encoder, decoder, normalisation);
        if let Some(expected) = weights.metadata(SPACE_HASH)
            && expected != autoencoder.space.hash
        {
            return Err(Error::WrongHash {
                file: weights.file().to_owned(),
                what: "the hash of the latent space",
                expected: expected.to_owned(),
                found: autoencoder.space.hash,
            });
        }
        weights.finish()?;
        Ok(autoencoder)
    }

    /// Reads the published TAEF2 encoder and decoder, for images of `size` (height, width).
    ///
    /// Each file may hold `latent_mean` and `latent_std`, of which the encoder's count; without
    /// them the latents stay as they are.
    ///
    /// # Errors
    /// If a file cannot be read, or anything in it is missing, misshapen or too much.
    pub fn from_taef2(encoder: Weights, decoder: Weights, size: (usize, usize)) -> Result<Self> {
        let config = AutoencoderConfig::taef2(size.0, size.1);
        config.validate()?;
        let encoder_half = Network::load(&config.encoder_stages(), &encoder, "")?;
        let decoder_half = Network::load(&config.decoder_stages(), &decoder, "")?;
        let normalisation = if encoder.contains(normalisation::MEAN) {
            Normalisation::load(&encoder, config.latent_channels)?
        } else {
            Normalisation::identity(config.latent_channels)
        };
        encoder.finish()?;
        decoder.finish()?;
        Ok(Self::assemble(
            config,
            encoder_half,
            decoder_half,
            normalisation,
        ))
    }

    /// Random weights with which training starts; equal seeds give equal weights.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub fn random(config: AutoencoderConfig, seed: u64) -> Result<Self> {
        config.validate()?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let encoder = Network::random(&config.encoder_stages(), &mut rng)?;
        let decoder = Network::random(&config.decoder_stages(), &mut rng)?;
        let normalisation = Normalisation::identity(config.latent_channels);
        Ok(Self::assemble(config, encoder, decoder, normalisation))
    }

    fn assemble(
        config: AutoencoderConfig,
        encoder: Network,
        decoder: Network,
        normalisation: Normalisation,
    ) -> Self {
        let space = space(&config, &encoder, &normalisation);
        Self {
            config,
            encoder,
            decoder,
            normalisation,
            space,
        }
    }

    /// The same networks with another normalisation, which makes another latent space.
    ///
    /// # Errors
    /// If it does not have one mean and one positive standard deviation a channel.
    pub fn with_normalisation(self, normalisation: Normalisation) -> Result<Self> {
        normalisation.check(self.config.latent_channels)?;
        Ok(Self::assemble(
            self.config,
            self.encoder,
            self.decoder,
            normalisation,
        ))
    }

    /// The same, computed by candle's operations on `device`. Images and latents come from the CPU, and go back there.
    ///
    /// # Errors
    /// If the device has no memory for the weights.
    pub fn on_tensors(mut self, device: &Device) -> Result<Self> {
        self.encoder.place_on(device)?;
        self.decoder.place_on(device)?;
        Ok(self)
    }

    /// The same with all weights rounded to what `precision` can hold, as they are after saving with
    /// it.
    #[must_use]
    pub fn rounded(mut self, precision: Precision) -> Self {
        self.encoder.round(precision);
        self.decoder.round(precision);
        Self::assemble(self.config, self.encoder, self.decoder, self.normalisation)
    }

    /// Shape of the networks.
    pub fn config(&self) -> &AutoencoderConfig {
        &self.config
    }

    /// The latent space.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// The encoder's network, whose output is not yet normalised.
    pub fn encoder(&self) -> &Network {
        &self.encoder
    }

    /// The decoder's network, whose input is the clamped, not normalised latent.
    pub fn decoder(&self) -> &Network {
        &self.decoder
    }

    /// Both networks, encoder first, to change their weights. The latent space keeps its hash until
    /// [`Autoencoder::with_normalisation`] or [`Autoencoder::save`].
    pub fn networks_mut(&mut self) -> (&mut Network, &mut Network) {
        (&mut self.encoder, &mut self.decoder)
    }

    /// Writes both halves, the normalisation and the configuration to one file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: impl AsRef<Path>, precision: Precision) -> Result<()> {
        self.to_builder(precision).write(path)
    }

    fn to_builder(&self, precision: Precision) -> WeightsBuilder {
        let mut builder = WeightsBuilder::new();
        // The hash is of the weights as they will be read again.
        let mut rounded = self.clone();
        rounded.encoder.round(precision);
        let space = space(&self.config, &rounded.encoder, &self.normalisation);
        self.encoder.store(&mut builder, "encoder.", precision);
        self.decoder.store(&mut builder, "decoder.", precision);
        self.normalisation.store(&mut builder);
        builder.metadata(CONFIG, serde_json::json!(self.config).to_string());
        builder.metadata(SPACE_HASH, space.hash);
        builder
    }

    /// Encodes images to latents that are not normalised; any size that the levels divide is taken.
    fn encode_raw(&self, images: &Tensor) -> Result<Vec<f32>> {
        let (height, width) = (self.config.height, self.config.width);
        let (values, grid) = values("images", images, (height, width, 3))?;
        self.encoder.run(values, grid)
    }
}

impl Encoder for Autoencoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn input_size(&self) -> (usize, usize) {
        (self.config.height, self.config.width)
    }

    fn framing(&self) -> Framing {
        self.config.framing()
    }

    fn encode(&self, images: &Tensor) -> Result<Tensor> {
        let mut latents = self.encode_raw(images)?;
        self.normalisation.apply(&mut latents);
        let (h, w, c) = self.space.shape();
        Ok(Tensor::from_vec(latents, ((), h, w, c), &Device::Cpu)?)
    }
}

impl Decoder for Autoencoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn output_size(&self) -> (usize, usize) {
        (self.config.height, self.config.width)
    }

    fn decode(&self, latents: &Tensor) -> Result<Tensor> {
        let (mut values, grid) = values("latents", latents, self.space.shape())?;
        self.normalisation.undo(&mut values);
        for v in &mut values {
            *v = clamp(*v);
        }
        let mut images = self.decoder.run(values, grid)?;
        for v in &mut images {
            *v = v.clamp(0.0, 1.0);
        }
        let shape = ((), self.config.height, self.config.width, 3);
        Ok(Tensor::from_vec(images, shape, &Device::Cpu)?)
    }
}

/// The soft clamp with which every decoder begins.
pub fn clamp(v: f32) -> f32 {
    3.0 * (v / 3.0).tanh()
}

/// The derivative of [`clamp`] where its result is `clamped`.
pub fn clamp_slope(clamped: f32) -> f32 {
    1.0 - (clamped / 3.0).powi(2)
}

/// The values of a batch of (height, width, channels), checked.
fn values(
    what: &'static str,
    tensor: &Tensor,
    (height, width, channels): (usize, usize, usize),
) -> Result<(Vec<f32>, GridSize)> {
    let &[images, h, w, c] = tensor.dims() else {
        return Err(shape_error(what, tensor, (height, width, channels)));
    };
    if (h, w, c) != (height, width, channels) {
        return Err(shape_error(what, tensor, (height, width, channels)));
    }
    let values = tensor
        .to_dtype(DType::F32)?
        .flatten_all()?
        .to_vec1::<f32>()?;
    if values.iter().any(|v| !v.is_finite()) {
        return Err(Error::NotFinite { what });
    }
    let grid = GridSize {
        images,
        height,
        width,
    };
    Ok((values, grid))
}

fn shape_error(what: &'static str, tensor: &Tensor, (h, w, c): (usize, usize, usize)) -> Error {
    Error::Shape {
        what,
        expected: format!("(N, {h}, {w}, {c})"),
        found: tensor.dims().to_vec(),
    }
}

fn space(
    config: &AutoencoderConfig,
    encoder: &Network,
    normalisation: &Normalisation,
) -> LatentSpace {
    let (height, width) = config.grid();
    let mut hash = Sha256::new();
    hash.update(format!("{height}x{width}x{}\n", config.latent_channels));
    encoder.hash(&mut hash);
    normalisation.add_to(&mut hash);
    if !config.fit.is_stretch() {
        hash.update(format!("{}\n", config.fit));
    }
    LatentSpace {
        name: config.name.clone(),
        hash: hex(hash),
        height,
        width,
        channels: config.latent_channels,
    }
}

#[cfg(test)]
mod tests;
