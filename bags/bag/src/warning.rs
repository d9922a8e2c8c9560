use std::{
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use crate::{
    decoding::Fields,
    reader::times::{Stretch, Times, main_part},
    summary::Instant,
};

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
        /// Damaged places without a warning of their own.
        places: u64,
    },
    /// More chunks and messages are left out of a copy than are named one by one.
    MoreSkipped {
        /// How many.
        count: u64,
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
    /// The summary differs from the messages; the messages count.
    WrongSummary {
        /// The file.
        file: PathBuf,
        /// What differs.
        reason: String,
    },
    /// A channel that cannot be read is left out.
    ChannelSkipped {
        /// The file.
        file: PathBuf,
        /// The topic.
        topic: String,
        /// Its messages.
        messages: u64,
        /// Why.
        reason: String,
    },
    /// The bag's definition of a type has other fields than this version's; fields are matched by name.
    OtherFields {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// Fields that the bag lacks; they have default values.
        missing: Vec<String>,
        /// Fields that this version's type lacks; they are not read.
        dropped: Vec<String>,
    },
    /// The bag's definition of a type does not fit this version's: its messages are copied and played, not decoded.
    Undecodable {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// What does not fit.
        reason: String,
    },
    /// The bag's definition of a type cannot be understood: messages are decoded as this version's type if they have
    /// exactly its length.
    UnreadableDefinition {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// The fault of the definition.
        reason: String,
    },
    /// A file that was compressed as a whole was decompressed for reading.
    Decompressed {
        /// The compressed file.
        file: PathBuf,
        /// The folder of the temporary file.
        folder: PathBuf,
        /// Size of the temporary file.
        bytes: u64,
    },
    /// The end of a compressed file is damaged or missing.
    CompressedEnd {
        /// The compressed file.
        file: PathBuf,
        /// Bytes that were decompressed.
        bytes: u64,
        /// What the decoder met.
        reason: String,
    },
    /// The recorder of an sqlite3 file was killed: a copy of the file takes over the journal.
    Journal {
        /// The file.
        file: PathBuf,
        /// The folder of the copy.
        folder: PathBuf,
        /// Size of the copy.
        bytes: u64,
    },
    /// A file is there in two forms (compressed and not, for example); this one is not read.
    Twice {
        /// The file.
        file: PathBuf,
    },
    /// A message is left out of a copy of the bag.
    MessageSkipped(String),
    /// Messages of a topic are left out of a converted bag.
    Omitted {
        /// The topic in the old bag.
        topic: String,
        /// How many.
        messages: u64,
        /// Why.
        reason: String,
    },
    /// A file that `metadata.yaml` lists is missing.
    MissingFile {
        /// The bag.
        dir: PathBuf,
        /// The file.
        file: PathBuf,
    },
    /// Messages are more than a day from most others.
    Apart {
        /// The bag.
        path: PathBuf,
        /// How many.
        messages: u64,
        /// The first and the last log time of all messages, in ns.
        all_ns: (u64, u64),
        /// Those of the recording itself.
        main_ns: (u64, u64),
    },
    /// Stretches without a message.
    Gaps {
        /// The bag.
        path: PathBuf,
        /// How many.
        gaps: u64,
        /// Log times before and after the longest, in ns.
        longest_ns: (u64, u64),
    },
    /// The log times step back, in the order in which messages were written.
    StepsBack {
        /// The bag.
        path: PathBuf,
        /// How often.
        steps: u64,
        /// Log times before and after the first step, in ns.
        first_ns: (u64, u64),
    },
    /// All messages have the same log time.
    OneTime {
        /// The bag.
        path: PathBuf,
        /// The time, in ns.
        log_time_ns: u64,
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

/// Fewer messages than this may have one log time without a fault.
const MANY: u64 = 10;

impl BagWarning {
    /// Whether messages that were in the bag cannot be read any more.
    #[must_use]
    pub fn is_loss(&self) -> bool {
        matches!(
            self,
            Self::Truncated { .. }
                | Self::Damaged { .. }
                | Self::MoreDamaged { .. }
                | Self::MoreSkipped { .. }
                | Self::CompressedEnd { .. }
                | Self::MessageSkipped(_)
                | Self::Omitted { .. }
                | Self::MissingFile { .. }
        )
    }

    /// The warning about the fields of a channel's type, if they differ.
    pub(crate) fn of_fields(topic: &str, type_name: &str, fields: &Fields) -> Option<Self> {
        let (topic, type_name) = (topic.to_owned(), type_name.to_owned());
        match fields {
            Fields::Same | Fields::Unknown => None,
            Fields::Mapped(mapping) => {
                let (missing, dropped) = (mapping.missing().to_vec(), mapping.dropped().to_vec());
                let differs = !missing.is_empty() || !dropped.is_empty();
                differs.then_some(Self::OtherFields {
                    topic,
                    type_name,
                    missing,
                    dropped,
                })
            }
            Fields::Refused(reason) => Some(Self::Undecodable {
                topic,
                type_name,
                reason: reason.clone(),
            }),
            Fields::Unreadable(error) => Some(Self::UnreadableDefinition {
                topic,
                type_name,
                reason: error.to_string(),
            }),
        }
    }

    /// The warnings about log times.
    pub(crate) fn of_times(path: &Path, times: &Times, stretches: &[Stretch]) -> Vec<Self> {
        let path = || path.to_owned();
        let mut warnings = Vec::new();
        let (Some(first), Some(last)) = (stretches.first(), stretches.last()) else {
            return warnings;
        };
        let total: u64 = stretches.iter().map(|stretch| stretch.messages).sum();
        if first.start_ns == last.end_ns && total >= MANY {
            warnings.push(Self::OneTime {
                path: path(),
                log_time_ns: first.start_ns,
            });
        }
        let main = main_part(stretches);
        if let Some((main, messages @ 1..)) = main {
            warnings.push(Self::Apart {
                path: path(),
                messages,
                all_ns: (first.start_ns, last.end_ns),
                main_ns: (main.start_ns, main.end_ns),
            });
        }
        // Gaps to messages outside the recording are part of the warning above.
        let is_within = |stretch: &&Stretch| {
            main.is_none_or(|(main, _)| {
                main.start_ns <= stretch.start_ns && stretch.end_ns <= main.end_ns
            })
        };
        let within = || stretches.iter().filter(is_within);
        let gaps = within().zip(within().skip(1));
        let gaps = gaps.map(|(one, next)| (one.end_ns, next.start_ns));
        if let Some(longest_ns) = gaps.clone().max_by_key(|(end, start)| start - end) {
            warnings.push(Self::Gaps {
                path: path(),
                gaps: gaps.count() as u64,
                longest_ns,
            });
        }
        if let (steps, Some(step)) = times.steps_back() {
            warnings.push(Self::StepsBack {
                path: path(),
                steps,
                first_ns: (step.from_ns, step.to_ns),
            });
        }
        warnings
    }
}

/// Seconds between two log times.
fn seconds((from_ns, to_ns): (u64, u64)) -> f64 {
    Duration::from_nanos(to_ns.abs_diff(from_ns)).as_secs_f64()
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
            Self::MoreSkipped { count } => {
                write!(f, "{count} more chunks or messages are left out")
            }
            Self::NoMetadata { dir } => {
                write!(
                    f,
                    "{} has no metadata.yaml: its files are read in the order of their names",
                    dir.display()
                )
            }
            Self::BadMetadata { file, reason } => {
                write!(
                    f,
                    "{} is damaged ({reason}): the files beside it are read in the order of their names",
                    file.display()
                )
            }
            Self::WrongSummary { file, reason } => {
                let file = file.display();
                write!(
                    f,
                    "{file} has a wrong summary ({reason}); the messages themselves are read"
                )
            }
            Self::ChannelSkipped {
                file,
                topic,
                messages,
                reason,
            } => write!(
                f,
                "{}: channel {topic} with {messages} message(s) is left out: {reason}",
                file.display()
            ),
            Self::OtherFields {
                topic,
                type_name,
                missing,
                dropped,
            } => {
                write!(
                    f,
                    "{topic}: the bag's {type_name} has other fields than this version's"
                )?;
                if !missing.is_empty() {
                    write!(f, "; missing, set to defaults: {}", missing.join(", "))?;
                }
                if !dropped.is_empty() {
                    write!(f, "; not read: {}", dropped.join(", "))?;
                }
                Ok(())
            }
            Self::Undecodable {
                topic,
                type_name,
                reason,
            } => write!(
                f,
                "{topic}: messages are not decoded, because the bag's {type_name} does not fit this version's: {reason}"
            ),
            Self::UnreadableDefinition {
                topic,
                type_name,
                reason,
            } => write!(
                f,
                "{topic}: the bag's definition of {type_name} cannot be understood ({reason}); messages are decoded as \
                 this version's type if they have its length"
            ),
            Self::Decompressed {
                file,
                folder,
                bytes,
            } => write!(
                f,
                "{} is compressed: read from a temporary file of {bytes} bytes in {}",
                file.display(),
                folder.display()
            ),
            Self::CompressedEnd {
                file,
                bytes,
                reason,
            } => write!(
                f,
                "{} is damaged or ends early ({reason}): read up to byte {bytes} of what it compresses",
                file.display()
            ),
            Self::Journal {
                file,
                folder,
                bytes,
            } => write!(
                f,
                "{} has a journal, because its recorder was killed: read from a copy of {bytes} bytes in {}",
                file.display(),
                folder.display()
            ),
            Self::Twice { file } => write!(
                f,
                "{} is not read: the same file is there in another form",
                file.display()
            ),
            Self::MessageSkipped(reason) => write!(f, "a message is left out: {reason}"),
            Self::Omitted {
                topic,
                messages,
                reason,
            } => write!(f, "{topic}: {messages} message(s) are left out: {reason}"),
            Self::MissingFile { dir, file } => write!(
                f,
                "{}: metadata.yaml lists {}, which does not exist; the other files are read",
                dir.display(),
                file.display()
            ),
            Self::Apart {
                path,
                messages,
                all_ns,
                main_ns,
            } => write!(
                f,
                "{}: {messages} message(s) were logged more than a day before or after the others: all from {} to {}, the \
                 recording itself from {} to {}; offsets count from there",
                path.display(),
                Instant(all_ns.0),
                Instant(all_ns.1),
                Instant(main_ns.0),
                Instant(main_ns.1)
            ),
            Self::Gaps {
                path,
                gaps,
                longest_ns,
            } => write!(
                f,
                "{}: {gaps} gap(s) of more than 10 s without a message, the longest of {:.3} s after {}",
                path.display(),
                seconds(*longest_ns),
                Instant(longest_ns.0)
            ),
            Self::StepsBack {
                path,
                steps,
                first_ns,
            } => write!(
                f,
                "{}: log times step back {steps} time(s), first by {:.3} s from {} to {}; messages are read in the order of \
                 log times",
                path.display(),
                seconds(*first_ns),
                Instant(first_ns.0),
                Instant(first_ns.1)
            ),
            Self::OneTime { path, log_time_ns } => write!(
                f,
                "{}: all messages have the log time {}",
                path.display(),
                Instant(*log_time_ns)
            ),
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
