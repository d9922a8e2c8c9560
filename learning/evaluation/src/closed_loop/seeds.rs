//! Seeded episodes, several at a time.

use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use wm_program::progress::Progress;

/// The seeds of all episodes.
#[derive(Clone, Copy, Debug)]
pub struct Seeds {
    /// Seed of the first episode; each later one adds 1.
    pub first: u64,
    pub count: usize,
    /// Number of parallel episodes.
    pub parallel: usize,
}

impl Seeds {
    /// Results of `one` for each seed, in order, independent of the parallelism.
    pub fn run<T: Send>(self, verb: &str, one: impl Fn(u64) -> Result<T> + Sync) -> Result<Vec<T>> {
        ensure!(self.count > 0, "--episodes is at least 1");
        ensure!(self.parallel > 0, "--parallel is at least 1");
        let progress = Progress::of(verb, "episodes", self.count as u64);
        let counted = |index: usize| {
            let made = one(self.first.wrapping_add(index as u64));
            progress.inc(1);
            made
        };
        let made = if self.parallel == 1 {
            (0..self.count).map(counted).collect()
        } else {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(self.parallel);
            let pool = pool.build().context("--parallel")?;
            pool.install(|| (0..self.count).into_par_iter().map(counted).collect())
        };
        drop(progress);
        made
    }
}
