//! Scores of pictures, and distances of two.

use image::RgbImage;

use crate::onnx::batches::Batches;
use crate::onnx::features::other;
use crate::onnx::{Network, Result, Role, Tensor};

/// A network for scores of pictures: `musiq` or `aesthetic`.
#[derive(Debug)]
pub struct Scores {
    network: Network,
    output: usize,
    range: [f32; 2],
}

/// Score of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// On the network's own scale.
    pub raw: f32,
    /// With `score_range` mapped to 0 and 1, and clipped, since networks may exceed their scale.
    pub normalised: f32,
}

/// A network for the perceptual distance of two pictures: `lpips`.
#[derive(Debug)]
pub struct Distance {
    network: Network,
    output: usize,
}

impl Scores {
    pub(crate) fn new(network: Network) -> Result<Self> {
        let range = network.spec().score_range;
        let Some(range) = range.filter(|_| matches!(network.role(), Role::Musiq | Role::Aesthetic))
        else {
            return Err(other(&network, "scores"));
        };
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(1, "pictures")?;
        Ok(Self {
            network,
            output,
            range,
        })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// One score per picture, in order.
    pub fn of(&self, pictures: &[RgbImage]) -> Result<Vec<Score>> {
        let network = &self.network;
        let [worst, best] = self.range;
        let mut scores = Vec::with_capacity(pictures.len());
        for batch in Batches::new(pictures, network.batch()) {
            let prepared: Vec<_> = batch
                .iter()
                .map(|picture| network.prepare(picture))
                .collect::<Result<_>>()?;
            let outputs = network.run(&[network.arrange(&prepared, None)?])?;
            let raw = numbers(network, &outputs, self.output, batch.len())?;
            scores.extend(raw.iter().take(batch.given()).map(|&raw| Score {
                raw,
                normalised: ((raw - worst) / (best - worst)).clamp(0.0, 1.0),
            }));
        }
        Ok(scores)
    }
}

impl Distance {
    pub(crate) fn new(network: Network) -> Result<Self> {
        if network.role() != Role::Lpips {
            return Err(other(&network, "distances"));
        }
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(2, "two pictures")?;
        Ok(Self { network, output })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// One distance per pair, in order. Both pictures of a pair must have one size.
    pub fn between(&self, pairs: &[(&RgbImage, &RgbImage)]) -> Result<Vec<f32>> {
        let network = &self.network;
        let mut distances = Vec::with_capacity(pairs.len());
        for batch in Batches::new(pairs, network.batch()) {
            let (mut first, mut second) = (Vec::new(), Vec::new());
            for (one, other) in batch.iter() {
                same_size(network, one, other)?;
                first.push(network.prepare(one)?);
                second.push(network.prepare(other)?);
            }
            let inputs = [
                network.arrange(&first, None)?,
                network.arrange(&second, None)?,
            ];
            let outputs = network.run(&inputs)?;
            let numbers = numbers(network, &outputs, self.output, batch.len())?;
            distances.extend(numbers.iter().take(batch.given()));
        }
        Ok(distances)
    }
}

pub(crate) fn same_size(network: &Network, one: &RgbImage, other: &RgbImage) -> Result<()> {
    if one.dimensions() == other.dimensions() {
        return Ok(());
    }
    let text = |picture: &RgbImage| crate::onnx::input::text(crate::onnx::input::size_of(picture));
    Err(network.wrong("second picture (width x height)", text(one), text(other)))
}

/// `count` numbers: `[count]`, or with further axes of one element.
fn numbers<'a>(
    network: &Network,
    outputs: &'a [Tensor],
    index: usize,
    count: usize,
) -> Result<&'a [f32]> {
    let found = outputs.get(index);
    let shape = found.map_or(&[][..], Tensor::shape);
    match found {
        // A network for one picture may omit the batch axis.
        Some(tensor)
            if tensor.data().len() == count && (count == 1 || shape.first() == Some(&count)) =>
        {
            Ok(tensor.data())
        }
        _ => Err(network.shape_error(
            "output",
            format!("[{count}] or [{count}, 1]"),
            format!("{shape:?}"),
        )),
    }
}
