use rand::Rng;
use wm_dataset::Dataset;
use wm_model::ops::GridSize;

use super::{AutoencoderRecipe, salience::Salience};

/// Pictures of one training step.
pub(super) struct Crops {
    /// Number and size.
    pub grid: GridSize,
    /// RGB in 0..1, (crop, row, column, colour).
    pub values: Vec<f32>,
    /// Weight of each pixel in the loss, with mean 1.
    pub weights: Vec<f32>,
}

/// Draws the crops of a step, or whole pictures of equal cost if `whole`.
pub(super) fn draw(
    dataset: &Dataset,
    salience: &Salience<'_>,
    recipe: &AutoencoderRecipe,
    whole: bool,
    rng: &mut impl Rng,
) -> Crops {
    let (height, width) = dataset.size();
    let (rows, columns) = if whole {
        (height, width)
    } else {
        (recipe.crop.min(height), recipe.crop.min(width))
    };
    // Crops and whole pictures cost the same per step.
    let count = if whole {
        (recipe.batch * recipe.crop * recipe.crop / (height * width)).max(1)
    } else {
        recipe.batch
    };
    let mut values = Vec::with_capacity(count * rows * columns * 3);
    let mut weights = Vec::with_capacity(count * rows * columns);
    for _ in 0..count {
        let frame = rng.random_range(0..dataset.frame_count().max(1));
        let salient = rng.random_bool(recipe.salient) && !whole;
        let centre = salient
            .then(|| salience.pixel(episode_of(dataset, frame), frame, rng))
            .flatten();
        let top = start(centre.map(|c| c.0), rows, height, rng);
        let left = start(centre.map(|c| c.1), columns, width, rng);
        // `frame` and the crop lie inside the dataset's frames.
        let picture = dataset.frame(frame).unwrap_or_default();
        let mask = dataset.mask(frame);
        for row in top..top + rows {
            let first = row * width + left;
            let bytes = picture
                .get(first * 3..(first + columns) * 3)
                .unwrap_or_default();
            values.extend(bytes.iter().map(|v| f32::from(*v) / 255.0));
            match mask.and_then(|mask| mask.get(first..first + columns)) {
                Some(mask) => weights.extend(
                    mask.iter()
                        .map(|class| 1.0 + recipe.mask_weight * f32::from(u8::from(*class > 0))),
                ),
                None => weights.extend(std::iter::repeat_n(1.0, columns)),
            }
        }
    }
    let mean = weights.iter().sum::<f32>() / weights.len().max(1) as f32;
    for weight in &mut weights {
        *weight /= mean;
    }
    Crops {
        grid: GridSize {
            images: count,
            height: rows,
            width: columns,
        },
        values,
        weights,
    }
}

/// Start of a crop of `length`: anywhere, or with `centre` near its middle.
fn start(centre: Option<usize>, length: usize, size: usize, rng: &mut impl Rng) -> usize {
    let last = size - length;
    match centre {
        None => rng.random_range(0..=last),
        Some(centre) => {
            let into = rng.random_range(length / 4..=length - length / 4);
            centre.saturating_sub(into).min(last)
        }
    }
}

fn episode_of(dataset: &Dataset, frame: usize) -> usize {
    dataset
        .episodes()
        .partition_point(|episode| episode.first_frame <= frame)
        .saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::start;

    #[test]
    fn crop_contains_its_centre_and_stays_inside() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for centre in [0, 5, 64, 126, 127] {
            for _ in 0..50 {
                let start = start(Some(centre), 64, 128, &mut rng);
                assert!(start <= 64);
                assert!(
                    (start..start + 64).contains(&centre),
                    "{centre} from {start}"
                );
            }
        }
        assert_eq!(start(None, 128, 128, &mut rng), 0);
    }
}
