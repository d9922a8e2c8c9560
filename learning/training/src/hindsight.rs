//! Hindsight goals: a later frame of an episode is the goal of an earlier one.

use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use rand::Rng;
use wm_dataset::Latents;

/// An earlier frame of an episode and a later one, its goal. Frames count from the start of the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Hindsight {
    pub present: usize,
    pub goal: usize,
}

/// Draws frames with their goals.
pub(crate) struct HindsightSource<'a> {
    latents: &'a Latents,
    /// Camera frames per model step.
    frame_skip: usize,
    /// The longest way, in model steps.
    longest: usize,
    /// First frame and number of frames of each usable episode.
    episodes: Vec<(usize, usize)>,
    device: Device,
}

impl<'a> HindsightSource<'a> {
    /// Ways of up to `longest` model steps of `frame_skip` camera frames each.
    ///
    /// # Errors
    /// If no episode is longer than a model step, or a number is 0.
    pub fn new(latents: &'a Latents, frame_skip: usize, longest: usize) -> Result<Self> {
        ensure!(
            frame_skip > 0 && longest > 0,
            "frame_skip is {frame_skip} and longest {longest}, expected at least 1"
        );
        let spans = latents.episodes().iter();
        let spans = spans.map(|episode| (episode.first_frame, episode.frame_count));
        let episodes: Vec<_> = spans.filter(|(_, count)| *count > frame_skip).collect();
        ensure!(
            !episodes.is_empty(),
            "no episode is long enough: a way to a goal needs {} frames",
            frame_skip + 1
        );
        Ok(Self {
            latents,
            frame_skip,
            longest,
            episodes,
            device: Device::Cpu,
        })
    }

    /// Moves tensors to `device`.
    pub fn on(self, device: &Device) -> Self {
        let device = device.clone();
        Self { device, ..self }
    }

    /// Number of usable episodes.
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Model steps from a frame to its goal.
    pub fn steps(&self, way: Hindsight) -> f64 {
        (way.goal - way.present) as f64 / self.frame_skip as f64
    }

    /// A random frame with a goal; the length of the way is uniform.
    pub fn draw(&self, rng: &mut impl Rng) -> Hindsight {
        self.draw_by(rng, |rng, most| rng.random_range(1..=most))
    }

    /// A random frame with a goal; the logarithm of the length of the way is uniform, so that near goals are as frequent
    /// as far ones.
    pub fn draw_near(&self, rng: &mut impl Rng) -> Hindsight {
        self.draw_by(rng, |rng, most| logarithmic(rng, 1, most))
    }

    fn draw_by<R: Rng>(&self, rng: &mut R, length: impl Fn(&mut R, usize) -> usize) -> Hindsight {
        let (first, count) = self.episodes[rng.random_range(0..self.episodes.len())];
        let present = rng.random_range(0..count - 1);
        let most = (count - 1 - present).min(self.longest.saturating_mul(self.frame_skip));
        Hindsight {
            present: first + present,
            goal: first + present + length(rng, most),
        }
    }

    /// A goal of the frame `present`, at least a model step later; the logarithm of the length of the way is uniform, so
    /// that near goals are as frequent as far ones. The last frame of the episode if it is nearer than a model step.
    pub fn later(&self, present: usize, rng: &mut impl Rng) -> usize {
        let left = self.last(present) - present;
        let most = left.min(self.longest.saturating_mul(self.frame_skip));
        let least = self.frame_skip.min(most);
        present + logarithmic(rng, least, most)
    }

    /// The last frame of the episode of `present`.
    pub fn last(&self, present: usize) -> usize {
        // Episodes are in the order of their frames.
        let later = self
            .episodes
            .partition_point(|(first, _)| *first <= present);
        let episode = later.checked_sub(1).and_then(|at| self.episodes.get(at));
        episode.map_or(present, |(first, count)| present.max(first + count - 1))
    }

    /// The frame `steps` model steps on the way, or the goal if it is nearer.
    pub fn on_the_way(&self, way: Hindsight, steps: usize) -> usize {
        let there = steps.saturating_mul(self.frame_skip);
        way.goal.min(way.present.saturating_add(there))
    }

    /// Latents (B, n, h, w, C) of B rows of n frames.
    ///
    /// # Errors
    /// If a frame cannot be read.
    pub fn tensor(&self, rows: &[Vec<usize>]) -> Result<Tensor> {
        let (h, w, c) = self.latents.space().shape();
        let frames = rows.first().map_or(0, Vec::len);
        let mut values = Vec::with_capacity(rows.len() * frames * h * w * c);
        for frame in rows.iter().flatten() {
            self.latents.read(*frame, &mut values)?;
        }
        let shape = (rows.len(), frames, h, w, c);
        Ok(Tensor::from_vec(values, shape, &self.device)?)
    }
}

/// A number from `least` to `most`, whose logarithm is uniform.
fn logarithmic(rng: &mut impl Rng, least: usize, most: usize) -> usize {
    if most == 0 {
        return 0;
    }
    let log = rng.random_range((least.max(1) as f64).ln()..((most + 1) as f64).ln());
    (log.exp() as usize).clamp(least, most)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::transition::tests::moving;

    #[test]
    fn goals_are_later_frames_of_the_same_episode() {
        let dir = tempfile::tempdir().unwrap();
        let latents = moving(dir.path(), 4, 1);
        let source = HindsightSource::new(&latents, 2, 3).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let episode_of = |frame: usize| {
            let holds = |episode: &wm_dataset::Episode| {
                (episode.first_frame..episode.first_frame + episode.frame_count).contains(&frame)
            };
            latents.episodes().iter().position(holds).unwrap()
        };
        let mut near = 0;
        for _ in 0..500 {
            for way in [source.draw(&mut rng), source.draw_near(&mut rng)] {
                assert_eq!(episode_of(way.present), episode_of(way.goal));
                assert!(source.steps(way) > 0.0 && source.steps(way) <= 3.0);
                assert_eq!(source.on_the_way(way, 0), way.present);
                assert_eq!(source.on_the_way(way, 99), way.goal);
                near += usize::from(way.goal - way.present == 1);
            }
        }
        for present in [0, 1, 2, source.episodes[0].1 - 2, source.episodes[0].1 - 1] {
            let last = source.last(present);
            assert_eq!(last, source.episodes[0].1 - 1);
            let goals: Vec<usize> = (0..100).map(|_| source.later(present, &mut rng)).collect();
            let (least, most) = ((present + 2).min(last), (present + 6).min(last));
            assert!(
                goals.iter().all(|goal| (least..=most).contains(goal)),
                "{goals:?}"
            );
            assert!(goals.contains(&least) && goals.contains(&most), "{goals:?}");
        }
        assert!((200..500).contains(&near), "{near} of 1000");
        assert!(HindsightSource::new(&latents, 1000, 3).is_err());
        assert!(HindsightSource::new(&latents, 0, 3).is_err());
    }
}
