//! A node's own threads, so that its work waits for no other node of the process: in the background if it may finish later
//! than the work of others, else in the foreground.

use std::sync::Arc;

use anyhow::{Context as _, Result};

use crate::{processors::Processors, time_slice};

/// The threads; copies are the same ones.
#[derive(Clone, Debug)]
pub struct Pool(Arc<rayon::ThreadPool>);

impl Pool {
    /// As many threads as rayon has by default, named after the node and `nice` steps (0: none) below this process.
    ///
    /// # Errors
    /// No threads.
    pub fn background(name: &str, nice: i32) -> Result<Self> {
        Self::started(name, move |_| {
            // Linux has a priority for each thread, where POSIX has one for the process.
            if let Err(error) = rustix::process::nice(nice) {
                tracing::warn!(
                    "cannot lower the priority; computing at the usual priority: {error}"
                );
            }
        })
    }

    /// As many threads as rayon has by default, named after the node. Each gets a processor at once when it wakes up, and is
    /// bound to a processor of its own if there are as many processors as threads.
    ///
    /// Threads that share a job must not share a processor. On a virtual machine, whose idle processors Linux takes for
    /// busy ones of the host's, they often do if they are free to move.
    ///
    /// # Errors
    /// No threads.
    pub fn foreground(name: &str) -> Result<Self> {
        let processors = Processors::of_process();
        Self::started(name, move |thread| {
            processors.bind(thread);
            time_slice::shorten();
        })
    }

    fn started(name: &str, on_start: impl Fn(usize) + Send + Sync + 'static) -> Result<Self> {
        let name = name.to_owned();
        let pool = rayon::ThreadPoolBuilder::new()
            .thread_name(move |index| format!("{name} {index}"))
            .start_handler(on_start)
            .build()
            .context("the threads to compute on")?;
        Ok(Self(Arc::new(pool)))
    }

    /// Runs `job` on these threads, rayon's part too, and waits for it. Its log lines are still the node's.
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
        let pool = Pool::background("planner", 3).unwrap();
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

    #[test]
    fn each_foreground_thread_has_a_processor_of_its_own() {
        let here = Processors::of_process();
        let pool = Pool::foreground("encoder").unwrap();
        let of_threads = pool
            .0
            .broadcast(|thread| (thread.index(), Processors::of_process()));
        let has_one_each = pool.0.current_num_threads() == here.count();
        for (index, processors) in of_threads {
            let expected = match has_one_each {
                true => here.only(index),
                false => here.clone(),
            };
            assert_eq!(processors, expected);
        }
        assert_eq!(Processors::of_process(), here);
    }
}
