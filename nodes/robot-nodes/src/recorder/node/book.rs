//! The bag that is being recorded, and the messages that were lost.

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

/// At most one open bag, and whether any has lost something.
#[derive(Default)]
pub(super) struct Book {
    recording: Option<Recording>,
    /// The bag that the first one replaces.
    replaced: Option<OldBag>,
    /// Of the open bag.
    pub losses: Losses,
    pub is_lossy: bool,
}

impl Book {
    /// Begins the first bag, where the user said.
    ///
    /// # Errors
    /// It cannot be made, or something already exists there.
    pub async fn begin_first(&mut self, options: &Options) -> Result<()> {
        let place = options.place.clone();
        let (folder, replaced) = tokio::task::spawn_blocking(move || place.first()).await??;
        self.replaced = replaced;
        self.begin(options, folder).await
    }

    /// Begins the bag that a peer requests, which is always a new one.
    ///
    /// # Errors
    /// It cannot be made, is not to be made there, or something already exists there.
    pub async fn begin_further(&mut self, options: &Options, uri: &str) -> Result<()> {
        let folder = options.place.asked_for(uri)?;
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

    /// The way to the open bag.
    pub fn queue(&self) -> Option<Queue> {
        self.recording.as_ref().and_then(Recording::queue)
    }

    /// Says in the bag what it lost, and lets it be closed.
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
    pub async fn written(&mut self) {
        if let Some(recording) = &mut self.recording {
            recording.written().await;
        }
    }

    /// Says on standard output what was recorded and lost. Blocks until the bag is closed.
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
