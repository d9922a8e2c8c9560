use std::collections::{BTreeMap, BTreeSet};

use wm_dataset::{Dataset, Episode};
use wm_zoo::success_probe::{GroundedProbeConfig, words};

use super::episodes::Sample;

/// Words of a thing's name.
type Name = Vec<String>;

/// Locations of the things named by instructions, from the masks and their labels.
pub(super) struct Things<'a> {
    dataset: &'a Dataset,
    /// All names in any episode.
    names: BTreeSet<Name>,
}

/// Target of a query in a frame: a thing lies between up to four places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Target {
    /// Index among the frames read.
    pub frame: usize,
    /// Index of the query: the thing's position in the instruction.
    pub query: usize,
    /// Place on the grid of the latents, row-major.
    pub place: usize,
    /// Share of the attention, above 0.
    pub share: f64,
}

impl<'a> Things<'a> {
    /// `None` if no bag labels its masks.
    pub(super) fn of(dataset: &'a Dataset) -> Option<Self> {
        let labels = dataset.episodes().iter().flat_map(|e| e.labels.values());
        let names: BTreeSet<Name> = labels.map(|name| words(name)).collect();
        (!names.is_empty()).then_some(Self { dataset, names })
    }

    /// Number of different things.
    pub(super) fn count(&self) -> usize {
        self.names.len()
    }

    /// Targets of a probe's queries in an episode under an instruction. Things without a mask have no target.
    pub(super) fn targets(
        &self,
        sample: &Sample,
        instruction: &str,
        config: &GroundedProbeConfig,
    ) -> Vec<Target> {
        let Some(episode) = self.dataset.episodes().get(sample.episode) else {
            return Vec::new();
        };
        let values = values(episode);
        let mentioned = self.mentioned(instruction);
        let mentioned = mentioned.iter().take(config.queries).enumerate();
        let mentioned: Vec<(usize, u8)> = mentioned
            .filter_map(|(query, name)| Some((query, *values.get(*name)?)))
            .collect();
        let mut targets = Vec::new();
        for (frame, index) in config.looked_at(sample.frames).into_iter().enumerate() {
            let mask = self
                .dataset
                .mask(sample.first_frame + index * sample.frame_skip);
            for (query, value) in &mentioned {
                let middle = mask.and_then(|mask| middle(mask, self.dataset.size(), *value));
                let places = middle
                    .into_iter()
                    .flat_map(|at| around(at, config.grid, sample.shift));
                targets.extend(places.map(|(place, share)| Target {
                    frame,
                    query: *query,
                    place,
                    share,
                }));
            }
        }
        targets
    }

    /// Things named by an instruction, in order.
    fn mentioned(&self, instruction: &str) -> Vec<&Name> {
        let words = words(instruction);
        let mut found = Vec::new();
        let mut rest = words.as_slice();
        while let Some((_, tail)) = rest.split_first() {
            let here = self.names.iter().filter(|name| rest.starts_with(name));
            let longest = here
                .max_by_key(|name| name.len())
                .filter(|name| !name.is_empty());
            rest = longest
                .and_then(|name| rest.get(name.len()..))
                .unwrap_or(tail);
            found.extend(longest);
        }
        found
    }
}

/// Mask values of the things in an episode.
fn values(episode: &Episode) -> BTreeMap<Name, u8> {
    let labels = episode.labels.iter();
    labels.map(|(value, name)| (words(name), *value)).collect()
}

/// Centre of the pixels with a value, from 0 at the upper and left border to 1 at the others; `None` without such pixels.
fn middle(mask: &[u8], (height, width): (usize, usize), value: u8) -> Option<[f64; 2]> {
    let (mut count, mut down, mut right) = (0, 0, 0);
    for (y, row) in mask.chunks_exact(width).enumerate() {
        for (x, _) in row.iter().enumerate().filter(|(_, pixel)| **pixel == value) {
            count += 1;
            down += y;
            right += x;
        }
    }
    let mean = |sum: usize, side: usize| (sum as f64 / f64::from(count) + 0.5) / side as f64;
    (count > 0).then(|| [mean(down, height), mean(right, width)])
}

/// Grid places around a point moved by `shift` places, with the shares of bilinear interpolation.
fn around(
    [down, right]: [f64; 2],
    [rows, columns]: [usize; 2],
    shift: [i64; 2],
) -> Vec<(usize, f64)> {
    let between = |at: f64, count: usize, shift: i64| {
        let last = count.saturating_sub(1);
        let at = (at * count as f64 - 0.5 + shift as f64).clamp(0.0, last as f64);
        let (first, part) = (at.floor() as usize, at.fract());
        [(first, 1.0 - part), ((first + 1).min(last), part)]
    };
    let [by_rows, by_columns] = shift;
    let places = between(down, rows, by_rows);
    let places = places.into_iter().flat_map(|(row, of_row)| {
        let of_columns = between(right, columns, by_columns);
        of_columns.map(|(column, of_column)| (row * columns + column, of_row * of_column))
    });
    places.filter(|(_, share)| *share > 0.0).collect()
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};

    use super::*;
    use wm_dataset::testing::write_masked;

    #[test]
    fn queries_point_at_named_things_in_order() {
        let dir = tempfile::tempdir().unwrap();
        let bags = dir.path().join("bags");
        write_masked(&bags.join("episode_000000"), 5);
        let dataset = Dataset::open(&bags, &dir.path().join("cache"), (16, 16)).unwrap();
        let things = Things::of(&dataset).unwrap();
        assert_eq!(things.count(), 3);
        let config = GroundedProbeConfig {
            features: 1,
            grid: [4, 4],
            max_frames: 5,
            text_features: 1,
            frames: 5,
            width: 1,
            channels: 1,
            queries: 2,
            text_width: 1,
            text_depth: 1,
            text_heads: 1,
            hidden: 1,
        };
        let sample = Sample {
            latents: Tensor::zeros((1, 5, 4, 4, 1), DType::F32, &Device::Cpu).unwrap(),
            episode: 0,
            first_frame: 0,
            frames: 5,
            frame_skip: 1,
            shift: [0; 2],
            questions: Vec::new(),
        };
        // The centre of a mask of one value lies between four places; the value is the frame's number.
        let targets = |instruction: &str| {
            let targets = things.targets(&sample, instruction, &config);
            for four in targets.chunks(4) {
                let places: Vec<usize> = four.iter().map(|target| target.place).collect();
                assert_eq!(places, [5, 6, 9, 10]);
                assert!(four.iter().all(|target| (target.share - 0.25).abs() < 1e-9));
            }
            let first = targets.iter().step_by(4);
            let first = first.map(|target| (target.frame, target.query));
            first.collect::<Vec<_>>()
        };
        let found = targets("Put the blue box, then the red ball down.");
        assert_eq!(found, [(2, 1), (3, 0)]);
        // The third thing has no query, and the green cup is unknown.
        let found = targets("the gripper puts the red ball on the blue box in the green cup");
        assert_eq!(found, [(1, 0), (2, 1)]);
    }

    #[test]
    fn weighted_mean_of_places_is_the_centre() {
        let mut mask = vec![0; 8 * 12];
        for (y, x) in [(4, 8), (4, 9), (5, 8), (5, 9)] {
            mask[y * 12 + x] = 3;
        }
        assert_eq!(middle(&mask, (8, 12), 2), None);
        let found = middle(&mask, (8, 12), 3).unwrap();
        assert_eq!(found, [5.0 / 8.0, 9.0 / 12.0]);
        // In units of places with centres at halves: 2.5 down and 4.5 to the right.
        assert_eq!(around(found, [4, 6], [0; 2]), [(2 * 6 + 4, 1.0)]);
        assert_eq!(around([0.5, 0.75], [4, 6], [0; 2]), [(10, 0.5), (16, 0.5)]);
        assert_eq!(around([0.0, 1.0], [4, 6], [0; 2]), [(5, 1.0)]);
        // Moved up by one and to the right, out of the grid.
        assert_eq!(around([0.5, 0.75], [4, 6], [-1, 9]), [(5, 0.5), (11, 0.5)]);
    }
}
