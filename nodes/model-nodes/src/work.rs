//! Heavy computation off a node's message loop.
//!
//! A [`Work`] runs one job at a time on a blocking thread and lets a bounded number wait. When one more arrives, the
//! oldest waiting job is returned and counted as a drop (drop-oldest): a node that is too slow drops frames instead of
//! falling further and further behind. [`Stop`] tells a job that its result is no longer needed.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use tokio::task::{JoinError, JoinHandle};

use crate::pool::Pool;

/// Whether the [`Work`] of a job is gone. A thread cannot be ended from outside, so a long job checks this.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Whether the job's result is no longer needed.
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Computes a job.
type Run<T, R> = Arc<dyn Fn(T, &Stop) -> R + Send + Sync>;

/// Jobs of one kind, run one after another.
pub struct Work<T, R> {
    run: Run<T, R>,
    stop: Stop,
    waiting: VecDeque<T>,
    capacity: usize,
    running: Option<JoinHandle<R>>,
    /// `None`: the threads that the process shares.
    pool: Option<Pool>,
}

impl<T: Send + 'static, R: Send + 'static> Work<T, R> {
    /// Jobs that `run` computes; at most `capacity` (at least 1) wait.
    pub fn new(capacity: usize, run: impl Fn(T, &Stop) -> R + Send + Sync + 'static) -> Self {
        Self {
            run: Arc::new(run),
            stop: Stop::default(),
            waiting: VecDeque::new(),
            capacity: capacity.max(1),
            running: None,
            pool: None,
        }
    }

    /// The same jobs, on threads of their own.
    #[must_use]
    pub fn on(mut self, pool: &Pool) -> Self {
        self.pool = Some(pool.clone());
        self
    }

    /// Starts a job, or queues it; returns the oldest waiting job if the queue is full. Within a tokio runtime.
    #[must_use = "a job that is given back will never run: count it"]
    pub fn submit(&mut self, job: T) -> Option<T> {
        if self.running.is_none() {
            self.start(job);
            return None;
        }
        let dropped = if self.waiting.len() >= self.capacity {
            self.waiting.pop_front()
        } else {
            None
        };
        self.waiting.push_back(job);
        dropped
    }

    /// Changes how many jobs may wait (at least 1).
    pub fn set_capacity(&mut self, capacity: usize) {
        self.capacity = capacity.max(1);
    }

    /// Whether a job runs.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Takes back the jobs that wait, oldest first.
    pub fn take_waiting(&mut self) -> VecDeque<T> {
        std::mem::take(&mut self.waiting)
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
        let (run, stop) = (Arc::clone(&self.run), self.stop.clone());
        // The job's log lines are the node's, also if a process has several nodes.
        let span = tracing::Span::current();
        let pool = self.pool.clone();
        let job = move || {
            let job = || span.in_scope(|| run(job, &stop));
            match pool {
                Some(pool) => pool.run(job),
                None => job(),
            }
        };
        self.running = Some(tokio::task::spawn_blocking(job));
    }
}

impl<T, R> Drop for Work<T, R> {
    fn drop(&mut self) {
        self.stop.0.store(true, Ordering::Relaxed);
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
        let mut work = Work::new(2, move |job: u32, _| {
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
        let mut work = Work::new(1, |(): (), _| -> () { panic!("of the job") });
        assert_eq!(work.submit(()), None);
        assert!(work.finished().await.unwrap_err().is_panic());
    }

    #[tokio::test]
    async fn a_job_learns_that_nobody_waits() {
        let (tell, told) = mpsc::channel();
        let tell = Mutex::new(tell);
        let mut work = Work::new(1, move |(), stop: &Stop| {
            while !stop.is_asked() {
                std::thread::yield_now();
            }
            tell.lock().unwrap().send(()).unwrap();
        });
        assert_eq!(work.submit(()), None);
        drop(work);
        tokio::task::spawn_blocking(move || told.recv().unwrap())
            .await
            .unwrap();
    }
}
