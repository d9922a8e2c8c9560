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

/// Default of `max_cache_size` \[byte\]: forty raw 1080p pictures.
pub(super) const CACHE_BYTES: usize = 256 << 20;

/// Longest duration of a chunk: a killed recorder loses at most one chunk.
pub(super) const CHUNK_TIME: Duration = Duration::from_secs(1);

/// Longest time until a finished chunk is on the disk. A power cut loses at most this and the open chunk.
pub(super) const SYNC_INTERVAL: Duration = Duration::from_secs(5);

/// An entry of the bag's queue.
pub(super) enum Entry {
    /// A topic; it precedes its messages.
    Topic {
        name: Arc<str>,
        type_name: String,
        /// Possible definitions of the publisher.
        candidates: Vec<Schema>,
        qos: QosProfile,
    },
    /// A message of a topic.
    Message {
        topic: Arc<str>,
        log_time_ns: u64,
        data: Bytes,
    },
    /// Number of lost messages of a topic.
    Lost { topic: Arc<str>, messages: u64 },
    /// Start of the bag's next file.
    Split,
}

/// An open bag with the thread that writes it.
pub(super) struct Recording {
    /// `None` after [`end`](Self::end).
    queue: Option<Queue>,
    thread: JoinHandle<Result<BagSummary>>,
    /// Closes when the thread has written all entries.
    written: oneshot::Receiver<()>,
}

/// Messages that wait for a call of `~/snapshot`.
#[derive(Default)]
struct SnapshotBuffer {
    messages: VecDeque<Entry>,
    bytes: usize,
    latched_topics: HashSet<Arc<str>>,
    /// Valid latched messages that have left the buffer.
    latched: LatchedMessages<Bytes>,
}

impl SnapshotBuffer {
    /// Keeps a latched message that leaves the buffer.
    fn keep(&mut self, entry: &Entry) {
        if let Entry::Message { topic, data, .. } = entry
            && self.latched_topics.contains(topic)
        {
            self.latched.add(topic, data, data.clone());
        }
    }

    /// Empties the buffer. The latched messages that were valid at its first message come first.
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

/// The queue of the bag's thread.
#[derive(Clone)]
pub(super) struct Queue {
    // Bounded by bytes, which the channel cannot count.
    queue: mpsc::Sender<Entry>,
    /// Bytes of the messages in the queue.
    waiting: Arc<AtomicUsize>,
    /// Most bytes in the queue. A larger message is accepted by an empty queue.
    limit: usize,
    /// In snapshot mode: the latest messages, of at most `limit` bytes.
    snapshot: Option<Arc<Mutex<SnapshotBuffer>>>,
    failure: Arc<Mutex<Option<String>>>,
}

impl Queue {
    /// Adds an entry; returns false if the queue is full. Topics and counts are few and always accepted. In snapshot
    /// mode, messages are always accepted, and the oldest are dropped.
    ///
    /// # Errors
    /// The bag can no longer be written (a full disk).
    pub fn offer(&self, entry: Entry) -> Result<bool> {
        let bytes = entry.bytes();
        if let (Entry::Message { .. }, Some(snapshot)) = (&entry, &self.snapshot) {
            let mut snapshot = snapshot.lock().unwrap_or_else(PoisonError::into_inner);
            snapshot.bytes += bytes;
            snapshot.messages.push_back(entry);
            while snapshot.bytes > self.limit
                && snapshot.messages.len() > 1
                && let Some(oldest) = snapshot.messages.pop_front()
            {
                snapshot.bytes -= oldest.bytes();
                snapshot.keep(&oldest);
            }
            return Ok(true);
        }
        if let (Entry::Topic { name, qos, .. }, Some(snapshot)) = (&entry, &self.snapshot)
            && (qos.durability == Durability::TransientLocal || known_qos(name).is_some())
        {
            let mut snapshot = snapshot.lock().unwrap_or_else(PoisonError::into_inner);
            snapshot.latched_topics.insert(Arc::clone(name));
        }
        let waiting = self.waiting.fetch_add(bytes, Ordering::Relaxed);
        if bytes > 0 && waiting > 0 && waiting.saturating_add(bytes) > self.limit {
            self.waiting.fetch_sub(bytes, Ordering::Relaxed);
            return Ok(false);
        }
        self.queue.send(entry).map_err(|_| self.failure())?;
        Ok(true)
    }

    /// Moves the snapshot buffer to the queue. Returns false without snapshot mode, and while the previous snapshot is
    /// not on the disk, so that at most two buffers are in memory.
    ///
    /// # Errors
    /// The bag can no longer be written.
    pub fn take_snapshot(&self) -> Result<bool> {
        let Some(snapshot) = &self.snapshot else {
            return Ok(false);
        };
        if self.waiting.load(Ordering::Relaxed) > 0 {
            return Ok(false);
        }
        let taken = snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
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
            // Memory of a message, however short.
            Self::Message { data, .. } => size_of::<Self>() + data.len(),
            Self::Topic { .. } | Self::Lost { .. } | Self::Split => 0,
        }
    }
}

impl Recording {
    /// Creates the bag and its thread, whose priority is `nice` steps lower. At most `cache_bytes` of messages wait for
    /// the disk, and in snapshot mode as many for a snapshot.
    ///
    /// # Errors
    /// The folder cannot be created, or is not empty.
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
            snapshot: is_snapshot.then(Arc::default),
            failure: Arc::default(),
        };
        let (writing, written) = oneshot::channel();
        let (waiting, failure) = (Arc::clone(&queue.waiting), Arc::clone(&queue.failure));
        let thread = std::thread::Builder::new()
            .name("bag".to_owned())
            .spawn(move || {
                // Linux has a priority for each thread; POSIX has one for the process.
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

    /// The queue; `None` after [`end`](Self::end).
    pub fn queue(&self) -> Option<Queue> {
        self.queue.clone()
    }

    /// Drops its own queue. The thread closes the bag when all queues are dropped.
    pub fn end(&mut self) {
        self.queue = None;
    }

    /// Waits until the bag is closed, after [`end`](Self::end). Cancel safe.
    pub async fn wait_until_written(&mut self) {
        // The sender is dropped without a message.
        (&mut self.written).await.ok();
    }

    /// Blocks until all queues are dropped and the bag is closed.
    ///
    /// # Errors
    /// The bag could not be written.
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
        // New messages close a chunk by their time. Without messages, this timeout closes it.
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
            snapshot: None,
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
    async fn snapshot_writes_the_latest_and_split_starts_a_file() {
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
        recording.wait_until_written().await;
        let summary = recording.finish().unwrap();
        assert_eq!(summary.files.len(), 2);
        let reader = BagReader::open(&bag).unwrap();
        let times: Vec<u64> = reader.messages().map(|m| m.unwrap().log_time_ns).collect();
        // 64 KiB hold six messages of 10 KiB. The one after the last snapshot is not written.
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
