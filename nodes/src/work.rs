//! Heavy computation beside a node's message loop.
//!
//! A [`Work`] runs one job at a time on a blocking thread and lets a bounded number wait. When one more comes, the
//! oldest that waits is given back to be counted as a drop (`DropOldest`): a node that is too slow falls behind by
//! leaving frames out, not by growing late.

use std::{collections::VecDeque, sync::Arc};

use tokio::task::{JoinError, JoinHandle};

/// Jobs of one kind, run one after another.
pub struct Work<T, R> {
    run: Arc<dyn Fn(T) -> R + Send + Sync>,
    waiting: VecDeque<T>,
    capacity: usize,
    running: Option<JoinHandle<R>>,
}

impl<T: Send + 'static, R: Send + 'static> Work<T, R> {
    /// Jobs that `run` computes; at most `capacity` (at least 1) wait.
    pub fn new(capacity: usize, run: impl Fn(T) -> R + Send + Sync + 'static) -> Self {
        Self {
            run: Arc::new(run),
            waiting: VecDeque::new(),
            capacity: capacity.max(1),
            running: None,
        }
    }

    /// Starts a job, or lets it wait; gives back the oldest waiting one where there is no room. Within a tokio runtime.
    #[must_use = "a job that is given back will never run: count it"]
    pub fn submit(&mut self, job: T) -> Option<T> {
        if self.running.is_none() {
            self.start(job);
            return None;
        }
        let dropped = if self.waiting.len() == self.capacity {
            self.waiting.pop_front()
        } else {
            None
        };
        self.waiting.push_back(job);
        dropped
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// The result of the running job, when it is there; never, while there is none. Cancel safe.
    ///
    /// # Errors
    /// [`JoinError`] where the job panicked.
    pub async fn finished(&mut self) -> Result<R, JoinError> {
        let Some(running) = &mut self.running else {
            return std::future::pending().await;
        };
        let result = running.await;
        self.running = None;
        if let Some(next) = self.waiting.pop_front() {
            self.start(next);
        }
        result
    }

    fn start(&mut self, job: T) {
        let run = Arc::clone(&self.run);
        self.running = Some(tokio::task::spawn_blocking(move || run(job)));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::{Mutex, mpsc};

    use super::*;

    #[tokio::test]
    async fn runs_in_order_and_gives_back_the_oldest_that_waits() {
        let (release, gate) = mpsc::channel::<()>();
        let gate = Mutex::new(gate);
        let mut work = Work::new(2, move |job: u32| {
            gate.lock().unwrap().recv().unwrap();
            job * 10
        });
        let given_back: Vec<_> = (1..=5).map(|job| work.submit(job)).collect();
        assert_eq!(given_back, [None, None, None, Some(2), Some(3)]);
        for expected in [10, 40, 50] {
            release.send(()).unwrap();
            assert_eq!(work.finished().await.unwrap(), expected);
        }
        assert_eq!(work.submit(6), None);
        release.send(()).unwrap();
        assert_eq!(work.finished().await.unwrap(), 60);
    }

    #[tokio::test]
    async fn a_panic_is_an_error() {
        let mut work = Work::new(1, |_: ()| -> () { panic!("of the job") });
        assert_eq!(work.submit(()), None);
        assert!(work.finished().await.unwrap_err().is_panic());
    }
}
