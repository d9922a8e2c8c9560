//! Threads of a node's own, so that its work waits for no other node of the process; of lower priority, where it may finish
//! later than that of others in or outside the process.

use std::sync::Arc;

use anyhow::{Context as _, Result};

/// The threads; copies are the same ones.
#[derive(Clone, Debug)]
pub struct Pool(Arc<rayon::ThreadPool>);

impl Pool {
    /// As many threads as rayon has by default, named after the node and `nice` steps (0: none) below this process.
    ///
    /// # Errors
    /// No threads.
    pub fn new(name: &str, nice: i32) -> Result<Self> {
        let name = name.to_owned();
        let pool = rayon::ThreadPoolBuilder::new()
            .thread_name(move |index| format!("{name} {index}"))
            .start_handler(move |_| {
                // Linux has a priority for each thread, where POSIX has one for the process.
                if let Err(error) = rustix::process::nice(nice) {
                    tracing::warn!(
                        "cannot lower the priority; computing at the usual priority: {error}"
                    );
                }
            })
            .build()
            .context("the threads to compute on")?;
        Ok(Self(Arc::new(pool)))
    }

    /// Computes `job` there, with all that it spreads by rayon, and waits for it. What it logs is still the node's.
    pub fn run<R: Send>(&self, job: impl FnOnce() -> R + Send) -> R {
        let span = tracing::Span::current();
        self.0.install(|| span.in_scope(job))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use rayon::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn all_of_a_job_gives_way_and_nothing_else() {
        let of_this_thread = || rustix::process::getpriority_process(None).unwrap();
        let here = of_this_thread();
        let pool = Pool::new("planner", 3).unwrap();
        let seen: BTreeSet<_> = pool.run(|| {
            (0..1000_u32)
                .into_par_iter()
                .map(|_| {
                    (
                        of_this_thread(),
                        std::thread::current().name().unwrap()[..8].to_owned(),
                    )
                })
                .collect()
        });
        let lower = (here + 3).min(19);
        assert_eq!(seen, BTreeSet::from([(lower, "planner ".to_owned())]));
        assert_eq!(of_this_thread(), here);
    }
}
