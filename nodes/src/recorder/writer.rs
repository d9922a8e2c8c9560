//! The bag's thread: messages from a bounded queue into a [`BagWriter`].

use anyhow::{Context as _, Result, anyhow, bail};
use bytes::Bytes;
use std::path::{Path, PathBuf};
use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicUsize, Ordering},
    mpsc,
};
use std::thread::JoinHandle;
use std::time::Duration;
use wm_bag::{BagSummary, BagWriter, QosProfile, Schema, WriterOptions};

/// Messages that may wait for the disk.
const QUEUE: usize = 256;

/// Bytes of messages that may wait for the disk: forty raw 1080p pictures.
const QUEUE_BYTES: usize = 256 << 20;

/// A chunk is closed after this much time at the latest: what a killed recorder may lose.
const CHUNK_TIME: Duration = Duration::from_secs(1);

/// What the node sends to the bag's thread.
pub(super) enum Entry {
    /// A topic that is recorded from now on.
    Topic {
        name: Arc<str>,
        type_name: String,
        schema: Schema,
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
}

/// The bag's thread.
pub(super) struct Recording {
    queue: Queue,
    thread: JoinHandle<Result<BagSummary>>,
}

/// The way to the bag's thread.
#[derive(Clone)]
pub(super) struct Queue {
    queue: mpsc::SyncSender<Entry>,
    /// Bytes of the messages that wait.
    waiting: Arc<AtomicUsize>,
    failure: Arc<Mutex<Option<String>>>,
}

impl Queue {
    /// Hands an entry over; false where the queue is full.
    ///
    /// # Errors
    /// Where the bag can no longer be written (a full disk).
    pub fn offer(&self, entry: Entry) -> Result<bool> {
        let bytes = entry.bytes();
        if self.waiting.fetch_add(bytes, Ordering::Relaxed) > QUEUE_BYTES {
            self.waiting.fetch_sub(bytes, Ordering::Relaxed);
            return Ok(false);
        }
        match self.queue.try_send(entry) {
            Ok(()) => Ok(true),
            Err(mpsc::TrySendError::Full(_)) => {
                self.waiting.fetch_sub(bytes, Ordering::Relaxed);
                Ok(false)
            }
            Err(mpsc::TrySendError::Disconnected(_)) => Err(self.failure()),
        }
    }

    /// Hands an entry over, and waits until there is room: not for an async context.
    ///
    /// # Errors
    /// As [`Self::offer`].
    pub fn put(&self, entry: Entry) -> Result<()> {
        self.waiting.fetch_add(entry.bytes(), Ordering::Relaxed);
        self.queue.send(entry).map_err(|_| self.failure())
    }

    fn failure(&self) -> anyhow::Error {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        anyhow!(
            "the bag cannot be written: {}",
            failure.as_deref().unwrap_or_default()
        )
    }
}

impl Entry {
    fn bytes(&self) -> usize {
        match self {
            Self::Message { data, .. } => data.len(),
            Self::Topic { .. } | Self::Lost { .. } => 0,
        }
    }
}

impl Recording {
    /// Creates the bag.
    ///
    /// # Errors
    /// Where the folder cannot be made, or holds something already.
    pub fn create(folder: &Path) -> Result<Self> {
        let options = WriterOptions {
            chunk_duration: Some(CHUNK_TIME),
            ..WriterOptions::default()
        };
        let writer = BagWriter::create(folder, options)?;
        let (queue, entries) = mpsc::sync_channel(QUEUE);
        let queue = Queue {
            queue,
            waiting: Arc::default(),
            failure: Arc::default(),
        };
        let (waiting, failure) = (Arc::clone(&queue.waiting), Arc::clone(&queue.failure));
        let thread = std::thread::Builder::new()
            .name("bag".to_owned())
            .spawn(move || {
                let result = write(writer, &entries, &waiting);
                if let Err(error) = &result {
                    *failure.lock().unwrap_or_else(PoisonError::into_inner) =
                        Some(format!("{error:#}"));
                }
                result
            })?;
        Ok(Self { queue, thread })
    }

    pub fn queue(&self) -> Queue {
        self.queue.clone()
    }

    /// Closes the bag once every [`Queue`] is gone.
    ///
    /// # Errors
    /// Where it could not be written.
    pub fn finish(self) -> Result<BagSummary> {
        drop(self.queue);
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
    let mut types = std::collections::HashMap::new();
    loop {
        // a chunk closes by the time of its messages; when none comes, it closes here
        let entry = match entries.recv_timeout(CHUNK_TIME) {
            Ok(entry) => entry,
            Err(mpsc::RecvTimeoutError::Timeout) => {
                writer.flush()?;
                continue;
            }
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                return writer.finish().context("closing the bag");
            }
        };
        waiting.fetch_sub(entry.bytes(), Ordering::Relaxed);
        match entry {
            Entry::Topic {
                name,
                type_name,
                schema,
                qos,
            } => {
                writer.add_topic_raw(&name, &type_name, &schema, &qos.to_yaml())?;
                types.insert(name, (type_name, schema));
            }
            Entry::Message {
                topic,
                log_time_ns,
                data,
            } => {
                if let Some((type_name, schema)) = types.get(&topic) {
                    writer.write_raw(&topic, type_name, schema, log_time_ns, &data)?;
                }
            }
            Entry::Lost { topic, messages } => writer.count_lost(&topic, messages),
        }
    }
}

/// Removes the bag in `folder`, where there is one and nothing else with it.
///
/// # Errors
/// Where the folder holds anything but a bag, or cannot be changed.
pub(super) fn remove_old(folder: &Path) -> Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| format!("folder {}", folder.display())),
    };
    let paths = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::io::Result<Vec<PathBuf>>>()?;
    let is_part_of_bag = |path: &PathBuf| {
        path.is_file()
            && (path
                .extension()
                .is_some_and(|extension| extension == "mcap")
                || path.file_name().is_some_and(|name| name == "metadata.yaml"))
    };
    if let Some(stranger) = paths.iter().find(|path| !is_part_of_bag(path)) {
        bail!(
            "will not overwrite {}: it holds {}, which is no part of a bag",
            folder.display(),
            stranger.display()
        );
    }
    for path in paths {
        std::fs::remove_file(&path).with_context(|| format!("removing {}", path.display()))?;
    }
    Ok(())
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
        let recording = Recording::create(&bag).unwrap();
        let queue = recording.queue();
        let topic: Arc<str> = "/note".into();
        let schema = type_schema::<std_msgs::String>();
        let type_name = "std_msgs/msg/String".to_owned();
        let entry = Entry::Topic {
            name: topic.clone(),
            type_name,
            schema,
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
        let (queue, entries) = mpsc::sync_channel(QUEUE);
        let queue = Queue {
            queue,
            waiting: Arc::default(),
            failure: Arc::default(),
        };
        let large = || Entry::Message {
            topic: "/camera".into(),
            log_time_ns: 0,
            data: Bytes::from_static(&[0; 64 << 20]),
        };
        let taken = (0..10).filter(|_| queue.offer(large()).unwrap()).count();
        assert_eq!(taken, 5, "what exceeds the limit is the last that is taken");
        assert_eq!(entries.iter().take(taken).count(), taken);
    }

    #[test]
    fn only_a_bag_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        remove_old(&bag).unwrap();
        Recording::create(&bag).unwrap().finish().unwrap();
        remove_old(&bag).unwrap();
        assert_eq!(std::fs::read_dir(&bag).unwrap().count(), 0);
        std::fs::write(bag.join("thesis.txt"), "x").unwrap();
        std::fs::write(bag.join("a.mcap"), "x").unwrap();
        assert!(
            remove_old(&bag)
                .unwrap_err()
                .to_string()
                .contains("thesis.txt")
        );
        assert!(bag.join("a.mcap").exists());
    }
}
