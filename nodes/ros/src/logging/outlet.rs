//! Standard output and standard error with a queue each, so that an unread terminal stops no node.
//!
//! A full pipe blocks its writer. Here that is one thread per stream; other threads add text to its bounded queue. If
//! the queue is full, the oldest text is dropped and counted, and the next written text is preceded by the number of
//! dropped texts. The lock of [`std::io::stderr`] is not taken, since a blocked write under it would stop all threads.

use super::{seconds, system_nanos};
use rustix::{fd::BorrowedFd, io::Errno};
use std::{
    collections::VecDeque,
    io,
    sync::{
        Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

/// The most text in the queue \[byte\]; some thousand lines.
const MOST_BYTES: usize = 256 * 1024;

/// The pause before the next write to a full stream in non-blocking mode.
const PAUSE: Duration = Duration::from_millis(20);

pub(super) static STDERR: Outlet = Outlet::new("standard error", rustix::stdio::stderr);
pub(super) static STDOUT: Outlet = Outlet::new("standard output", rustix::stdio::stdout);

/// A stream of the process and its queue.
pub(super) struct Outlet {
    name: &'static str,
    stream: fn() -> BorrowedFd<'static>,
    queue: Mutex<Queue>,
    changed: Condvar,
    /// Texts dropped since the last report.
    uncounted: AtomicU64,
}

#[derive(Debug)]
struct Queue {
    texts: VecDeque<Vec<u8>>,
    /// All texts together \[byte\].
    len: usize,
    /// Texts dropped since the last write.
    dropped: u64,
    thread: Thread,
    /// Whether the thread is writing a text.
    is_writing: bool,
    /// Whether a write failed: the reader is gone for good.
    is_gone: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thread {
    NotStarted,
    Running,
    /// The system refused the thread: the callers write.
    None,
}

impl Queue {
    const fn new() -> Self {
        Self {
            texts: VecDeque::new(),
            len: 0,
            dropped: 0,
            thread: Thread::NotStarted,
            is_writing: false,
            is_gone: false,
        }
    }

    /// Adds a text; returns the number of older texts dropped for it.
    fn push(&mut self, text: Vec<u8>) -> u64 {
        let mut dropped = 0;
        while self.len + text.len() > MOST_BYTES
            && let Some(oldest) = self.texts.pop_front()
        {
            self.len -= oldest.len();
            dropped += 1;
        }
        self.len += text.len();
        self.texts.push_back(text);
        self.dropped += dropped;
        dropped
    }

    /// The oldest text, preceded by the number of dropped texts, if any.
    fn pop(&mut self, stream: &str) -> Option<Vec<u8>> {
        if self.dropped > 0 {
            let dropped = std::mem::take(&mut self.dropped);
            let stamp = seconds(system_nanos());
            let note = format!(
                "[WARN] [{stamp}] [wm_ros.logging]: {dropped} lines were dropped here: nobody read {stream}\n"
            );
            return Some(note.into_bytes());
        }
        let text = self.texts.pop_front()?;
        self.len -= text.len();
        Some(text)
    }
}

impl Outlet {
    const fn new(name: &'static str, stream: fn() -> BorrowedFd<'static>) -> Self {
        Self {
            name,
            stream,
            queue: Mutex::new(Queue::new()),
            changed: Condvar::new(),
            uncounted: AtomicU64::new(0),
        }
    }

    /// Queues a text, preferably of whole lines. Never waits for the stream's reader.
    ///
    /// # Errors
    /// The stream is closed.
    pub(super) fn push(&'static self, text: Vec<u8>) -> io::Result<()> {
        let mut queue = self.queue();
        if queue.is_gone {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        if queue.thread == Thread::NotStarted {
            let thread = std::thread::Builder::new().name("wm_output".to_owned());
            queue.thread = match thread.spawn(|| self.write_all()) {
                Ok(_) => Thread::Running,
                Err(_) => Thread::None,
            };
        }
        if queue.thread == Thread::None {
            return write(self.stream, &text);
        }
        let dropped = queue.push(text);
        self.uncounted.fetch_add(dropped, Ordering::Relaxed);
        self.changed.notify_all();
        Ok(())
    }

    /// Waits until everything is written, at most `limit`.
    pub(super) fn flush(&self, limit: Duration) {
        let is_busy = |queue: &mut Queue| {
            !queue.is_gone && (queue.is_writing || !queue.texts.is_empty() || queue.dropped > 0)
        };
        let waited = self
            .changed
            .wait_timeout_while(self.queue(), limit, is_busy);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// Returns the number of texts dropped since the last call.
    pub(super) fn take_dropped(&self) -> u64 {
        self.uncounted.swap(0, Ordering::Relaxed)
    }

    /// Writes the queue until a write fails.
    fn write_all(&self) {
        let mut queue = self.queue();
        while !queue.is_gone {
            queue = match queue.pop(self.name) {
                None => {
                    let woken = self.changed.wait(queue);
                    woken.unwrap_or_else(PoisonError::into_inner)
                }
                Some(text) => {
                    queue.is_writing = true;
                    drop(queue);
                    let written = write(self.stream, &text);
                    let mut queue = self.queue();
                    queue.is_writing = false;
                    if written.is_err() {
                        let thread = queue.thread;
                        *queue = Queue {
                            thread,
                            is_gone: true,
                            ..Queue::new()
                        };
                    }
                    self.changed.notify_all();
                    queue
                }
            };
        }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn write(stream: fn() -> BorrowedFd<'static>, mut text: &[u8]) -> io::Result<()> {
    while !text.is_empty() {
        match rustix::io::write(stream(), text) {
            // the system writes no more than `text`
            Ok(written) => text = text.get(written..).unwrap_or_default(),
            Err(Errno::INTR) => {}
            // Another process with this stream has set it to non-blocking mode.
            Err(Errno::AGAIN) => std::thread::sleep(PAUSE),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// A writer that never blocks; flushing moves its text into the queue.
pub struct Unblocked {
    outlet: &'static Outlet,
    text: Vec<u8>,
}

impl Unblocked {
    pub(super) const fn new(outlet: &'static Outlet) -> Self {
        Self {
            outlet,
            text: Vec::new(),
        }
    }
}

impl io::Write for Unblocked {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(text);
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.text.is_empty() {
            return Ok(());
        }
        self.outlet.push(std::mem::take(&mut self.text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_text_goes_first_and_is_counted() {
        let mut queue = Queue::new();
        let line = vec![b'x'; MOST_BYTES / 4];
        let dropped: u64 = (0..6).map(|_| queue.push(line.clone())).sum();
        assert_eq!((dropped, queue.texts.len(), queue.len), (2, 4, MOST_BYTES));
        let note = String::from_utf8(queue.pop("standard error").unwrap()).unwrap();
        assert!(
            note.contains("2 lines were dropped here: nobody read standard error"),
            "{note}"
        );
        assert_eq!(queue.pop("standard error"), Some(line));
        assert_eq!((queue.dropped, queue.len), (0, MOST_BYTES / 4 * 3));
    }

    #[test]
    fn a_text_larger_than_the_queue_is_taken_alone() {
        let mut queue = Queue::new();
        queue.push(vec![b'a'; 10]);
        assert_eq!(queue.push(vec![b'b'; MOST_BYTES + 1]), 1);
        assert_eq!(queue.texts.len(), 1);
    }
}
