//! The autoencoder on tensor operations: for other devices than the CPU.

use candle_core::{Device, Tensor};

use super::network::TensorNetwork;
use super::{Autoencoder, Normalisation, clamp, values};
use crate::{Decoder, Encoder, Framing, LatentSpace, Result};

/// An encoder and the decoder that belongs to it, for inference where their tensors are. Pictures and latents are given
/// and taken on the CPU.
#[derive(Clone, Debug)]
pub struct TensorAutoencoder {
    device: Device,
    encoder: TensorNetwork,
    decoder: TensorNetwork,
    normalisation: Normalisation,
    framing: Framing,
    space: LatentSpace,
}

impl TensorAutoencoder {
    /// The networks of `autoencoder`, on `device`.
    ///
    /// # Errors
    /// If the device has no memory for them.
    pub fn new(autoencoder: &Autoencoder, device: &Device) -> Result<Self> {
        Ok(Self {
            device: device.clone(),
            encoder: TensorNetwork::new(&autoencoder.encoder, device)?,
            decoder: TensorNetwork::new(&autoencoder.decoder, device)?,
            normalisation: autoencoder.normalisation.clone(),
            framing: autoencoder.config.framing(),
            space: autoencoder.space.clone(),
        })
    }

    /// What a network makes of `input` (N, height, width, channels): the values.
    fn run(&self, network: &TensorNetwork, input: Vec<f32>, shape: &[usize]) -> Result<Vec<f32>> {
        let input = Tensor::from_vec(input, shape, &self.device)?;
        let output = network.forward(&input)?.to_device(&Device::Cpu)?;
        Ok(output.flatten_all()?.to_vec1()?)
    }
}

impl Encoder for TensorAutoencoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn input_size(&self) -> (usize, usize) {
        self.framing.size
    }

    fn framing(&self) -> Framing {
        self.framing
    }

    fn encode(&self, images: &Tensor) -> Result<Tensor> {
        let (height, width) = self.framing.size;
        let (input, _) = values("images", images, (height, width, 3))?;
        let mut latents = self.run(&self.encoder, input, images.dims())?;
        self.normalisation.apply(&mut latents);
        let (h, w, c) = self.space.shape();
        Ok(Tensor::from_vec(latents, ((), h, w, c), &Device::Cpu)?)
    }
}

impl Decoder for TensorAutoencoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn output_size(&self) -> (usize, usize) {
        self.framing.size
    }

    fn decode(&self, latents: &Tensor) -> Result<Tensor> {
        let (mut input, _) = values("latents", latents, self.space.shape())?;
        self.normalisation.undo(&mut input);
        for v in &mut input {
            *v = clamp(*v);
        }
        let mut images = self.run(&self.decoder, input, latents.dims())?;
        for v in &mut images {
            *v = v.clamp(0.0, 1.0);
        }
        let (height, width) = self.framing.size;
        Ok(Tensor::from_vec(
            images,
            ((), height, width, 3),
            &Device::Cpu,
        )?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AutoencoderConfig;

    /// With a branch and without, several pictures at once.
    #[test]
    fn it_is_what_the_kernels_compute() {
        for branch in [false, true] {
            let config = AutoencoderConfig {
                branch,
                height: 32,
                width: 64,
                ..AutoencoderConfig::tiny()
            };
            let kernels = Autoencoder::random(config, 3).unwrap();
            let tensors = TensorAutoencoder::new(&kernels, &Device::Cpu).unwrap();
            assert_eq!(Encoder::space(&tensors), kernels.space());
            let images = Tensor::rand(0f32, 1.0, (2, 32, 64, 3), &Device::Cpu).unwrap();
            let latents = kernels.encode(&images).unwrap();
            check(&tensors.encode(&images).unwrap(), &latents);
            check(
                &tensors.decode(&latents).unwrap(),
                &kernels.decode(&latents).unwrap(),
            );
            let wrong = images.narrow(1, 0, 16).unwrap();
            let message = tensors.encode(&wrong).unwrap_err().to_string();
            assert!(message.contains("(N, 32, 64, 3)"), "{message}");
        }
    }

    fn check(found: &Tensor, expected: &Tensor) {
        assert_eq!(found.dims(), expected.dims());
        let most = |x: &Tensor| -> f32 {
            let most = x.abs().unwrap().max_all().unwrap();
            most.to_scalar().unwrap()
        };
        let difference = most(&(found - expected).unwrap());
        assert!(difference < 1e-5 * most(expected).max(1.0), "{difference}");
    }
}
