//! The bag's thread: messages from a bounded queue into a [`BagWriter`].

use super::definitions::Definitions;
use anyhow::{Context as _, Result, anyhow, bail};
use bytes::Bytes;
use std::collections::{HashSet, VecDeque};
use std::path::Path;
use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicUsize, Ordering},
    mpsc,
};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;
use wm_bag::{
    BagSummary, BagWriter, Durability, LatchedMessages, QosProfile, Schema, WriterOptions,
    known_qos,
};

/// Bytes of messages that may wait for the disk, unless told otherwise: forty raw 1080p pictures.
pub(super) const CACHE_BYTES: usize = 256 << 20;

/// A chunk is closed after this much time at the latest: what a killed recorder may lose.
pub(super) const CHUNK_TIME: Duration = Duration::from_secs(1);

/// Finished chunks are on the disk after this much time at the latest: with the open chunk, what a power cut may lose.
pub(super) const SYNC_INTERVAL: Duration = Duration::from_secs(5);

/// An entry for the bag's thread.
pub(super) enum Entry {
    /// A topic that is recorded from now on.
    Topic {
        name: Arc<str>,
        type_name: String,
        /// The definitions that may be its publisher's.
        candidates: Vec<Schema>,
        qos: QosProfile,
    },
    /// A message of it.
    Message {
        topic: Arc<str>,
        log_time_ns: u64,
        data: Bytes,
    },
    /// So many messages of it did not get here.
    Lost { topic: Arc<str>, messages: u64 },
    /// The bag's next file begins here.
    Split,
}

/// The bag's thread.
pub(super) struct Recording {
    /// None once it is to end.
    queue: Option<Queue>,
    thread: JoinHandle<Result<BagSummary>>,
    /// Closes when the thread has written everything.
    written: oneshot::Receiver<()>,
}

/// Messages that wait for a snapshot.
#[derive(Default)]
struct SnapshotBuffer {
    messages: VecDeque<Entry>,
    bytes: usize,
    latched_topics: HashSet<Arc<str>>,
    /// Latched messages that have left the queue and are still valid.
    latched: LatchedMessages<Bytes>,
}

impl SnapshotBuffer {
    /// Keeps a latched message that leaves the queue.
    fn keep(&mut self, entry: &Entry) {
        if let Entry::Message { topic, data, .. } = entry
            && self.latched_topics.contains(topic)
        {
            self.latched.add(topic, data, data.clone());
        }
    }

    /// The messages that wait, after the latched ones that were valid when the first of them came.
    fn take(&mut self) -> Vec<Entry> {
        let first_ns = self.messages.front().and_then(|entry| match entry {
            Entry::Message { log_time_ns, .. } => Some(*log_time_ns),
            _ => None,
        });
        let Some(log_time_ns) = first_ns else {
            return Vec::new();
        };
        let latched = self.latched.iter().map(|(topic, data)| Entry::Message {
            topic: Arc::clone(topic),
            log_time_ns,
            data: data.clone(),
        });
        let mut taken: Vec<Entry> = latched.collect();
        for entry in std::mem::take(&mut self.messages) {
            self.keep(&entry);
            taken.push(entry);
        }
        self.bytes = 0;
        taken
    }
}

/// The way to the bag's thread.
#[derive(Clone)]
pub(super) struct Queue {
    // Bounded by the bytes that wait, which the channel does not know.
    queue: mpsc::Sender<Entry>,
    /// Bytes of the messages that wait.
    waiting: Arc<AtomicUsize>,
    /// Most bytes that may wait; a message that is larger by itself may wait alone.
    limit: usize,
    /// In snapshot mode: the latest messages, of at most `limit` bytes, which go to the disk when they are asked for.
    held: Option<Arc<Mutex<SnapshotBuffer>>>,
    failure: Arc<Mutex<Option<String>>>,
}

impl Queue {
    /// Hands a message over; false where there is no room for it. Topics and counts, which are few, always find room.
    /// In snapshot mode a message always does: the oldest make room.
    ///
    /// # Errors
    /// Where the bag can no longer be written (a full disk).
    pub fn offer(&self, entry: Entry) -> Result<bool> {
        let bytes = entry.bytes();
        if let (Entry::Message { .. }, Some(held)) = (&entry, &self.held) {
            let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
            held.bytes += bytes;
            held.messages.push_back(entry);
            while held.bytes > self.limit
                && held.messages.len() > 1
                && let Some(oldest) = held.messages.pop_front()
            {
                held.bytes -= oldest.bytes();
                held.keep(&oldest);
            }
            return Ok(true);
        }
        if let (Entry::Topic { name, qos, .. }, Some(held)) = (&entry, &self.held)
            && (qos.durability == Durability::TransientLocal || known_qos(name).is_some())
        {
            let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
            held.latched_topics.insert(Arc::clone(name));
        }
        let waiting = self.waiting.fetch_add(bytes, Ordering::Relaxed);
        if bytes > 0 && waiting > 0 && waiting.saturating_add(bytes) > self.limit {
            self.waiting.fetch_sub(bytes, Ordering::Relaxed);
            return Ok(false);
        }
        self.queue.send(entry).map_err(|_| self.failure())?;
        Ok(true)
    }

    /// Hands over what is held; false where nothing is held back, or what was before is not on the disk yet: so that
    /// there are never more than two such buffers.
    ///
    /// # Errors
    /// Where the bag can no longer be written.
    pub fn take_snapshot(&self) -> Result<bool> {
        let Some(held) = &self.held else {
            return Ok(false);
        };
        if self.waiting.load(Ordering::Relaxed) > 0 {
            return Ok(false);
        }
        let taken = held.lock().unwrap_or_else(PoisonError::into_inner).take();
        let bytes = taken.iter().map(Entry::bytes).sum();
        self.waiting.fetch_add(bytes, Ordering::Relaxed);
        for entry in taken {
            self.queue.send(entry).map_err(|_| self.failure())?;
        }
        Ok(true)
    }

    fn failure(&self) -> anyhow::Error {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        anyhow!(
            "the bag cannot be written: {}",
            failure.as_deref().unwrap_or("its thread has ended")
        )
    }
}

impl Entry {
    fn bytes(&self) -> usize {
        match self {
            // What it costs to keep a message, however short.
            Self::Message { data, .. } => size_of::<Self>() + data.len(),
            Self::Topic { .. } | Self::Lost { .. } | Self::Split => 0,
        }
    }
}

impl Recording {
    /// Creates the bag. At most `cache_bytes` of messages wait for the disk, and in snapshot mode as many for being
    /// asked for. The thread that writes is `nice` steps below this one.
    ///
    /// # Errors
    /// Where the folder cannot be made, or holds something already.
    pub fn create(
        folder: &Path,
        options: WriterOptions,
        cache_bytes: usize,
        is_snapshot: bool,
        nice: i32,
    ) -> Result<Self> {
        let writer = BagWriter::create(folder, options)?;
        let (queue, entries) = mpsc::channel();
        let queue = Queue {
            queue,
            waiting: Arc::default(),
            limit: cache_bytes,
            held: is_snapshot.then(Arc::default),
            failure: Arc::default(),
        };
        let (writing, written) = oneshot::channel();
        let (waiting, failure) = (Arc::clone(&queue.waiting), Arc::clone(&queue.failure));
        let thread = std::thread::Builder::new()
            .name("bag".to_owned())
            .spawn(move || {
                // Linux has a priority for each thread, where POSIX has one for the process.
                if let Err(error) = rustix::process::nice(nice) {
                    tracing::warn!(
                        "cannot lower the priority; recording at the usual priority: {error}"
                    );
                }
                let result = write(writer, &entries, &waiting);
                if let Err(error) = &result {
                    *failure.lock().unwrap_or_else(PoisonError::into_inner) =
                        Some(format!("{error:#}"));
                }
                drop(writing);
                result
            })?;
        Ok(Self {
            queue: Some(queue),
            thread,
            written,
        })
    }

    /// The way to the thread; none once it is to end.
    pub fn queue(&self) -> Option<Queue> {
        self.queue.clone()
    }

    /// Lets the thread close the bag once every [`Queue`] is gone, and end.
    pub fn end(&mut self) {
        self.queue = None;
    }

    /// Waits until the bag is closed, after [`end`](Self::end). Cancel safe.
    pub async fn written(&mut self) {
        // it is closed, never sent to
        (&mut self.written).await.ok();
    }

    /// Closes the bag once every [`Queue`] is gone. Blocks until then.
    ///
    /// # Errors
    /// Where it could not be written.
    pub fn finish(mut self) -> Result<BagSummary> {
        self.end();
        match self.thread.join() {
            Ok(result) => result,
            Err(_) => bail!("the bag's thread panicked"),
        }
    }
}

fn write(
    mut writer: BagWriter,
    entries: &mpsc::Receiver<Entry>,
    waiting: &AtomicUsize,
) -> Result<BagSummary> {
    let mut definitions = Definitions::default();
    loop {
        // a chunk closes by the time of its messages; when none comes, it closes here
        let entry = match entries.recv_timeout(CHUNK_TIME) {
            Ok(entry) => entry,
            Err(mpsc::RecvTimeoutError::Timeout) => {
                writer.flush()?;
                continue;
            }
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                definitions.add_silent(&mut writer)?;
                return writer.finish().context("closing the bag");
            }
        };
        waiting.fetch_sub(entry.bytes(), Ordering::Relaxed);
        match entry {
            Entry::Topic {
                name,
                type_name,
                candidates,
                qos,
            } => definitions.announce(name, type_name, candidates, qos),
            Entry::Message {
                topic,
                log_time_ns,
                data,
            } => definitions.write(&mut writer, &topic, log_time_ns, &data)?,
            Entry::Lost { topic, messages } => writer.count_lost(&topic, messages),
            Entry::Split => writer.split()?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_bag::{BagReader, type_schema};
    use wm_msgs::std_msgs;

    #[test]
    fn what_is_queued_is_in_the_bag_and_losses_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let recording =
            Recording::create(&bag, WriterOptions::default(), CACHE_BYTES, false, 0).unwrap();
        let queue = recording.queue().unwrap();
        let topic: Arc<str> = "/note".into();
        let schema = type_schema::<std_msgs::String>();
        let type_name = "std_msgs/msg/String".to_owned();
        let entry = Entry::Topic {
            name: topic.clone(),
            type_name,
            candidates: vec![schema],
            qos: QosProfile::latched(),
        };
        assert!(queue.offer(entry).unwrap());
        let data = Bytes::from(
            wm_msgs::cdr::to_bytes(&std_msgs::String {
                data: "hello".to_owned(),
            })
            .unwrap(),
        );
        queue
            .offer(Entry::Message {
                topic: topic.clone(),
                log_time_ns: 7,
                data: data.clone(),
            })
            .unwrap();
        queue.offer(Entry::Lost { topic, messages: 3 }).unwrap();
        drop(queue);
        let summary = recording.finish().unwrap();
        assert_eq!(summary.lost.get("/note"), Some(&3));
        let reader = BagReader::open(&bag).unwrap();
        assert_eq!(
            reader.topic("/note").unwrap().qos(),
            Some(QosProfile::latched())
        );
        let messages: Vec<_> = reader.messages().map(|message| message.unwrap()).collect();
        assert_eq!(
            (messages.len(), messages[0].log_time_ns, &messages[0].data),
            (1, 7, &data)
        );
    }

    #[test]
    fn waiting_messages_are_bounded_in_bytes() {
        let (queue, entries) = mpsc::channel();
        let queue = Queue {
            queue,
            waiting: Arc::default(),
            limit: 256 << 10,
            held: None,
            failure: Arc::default(),
        };
        let message = |bytes: usize| Entry::Message {
            topic: "/camera".into(),
            log_time_ns: 0,
            data: vec![0; bytes].into(),
        };
        let offered = |bytes| queue.offer(message(bytes)).unwrap();
        let taken = (0..10).filter(|_| offered(64 << 10)).count();
        assert_eq!(taken, 3, "a fourth would exceed the limit by its own cost");
        let waiting = queue.waiting.load(Ordering::Relaxed);
        for entry in entries.iter().take(taken) {
            queue.waiting.fetch_sub(entry.bytes(), Ordering::Relaxed);
        }
        assert!(waiting <= queue.limit);
        assert!(offered(1 << 20), "a message that is larger waits alone");
        assert!(!offered(1));
        drop(entries);
        assert!(
            queue
                .offer(Entry::Lost {
                    topic: "/camera".into(),
                    messages: 1
                })
                .is_err()
        );
    }

    #[tokio::test(flavor = "current_thread")]
    async fn a_snapshot_writes_the_latest_that_fit_and_a_split_begins_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut recording =
            Recording::create(&bag, WriterOptions::default(), 64 << 10, true, 0).unwrap();
        let queue = recording.queue().unwrap();
        let topic: Arc<str> = "/note".into();
        let entry = Entry::Topic {
            name: topic.clone(),
            type_name: "std_msgs/msg/String".to_owned(),
            candidates: vec![type_schema::<std_msgs::String>()],
            qos: QosProfile::reliable(),
        };
        queue.offer(entry).unwrap();
        let note = std_msgs::String {
            data: "x".repeat(10 << 10),
        };
        let data = Bytes::from(wm_msgs::cdr::to_bytes(&note).unwrap());
        let offer = |log_time_ns: u64| {
            let (topic, data) = (topic.clone(), data.clone());
            let message = Entry::Message {
                topic,
                log_time_ns,
                data,
            };
            assert!(queue.offer(message).unwrap());
        };
        (1..=100).for_each(offer);
        assert!(queue.take_snapshot().unwrap());
        while queue.waiting.load(Ordering::Relaxed) > 0 {
            tokio::task::yield_now().await;
        }
        queue.offer(Entry::Split).unwrap();
        (101..=102).for_each(offer);
        assert!(queue.take_snapshot().unwrap());
        offer(103);
        drop(queue);
        recording.end();
        recording.written().await;
        let summary = recording.finish().unwrap();
        assert_eq!(summary.files.len(), 2);
        let reader = BagReader::open(&bag).unwrap();
        let times: Vec<u64> = reader.messages().map(|m| m.unwrap().log_time_ns).collect();
        // six of 10 KiB fit into 64 KiB; the one after the last snapshot was not asked for
        assert_eq!(times, [95, 96, 97, 98, 99, 100, 101, 102]);
    }

    #[test]
    fn a_snapshot_begins_with_the_latched_messages() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let recording =
            Recording::create(&bag, WriterOptions::default(), 64 << 10, true, 0).unwrap();
        let queue = recording.queue().unwrap();
        for (name, qos) in [
            ("/tf_static", QosProfile::latched()),
            ("/task/instruction", QosProfile::reliable()),
            ("/note", QosProfile::reliable()),
        ] {
            let entry = Entry::Topic {
                name: name.into(),
                type_name: "std_msgs/msg/String".to_owned(),
                candidates: vec![type_schema::<std_msgs::String>()],
                qos,
            };
            queue.offer(entry).unwrap();
        }
        let offer = |topic: &str, text: &str, log_time_ns: u64| {
            let text = std_msgs::String {
                data: text.to_owned(),
            };
            let data = wm_msgs::cdr::to_bytes(&text).unwrap().into();
            let topic = topic.into();
            let message = Entry::Message {
                topic,
                log_time_ns,
                data,
            };
            assert!(queue.offer(message).unwrap());
        };
        offer("/tf_static", "base", 1);
        offer("/tf_static", "camera", 2);
        offer("/task/instruction", "push", 3);
        let long = "x".repeat(10 << 10);
        (4..=40).for_each(|time| offer("/note", &long, time));
        assert!(queue.take_snapshot().unwrap());
        while queue.waiting.load(Ordering::Relaxed) > 0 {
            std::thread::yield_now();
        }
        offer("/task/instruction", "pull", 50);
        offer("/note", "last", 60);
        assert!(queue.take_snapshot().unwrap());
        drop(queue);
        recording.finish().unwrap();
        let reader = BagReader::open(&bag).unwrap();
        let latched: Vec<(u64, String)> = reader
            .messages()
            .map(Result::unwrap)
            .filter(|message| &*message.topic != "/note")
            .map(|m| (m.log_time_ns, m.decode::<std_msgs::String>().unwrap().data))
            .collect();
        let row = |time: u64, text: &str| (time, text.to_owned());
        assert_eq!(
            latched,
            [
                row(35, "push"),
                row(35, "base"),
                row(35, "camera"),
                row(50, "push"),
                row(50, "base"),
                row(50, "camera"),
                row(50, "pull"),
            ]
        );
    }
}
