//! A bounded queue between the thread that receives and the task that reads.

use std::{
    collections::VecDeque,
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};
use tokio::sync::Notify;

/// A queue that holds at most `depth` items. Policy DropOldest: when full, the oldest item is dropped and counted,
/// since in a live stream the newest matters most.
#[derive(Debug)]
pub(crate) struct Mailbox<T> {
    state: Mutex<State<T>>,
    arrived: Notify,
    depth: usize,
    dropped: AtomicU64,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    closed: bool,
}

impl<T> Mailbox<T> {
    /// A queue of at least one item.
    pub(crate) fn new(depth: usize) -> Self {
        Self {
            state: Mutex::new(State {
                items: VecDeque::new(),
                closed: false,
            }),
            arrived: Notify::new(),
            depth: depth.max(1),
            dropped: AtomicU64::new(0),
        }
    }

    /// No invariant spans the lock, so a panic elsewhere leaves a usable queue.
    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an item; `false` if the oldest was dropped for it.
    pub(crate) fn push(&self, item: T) -> bool {
        let mut state = self.state();
        let full = state.items.len() >= self.depth;
        if full {
            state.items.pop_front();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        state.items.push_back(item);
        drop(state);
        self.arrived.notify_one();
        !full
    }

    /// Takes the oldest item, if any.
    pub(crate) fn try_pop(&self) -> Option<T> {
        self.state().items.pop_front()
    }

    /// Returns the result of `read` for the oldest item, which stays in the queue.
    pub(crate) fn peek<R>(&self, read: impl FnOnce(&T) -> R) -> Option<R> {
        self.state().items.front().map(read)
    }

    /// Waits for an item; `None` once the queue is closed and empty. Cancel safe: an item is taken at the last step.
    pub(crate) async fn pop(&self) -> Option<T> {
        loop {
            {
                let mut state = self.state();
                if let Some(item) = state.items.pop_front() {
                    return Some(item);
                }
                if state.closed {
                    return None;
                }
            }
            // A push between the check and this line leaves a permit, so it is not missed.
            self.arrived.notified().await;
        }
    }

    /// Drops all items without counting them: they are no loss.
    pub(crate) fn clear(&self) {
        self.state().items.clear();
    }

    /// Ends the stream: a waiting reader wakes up.
    pub(crate) fn close(&self) {
        self.state().closed = true;
        self.arrived.notify_one();
    }

    /// Items dropped so far.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[tokio::test(flavor = "current_thread")]
    async fn a_waiting_reader_gets_what_comes_and_the_end() {
        let mailbox = std::sync::Arc::new(Mailbox::new(2));
        let reader = tokio::spawn({
            let mailbox = std::sync::Arc::clone(&mailbox);
            async move { (mailbox.pop().await, mailbox.pop().await) }
        });
        tokio::task::yield_now().await;
        mailbox.push(1);
        tokio::task::yield_now().await;
        mailbox.close();
        assert_eq!(reader.await.unwrap(), (Some(1), None));
    }

    proptest! {
        /// For any order of writes and reads: the newest `depth` items are kept in order, and every other is counted.
        #[test]
        fn every_item_is_read_or_counted(depth in 1usize..5, operations in prop::collection::vec(any::<bool>(), 0..60)) {
            let mailbox = Mailbox::new(depth);
            let (mut next, mut read) = (0u64, Vec::new());
            for is_push in operations {
                if is_push {
                    mailbox.push(next);
                    next += 1;
                } else if let Some(item) = mailbox.try_pop() {
                    read.push(item);
                }
            }
            let mut waiting = 0;
            while let Some(item) = mailbox.try_pop() {
                read.push(item);
                waiting += 1;
            }
            prop_assert!(waiting <= depth);
            prop_assert!(read.is_sorted());
            prop_assert_eq!(read.len() as u64 + mailbox.dropped(), next);
            if waiting > 0 {
                prop_assert_eq!(read.last().copied(), Some(next - 1));
            }
        }
    }
}
