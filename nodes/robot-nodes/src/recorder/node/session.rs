//! The bags of a recorder, one after the other, and their lost messages.

use crate::recorder::{
    losses::Losses,
    options::Options,
    place::OldBag,
    writer::{Entry, Queue, Recording},
};
use anyhow::Result;
use std::path::PathBuf;
use std::sync::Arc;
use tracing::info;

/// The open bag, if there is one, and the losses of all bags so far.
#[derive(Default)]
pub(super) struct Session {
    recording: Option<Recording>,
    /// The existing bag that is removed when the first new one is complete.
    replaced: Option<OldBag>,
    /// Losses of the open bag.
    pub losses: Losses,
    /// Whether any bag has lost messages.
    pub is_lossy: bool,
}

impl Session {
    /// Opens the first bag in the folder of the parameter `output`.
    ///
    /// # Errors
    /// The bag cannot be created, or the folder already exists.
    pub async fn begin_first(&mut self, options: &Options) -> Result<()> {
        let place = options.place.clone();
        let (folder, replaced) = tokio::task::spawn_blocking(move || place.first()).await??;
        self.replaced = replaced;
        self.begin(options, folder).await
    }

    /// Opens the bag that a peer requests by its `uri`. It never replaces an existing one.
    ///
    /// # Errors
    /// The bag cannot be created, is not allowed there, or already exists.
    pub async fn begin_further(&mut self, options: &Options, uri: &str) -> Result<()> {
        let folder = options.place.further(uri)?;
        self.begin(options, folder).await
    }

    async fn begin(&mut self, options: &Options, folder: PathBuf) -> Result<()> {
        let options = options.clone();
        let begin = move || -> Result<Recording> {
            let recording = Recording::create(
                &folder,
                options.writer,
                options.cache_bytes,
                options.is_snapshot,
                options.nice,
            )?;
            info!("recording to {}", folder.display());
            Ok(recording)
        };
        self.recording = Some(tokio::task::spawn_blocking(begin).await??);
        Ok(())
    }

    /// The queue of the open bag; `None` without one.
    pub fn queue(&self) -> Option<Queue> {
        self.recording.as_ref().and_then(Recording::queue)
    }

    /// Records the losses in the bag, and ends its thread once all queues are closed.
    ///
    /// # Errors
    /// The bag can no longer be written.
    pub fn end(&mut self) -> Result<()> {
        if let Some(queue) = self.queue() {
            for (topic, loss) in &self.losses {
                let (topic, messages) = (Arc::clone(topic), loss.total());
                if messages > 0 {
                    queue.offer(Entry::Lost { topic, messages })?;
                }
            }
        }
        if let Some(recording) = &mut self.recording {
            recording.end();
        }
        Ok(())
    }

    /// Waits until the bag is closed, after [`end`](Self::end).
    pub async fn wait_until_written(&mut self) {
        if let Some(recording) = &mut self.recording {
            recording.wait_until_written().await;
        }
    }

    /// Closes the bag, and prints the number of recorded and lost messages to standard output. Blocks until the bag is
    /// closed.
    ///
    /// # Errors
    /// The bag could not be written.
    pub fn close(&mut self) -> Result<()> {
        let Some(recording) = self.recording.take() else {
            return Ok(());
        };
        let summary = recording.finish()?;
        if let Some(old) = self.replaced.take() {
            old.give_way(summary.message_count);
        }
        let mut text = format!(
            "recorded {} message(s) of {} topic(s) to {}\n",
            summary.message_count,
            summary.topics.len(),
            summary.path.display()
        );
        for (topic, loss) in std::mem::take(&mut self.losses) {
            if loss.total() > 0 {
                text.push_str(&format!(
                    "lost {} message(s) of {topic}: {loss}\n",
                    loss.total()
                ));
                self.is_lossy = true;
            }
        }
        wm_ros::logging::print(text);
        Ok(())
    }
}
