//! The bag's messages, read ahead by a thread.

use std::sync::Arc;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use wm_bag::{BagError, BagMessage};

/// Most bytes that are read ahead. A larger message is read ahead alone.
const AHEAD_BYTES: u32 = 256 << 20;

/// Memory of a message without its data \[byte\].
const MESSAGE_BYTES: usize = 256;

/// A message with its share of the memory budget. Dropping it frees the share.
pub(super) struct BufferedMessage {
    pub message: Result<BagMessage, BagError>,
    _share: OwnedSemaphorePermit,
}

/// Messages of a bag. A thread reads them, so that the disk does not delay a message that is due. The thread ends when this
/// is dropped.
pub(super) struct Source {
    messages: mpsc::Receiver<BufferedMessage>,
    budget: Arc<Semaphore>,
}

impl Source {
    /// Starts the thread, which reads at most `queue_size` messages ahead. Call it in a tokio runtime.
    pub fn open(
        messages: impl Iterator<Item = Result<BagMessage, BagError>> + Send + 'static,
        queue_size: usize,
    ) -> Self {
        let (sender, receiver) = mpsc::channel(queue_size);
        let budget = Arc::new(Semaphore::new(AHEAD_BYTES as usize));
        let (shares, runtime) = (Arc::clone(&budget), Handle::current());
        tokio::task::spawn_blocking(move || {
            for message in messages {
                let bytes = message.as_ref().map_or(0, |message| message.data.len());
                // More than 4 GiB counts as 4 GiB, far above the queue's limit.
                let bytes = u32::try_from(bytes.saturating_add(MESSAGE_BYTES)).unwrap_or(u32::MAX);
                let share = Arc::clone(&shares).acquire_many_owned(bytes.min(AHEAD_BYTES));
                // Both fail if the player has dropped this source.
                let Ok(_share) = runtime.block_on(share) else {
                    break;
                };
                if sender
                    .blocking_send(BufferedMessage { message, _share })
                    .is_err()
                {
                    break;
                }
            }
        });
        Self {
            messages: receiver,
            budget,
        }
    }

    /// The next message; `None` at the end. Cancel safe.
    pub async fn next(&mut self) -> Option<BufferedMessage> {
        self.messages.recv().await
    }
}

impl Drop for Source {
    fn drop(&mut self) {
        self.budget.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_bag::{BagReader, BagWriter, WriterOptions};
    use wm_msgs::std_msgs;

    #[tokio::test(flavor = "current_thread")]
    async fn source_reads_at_most_queue_size_ahead() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag");
        let mut writer = BagWriter::create(&path, WriterOptions::default()).unwrap();
        for index in 0..50_u64 {
            let note = std_msgs::String {
                data: index.to_string(),
            };
            writer.write("/note", &note, index).unwrap();
        }
        writer.finish().unwrap();
        let reader = BagReader::open(&path).unwrap();

        let mut source = Source::open(reader.messages().starting_at(20), 4);
        let first = source.next().await.unwrap();
        assert_eq!(first.message.as_ref().unwrap().log_time_ns, 20);
        let bytes = first.message.as_ref().unwrap().data.len() + MESSAGE_BYTES;
        // Six messages take budget: one in the thread, four in the queue, and the first one.
        while source.messages.len() < 4 {
            tokio::task::yield_now().await;
        }
        let free = source.budget.available_permits();
        assert!(free >= AHEAD_BYTES as usize - 6 * (bytes + 8), "{free}");
        let mut count = 1;
        while source.next().await.is_some() {
            count += 1;
        }
        assert_eq!(count, 30);
        drop(first);
        assert_eq!(source.budget.available_permits(), AHEAD_BYTES as usize);
    }
}
