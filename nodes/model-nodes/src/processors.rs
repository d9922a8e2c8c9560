//! The processors that threads run on.

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// The processors that a process may use, in their order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Processors(Vec<usize>);

impl Processors {
    /// The processors of the calling thread; `None` if the system does not report them.
    pub fn of_process() -> Self {
        // An empty set: the system reports none.
        let allowed = sched_getaffinity(None).unwrap_or_default();
        let numbers = 0..CpuSet::MAX_CPU;
        Self(numbers.filter(|number| allowed.is_set(*number)).collect())
    }

    /// Binds the calling thread, number `thread` of rayon's, to the processor of that number, if there is one for each of
    /// them.
    pub fn bind(&self, thread: usize) {
        let (true, Some(processor)) = (
            self.0.len() == rayon::current_num_threads(),
            self.0.get(thread),
        ) else {
            return;
        };
        let mut own = CpuSet::new();
        own.set(*processor);
        if let Err(error) = sched_setaffinity(None, &own) {
            tracing::debug!("a thread is not bound to a processor: {error}");
        }
    }
}

#[cfg(test)]
impl Processors {
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The one of that number.
    pub fn only(&self, number: usize) -> Self {
        Self(self.0.get(number).copied().into_iter().collect())
    }
}
