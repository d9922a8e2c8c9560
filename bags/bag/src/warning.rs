use std::{fmt, path::PathBuf};

/// Something about a bag that its user should know, although it can be read.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BagWarning {
    /// The file ends early: its recorder was killed, or a copy was cut short.
    Truncated {
        /// The file.
        file: PathBuf,
        /// Bytes after the last whole record, of which nothing is read.
        lost_bytes: u64,
    },
    /// The file's summary is absent or wrong although the file has an end; its records were scanned instead.
    NoSummary {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Part of the file is damaged; its messages are missing from the counts.
    Damaged {
        /// The file.
        file: PathBuf,
        /// Where the damaged record begins.
        offset: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// More of the file is damaged than is reported one by one.
    MoreDamaged {
        /// The file.
        file: PathBuf,
        /// Damaged places that are not told of.
        places: u64,
    },
    /// A directory without `metadata.yaml`; its `.mcap` files were taken by name.
    NoMetadata {
        /// The bag.
        dir: PathBuf,
    },
    /// `metadata.yaml` cannot be understood (it is empty after a power cut, for example); the `.mcap` files were taken by
    /// name.
    BadMetadata {
        /// The `metadata.yaml`.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// `metadata.yaml` counts other messages than the files hold.
    CountDiffers {
        /// The bag.
        dir: PathBuf,
        /// What `metadata.yaml` says.
        metadata: u64,
        /// What the files hold.
        files: u64,
    },
}

impl BagWarning {
    /// Whether messages that were in the bag cannot be read any more.
    #[must_use]
    pub fn is_loss(&self) -> bool {
        matches!(
            self,
            Self::Truncated { .. } | Self::Damaged { .. } | Self::MoreDamaged { .. }
        )
    }
}

impl fmt::Display for BagWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { file, lost_bytes } => write!(
                f,
                "{} is truncated: read up to its last whole chunk, {lost_bytes} bytes after it are lost",
                file.display()
            ),
            Self::NoSummary { file, reason } => {
                write!(
                    f,
                    "{} has no usable summary ({reason}); the whole file was scanned",
                    file.display()
                )
            }
            Self::Damaged {
                file,
                offset,
                reason,
            } => {
                write!(
                    f,
                    "{} is damaged at byte {offset}: {reason}",
                    file.display()
                )
            }
            Self::MoreDamaged { file, places } => {
                write!(
                    f,
                    "{} is also damaged in {places} other places",
                    file.display()
                )
            }
            Self::NoMetadata { dir } => {
                write!(
                    f,
                    "{} has no metadata.yaml: its .mcap files are read in the order of their names",
                    dir.display()
                )
            }
            Self::BadMetadata { file, reason } => {
                write!(
                    f,
                    "{} is damaged ({reason}): the .mcap files beside it are read in the order of their names",
                    file.display()
                )
            }
            Self::CountDiffers {
                dir,
                metadata,
                files,
            } => write!(
                f,
                "{}: metadata.yaml counts {metadata} messages, the files hold {files}",
                dir.display()
            ),
        }
    }
}
