//! Standard output and standard error behind a queue, so that a terminal that nobody reads stops no node.
//!
//! A full pipe blocks whoever writes to it. Here that is one thread per stream; everybody else puts text into its queue,
//! which is bounded: the oldest text goes first, is counted, and the next text that can be written says how much is
//! missing. The lock of [`std::io::stderr`] is not taken, since whoever holds it in a blocked write stops the others.

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

/// Text that may wait for a reader \[byte\]; some thousand lines.
const MOST_BYTES: usize = 256 * 1024;

/// How long a stream in non-blocking mode that is full is left alone.
const PAUSE: Duration = Duration::from_millis(20);

pub(super) static STDERR: Outlet = Outlet::new("standard error", rustix::stdio::stderr);
pub(super) static STDOUT: Outlet = Outlet::new("standard output", rustix::stdio::stdout);

/// A stream of the process and the text that waits for it.
pub(super) struct Outlet {
    name: &'static str,
    stream: fn() -> BorrowedFd<'static>,
    queue: Mutex<Queue>,
    changed: Condvar,
    /// Texts that were dropped and that no report has counted yet.
    uncounted: AtomicU64,
}

#[derive(Debug)]
struct Queue {
    texts: VecDeque<Vec<u8>>,
    /// All texts together \[byte\].
    len: usize,
    /// Texts that were dropped since something was last written.
    dropped: u64,
    thread: Thread,
    /// Whether the thread holds text that is not written yet.
    is_writing: bool,
    /// Whether a write failed: there is nobody to read, and never will be.
    is_gone: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thread {
    NotStarted,
    Running,
    /// The system gives no thread: whoever has something to say writes it.
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

    /// Adds a text; gives how many older ones were dropped for it.
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

    /// The oldest text, after word of those that are missing before it.
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

    /// Queues a text, whole lines at best. Never waits for the stream's reader.
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

    /// Texts that were dropped since this was last asked.
    pub(super) fn take_dropped(&self) -> u64 {
        self.uncounted.swap(0, Ordering::Relaxed)
    }

    /// Writes what is queued, as long as there is a reader.
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
            Ok(written) => text = text.get(written..).unwrap_or_default(),
            Err(Errno::INTR) => {}
            // Somebody who shares the stream has put it into non-blocking mode.
            Err(Errno::AGAIN) => std::thread::sleep(PAUSE),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// A stream that takes text at once; what is written goes into the queue when it is flushed.
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
