use rand::{Rng, seq::IteratorRandom as _};
use wm_dataset::{Dataset, Episode};

/// Frames of an episode in its median.
const MEDIAN_FRAMES: usize = 11;
/// Least sum of colour differences from the median of a moving pixel.
const MOVING: i32 = 48;

/// Finds salient pixels: inside a mask, or without masks, where a frame differs from the median frame of its episode.
pub(super) struct Salience<'a> {
    dataset: &'a Dataset,
    /// Median frame of each episode; empty with masks.
    medians: Vec<Vec<u8>>,
}

impl<'a> Salience<'a> {
    pub(super) fn new(dataset: &'a Dataset) -> Self {
        let medians = if dataset.mask(0).is_some() {
            Vec::new()
        } else {
            dataset
                .episodes()
                .iter()
                .map(|episode| median(dataset, episode))
                .collect()
        };
        Self { dataset, medians }
    }

    /// A salient pixel (row, column) of frame `frame` in episode `episode`; `None` if there is none.
    pub(super) fn pixel(
        &self,
        episode: usize,
        frame: usize,
        rng: &mut impl Rng,
    ) -> Option<(usize, usize)> {
        let index = match self.dataset.mask(frame) {
            Some(mask) => salient_in_mask(mask, rng),
            None => {
                let pixels = self.dataset.frame(frame)?.chunks_exact(3);
                pixels
                    .zip(self.medians.get(episode)?.chunks_exact(3))
                    .enumerate()
                    .filter(|(_, (pixel, median))| difference(pixel, median) > MOVING)
                    .map(|(index, _)| index)
                    .choose(rng)
            }
        }?;
        let width = self.dataset.size().1;
        Some((index / width, index % width))
    }
}

/// Chooses a class of the mask first, so that small things come as often as large ones, then a pixel of it.
fn salient_in_mask(mask: &[u8], rng: &mut impl Rng) -> Option<usize> {
    let mut seen = [false; 256];
    for class in mask {
        if let Some(seen) = seen.get_mut(usize::from(*class)) {
            *seen = true;
        }
    }
    let classes = seen.iter().enumerate().skip(1);
    let class = classes
        .filter(|(_, seen)| **seen)
        .map(|(class, _)| class)
        .choose(rng)?;
    let pixels = mask.iter().enumerate();
    pixels
        .filter(|(_, value)| usize::from(**value) == class)
        .map(|(index, _)| index)
        .choose(rng)
}

fn difference(pixel: &[u8], median: &[u8]) -> i32 {
    let channels = pixel.iter().zip(median);
    channels
        .map(|(a, b)| (i32::from(*a) - i32::from(*b)).abs())
        .sum()
}

fn median(dataset: &Dataset, episode: &Episode) -> Vec<u8> {
    let count = episode.frame_count.min(MEDIAN_FRAMES);
    let frames: Vec<&[u8]> = (0..count)
        .map(|i| episode.first_frame + i * episode.frame_count / count)
        .filter_map(|index| dataset.frame(index))
        .collect();
    let bytes = dataset.size().0 * dataset.size().1 * 3;
    let mut values = Vec::with_capacity(count);
    (0..bytes)
        .map(|at| {
            values.clear();
            values.extend(frames.iter().filter_map(|frame| frame.get(at)));
            values.sort_unstable();
            // Every episode has frames of this size.
            values.get(values.len() / 2).copied().unwrap_or_default()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::salient_in_mask;

    #[test]
    fn small_things_are_chosen_as_often_as_large_ones() {
        // 990 pixels of class 1, 10 of class 2, the rest background.
        let mask: Vec<u8> = (0..5000)
            .map(|i| if i < 990 { 1 } else { u8::from(i < 1000) * 2 })
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let picked: Vec<usize> = (0..400)
            .filter_map(|_| salient_in_mask(&mask, &mut rng))
            .collect();
        assert_eq!(picked.len(), 400);
        assert!(picked.iter().all(|i| *i < 1000));
        let small = picked.iter().filter(|i| **i >= 990).count();
        assert!((150..250).contains(&small), "{small}");
    }

    #[test]
    fn empty_mask_has_no_salient_pixel() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        assert_eq!(salient_in_mask(&[0; 100], &mut rng), None);
    }
}
