use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

/// A part of a file that could not be recovered.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Loss {
    /// The file.
    pub file: PathBuf,
    /// First byte.
    pub offset: u64,
    /// Size in bytes.
    pub bytes: u64,
    /// Number of chunks that begin in it; a chunk behind a forged length is not counted.
    pub chunks: u64,
    /// The fault.
    pub reason: String,
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = if self.chunks > 0 { "chunk of " } else { "" };
        write!(
            f,
            "{}: {what}{} bytes at byte {}: {}",
            self.file.display(),
            self.bytes,
            self.offset,
            self.reason
        )
    }
}

/// Limit of losses with details, which bounds the memory.
const DETAILS_LIMIT: usize = 100;

/// The parts of a bag that could not be recovered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Losses {
    /// The first losses, in the order of the files.
    pub first: Vec<Loss>,
    /// Number of losses.
    pub places: u64,
    /// Lost bytes.
    pub bytes: u64,
    /// Lost chunks.
    pub chunks: u64,
    /// Undamaged messages that cannot be copied: their channel is undefined, has no type or an unknown encoding, or their time
    /// is past 2^63 - 1 ns.
    pub messages: u64,
    /// The part of `messages` whose channel is defined, by topic.
    pub by_topic: BTreeMap<String, u64>,
}

impl Losses {
    /// Whether nothing was lost.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.places == 0 && self.messages == 0
    }

    pub(super) fn add(&mut self, file: &Path, offset: u64, bytes: u64, chunks: u64, reason: &str) {
        self.places += 1;
        self.bytes += bytes;
        self.chunks += chunks;
        if self.first.len() < DETAILS_LIMIT {
            self.first.push(Loss {
                file: file.to_owned(),
                offset,
                bytes,
                chunks,
                reason: reason.to_owned(),
            });
        }
    }
}

impl fmt::Display for Losses {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return write!(f, "lost: nothing");
        }
        write!(
            f,
            "lost: {} bytes in {} place(s), including {} chunk(s)",
            self.bytes, self.places, self.chunks
        )?;
        for loss in &self.first {
            write!(f, "\n  {loss}")?;
        }
        if self.places > self.first.len() as u64 {
            let more = self.places - self.first.len() as u64;
            write!(f, "\n  and {more} more place(s)")?;
        }
        if self.messages > 0 {
            write!(
                f,
                "\nlost: {} message(s) whose channel is undefined, has no type or another encoding than CDR, or whose time is out of \
                 rosbag2's range",
                self.messages
            )?;
            for (topic, messages) in &self.by_topic {
                write!(f, "\n  {topic}: {messages}")?;
            }
        }
        Ok(())
    }
}
