//! Weights of latent cells in the objective.

use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use wm_dataset::{Clip, ClipSource, Dataset, FIRST_OBJECT};

/// Weights by the masks of the frames: a cell that shows nothing but objects counts `1 + further` times, one without
/// objects once. Objects are small and mostly at rest, so that without weights a model loses those that move.
#[derive(Debug)]
pub(crate) struct ObjectWeights<'a> {
    dataset: &'a Dataset,
    further: f64,
}

impl<'a> ObjectWeights<'a> {
    /// `None` if objects count no more than anything else.
    ///
    /// # Errors
    /// If they do, but the data have no masks.
    pub(super) fn new(dataset: Option<&'a Dataset>, further: f64) -> Result<Option<Self>> {
        if further == 0.0 {
            return Ok(None);
        }
        let with_masks =
            dataset.filter(|data| (0..data.frame_count()).any(|i| data.mask(i).is_some()));
        ensure!(
            with_masks.is_some(),
            "objective.object_weight is {further}, but the data have no masks of objects (/camera/mask/compressed)"
        );
        Ok(with_masks.map(|dataset| Self { dataset, further }))
    }

    /// Weights (B, n, h, w, 1) of the cells of `drawn` clips; 1 for frames without a mask.
    pub(super) fn of(
        &self,
        clips: &ClipSource<'_>,
        drawn: &[Clip],
        device: &Device,
    ) -> Result<Tensor> {
        let (h, w, _) = clips.shape();
        let skip = clips.encoding().frame_skip();
        let mut weights = Vec::new();
        for clip in drawn {
            let first = clips.first_frame(*clip);
            for frame in (0..clips.frames()).map(|i| first + i * skip) {
                let shares = match self.dataset.mask(frame) {
                    Some(mask) => object_shares(mask, self.dataset.size(), (h, w)),
                    None => vec![0.0; h * w],
                };
                weights.extend(
                    shares
                        .iter()
                        .map(|share| (1.0 + self.further * share) as f32),
                );
            }
        }
        let shape = (drawn.len(), clips.frames(), h, w, 1);
        Ok(Tensor::from_vec(weights, shape, device)?)
    }
}

/// The share of objects in each cell of a grid of (rows, columns) over a mask of (height, width).
fn object_shares(
    mask: &[u8],
    (height, width): (usize, usize),
    (rows, columns): (usize, usize),
) -> Vec<f64> {
    let mut objects = vec![0_usize; rows * columns];
    let mut all = objects.clone();
    for (y, row) in mask.chunks(width.max(1)).take(height).enumerate() {
        for (x, value) in row.iter().enumerate() {
            let cell = y * rows / height * columns + x * columns / width;
            if let (Some(objects), Some(all)) = (objects.get_mut(cell), all.get_mut(cell)) {
                *objects += usize::from(*value >= FIRST_OBJECT);
                *all += 1;
            }
        }
    }
    let cells = objects.iter().zip(all);
    cells
        .map(|(objects, all)| *objects as f64 / all.max(1) as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        autoencoder,
        transition::tests::{encoding, moving},
    };

    #[test]
    fn shares_are_those_of_each_cell() {
        // The gripper is no object.
        #[rustfmt::skip]
        let mask = [
            2, 2, 0, 1,
            2, 3, 0, 5,
            0, 0, 0, 0,
            1, 1, 0, 0,
        ];
        assert_eq!(object_shares(&mask, (4, 4), (2, 2)), [1.0, 0.25, 0.0, 0.0]);
        assert_eq!(object_shares(&mask, (4, 4), (1, 2)), [0.5, 0.125]);
    }

    #[test]
    fn weights_are_those_of_the_clips_frames() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = autoencoder::tests::dataset(dir.path(), true);
        let objects = ObjectWeights::new(Some(&dataset), 3.0).unwrap().unwrap();
        let (latents, encoding) = (moving(dir.path(), 1, 0), encoding());
        let clips = ClipSource::new(&latents, &encoding, 2).unwrap();
        let weights = objects
            .of(&clips, &[Clip::new(0, 2)], &Device::Cpu)
            .unwrap();
        assert_eq!(weights.dims(), [1, 2, 4, 4, 1]);
        let weights = weights.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        // The square of frame 2 covers x = 3 to 7 and y = 4 to 8 of 16 x 16 pixels, that of frame 3 is a pixel further.
        let expected = |rows: [[f32; 4]; 4]| {
            rows.concat()
                .into_iter()
                .map(|pixels| 1.0 + 3.0 * pixels / 16.0)
        };
        let (none, second) = (
            [0.0; 4],
            expected([
                [0.0; 4],
                [0.0, 16.0, 4.0, 0.0],
                [0.0, 4.0, 1.0, 0.0],
                [0.0; 4],
            ]),
        );
        let first = expected([none, [4.0, 16.0, 0.0, 0.0], [1.0, 4.0, 0.0, 0.0], none]);
        assert_eq!(weights, first.chain(second).collect::<Vec<_>>());
    }

    #[test]
    fn weights_need_masks() {
        assert!(ObjectWeights::new(None, 0.0).unwrap().is_none());
        let error = ObjectWeights::new(None, 4.0).unwrap_err().to_string();
        assert!(error.contains("object_weight is 4"), "{error}");
    }
}
