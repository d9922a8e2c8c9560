//! Selected pictures of an episode.

use std::sync::Arc;

use image::RgbImage;

/// The most shots: then every second one is removed, and the sampling rate halved.
const MOST: usize = 32;

/// Pictures of the newest plan; none before the first one.
#[derive(Clone, Debug, Default)]
pub(crate) struct Imagined {
    /// Its outcome.
    pub outcome: Option<Arc<RgbImage>>,
    /// Its subgoals side by side, nearest first; none if the planner makes none.
    pub subgoals: Option<Arc<RgbImage>>,
}

/// A camera picture and what was imagined then.
#[derive(Clone, Debug)]
pub(crate) struct Shot {
    /// Since the episode's first shot \[s\].
    pub time_s: f64,
    /// The camera's picture.
    pub seen: RgbImage,
    /// The pictures of the newest plan.
    pub imagined: Imagined,
}

/// Shots of an episode, evenly over its duration.
#[derive(Clone, Debug)]
pub(crate) struct Shots {
    shots: Vec<Shot>,
    /// Every how many frames one is kept.
    stride: usize,
    frames: usize,
    first_ns: Option<i64>,
}

impl Default for Shots {
    fn default() -> Self {
        Self {
            shots: Vec::new(),
            stride: 1,
            frames: 0,
            first_ns: None,
        }
    }
}

impl Shots {
    /// Takes a picture if it is due.
    pub(crate) fn take(
        &mut self,
        stamp_ns: i64,
        seen: impl FnOnce() -> Option<RgbImage>,
        imagined: &Imagined,
    ) {
        let is_due = self.frames.is_multiple_of(self.stride);
        self.frames += 1;
        if !is_due {
            return;
        }
        let Some(seen) = seen() else { return };
        let first_ns = *self.first_ns.get_or_insert(stamp_ns);
        self.shots.push(Shot {
            time_s: stamp_ns.saturating_sub(first_ns) as f64 / 1e9,
            seen,
            imagined: imagined.clone(),
        });
        if self.shots.len() == MOST {
            let mut index = 0;
            self.shots.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }

    /// At most `count` of them, the first and the last included.
    pub(crate) fn evenly(&self, count: usize) -> Vec<&Shot> {
        let last = self.shots.len().saturating_sub(1);
        let columns = count.min(self.shots.len());
        let at = |column: usize| {
            self.shots
                .get(column * last / columns.saturating_sub(1).max(1))
        };
        (0..columns).filter_map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shots_are_few_and_even_over_time() {
        let mut shots = Shots::default();
        let mut most = 0;
        for frame in 0..1000_i64 {
            let seen = || Some(RgbImage::new(1, 1));
            shots.take(frame * 1_000_000_000, seen, &Imagined::default());
            most = most.max(shots.shots.len());
        }
        assert!(most < MOST);
        let times: Vec<f64> = shots.shots.iter().map(|shot| shot.time_s).collect();
        assert_eq!(times[0], 0.0);
        assert!(
            times.windows(2).all(|pair| pair[1] - pair[0] == 64.0),
            "{times:?}"
        );
        let shown = shots.evenly(5);
        assert_eq!(shown.len(), 5);
        assert_eq!(
            (shown[0].time_s, shown[4].time_s),
            (0.0, times[times.len() - 1])
        );
        assert!(Shots::default().evenly(3).is_empty());
    }
}
