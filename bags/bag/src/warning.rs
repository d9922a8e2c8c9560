use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use crate::{
    decoding::FieldMatch,
    reader::times::{Stretch, Times, find_main_part},
    summary::Instant,
};

/// A fault of a bag that does not prevent reading it.
#[expect(missing_docs, reason = "fields are named after their content")]
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BagWarning {
    /// The file ends early: killed recorder or incomplete copy.
    #[error(
        "{file} is truncated: read up to its last whole chunk, {lost_bytes} bytes after it are lost"
    )]
    Truncated {
        file: PathBuf,
        /// Bytes after the last whole record, which are not read.
        lost_bytes: u64,
    },
    /// The summary is missing or invalid although the file is complete; its records were read instead.
    #[error("{file} has no usable summary ({reason}); the whole file was scanned")]
    NoSummary { file: PathBuf, reason: String },
    /// Part of the file is damaged; its messages are missing from the counts.
    #[error("{file} is damaged at byte {offset}: {reason}")]
    Damaged {
        file: PathBuf,
        offset: u64,
        reason: String,
    },
    /// Further damaged places of the file.
    #[error("{file} is also damaged in {places} other places")]
    MoreDamaged { file: PathBuf, places: u64 },
    /// Further chunks and messages that were not copied.
    #[error("{count} more chunks or messages are skipped")]
    MoreSkipped { count: u64 },
    /// A folder without `metadata.yaml`; its files were found by name.
    #[error("{dir} has no metadata.yaml: its files are read in the order of their names")]
    NoMetadata { dir: PathBuf },
    /// `metadata.yaml` is invalid (for example empty, after a power cut); the files were found by name.
    #[error(
        "{file} is damaged ({reason}): the files of its folder are read in the order of their names"
    )]
    BadMetadata { file: PathBuf, reason: String },
    /// The summary contradicts the messages, which are read.
    #[error("{file} has a wrong summary ({reason}); the messages themselves are read")]
    WrongSummary { file: PathBuf, reason: String },
    /// An unreadable channel was skipped.
    #[error("{file}: channel {topic} with {messages} message(s) is skipped: {reason}")]
    ChannelSkipped {
        file: PathBuf,
        topic: String,
        messages: u64,
        reason: String,
    },
    /// The bag's definition of a type has other fields than this version's; they are matched by name.
    #[error(
        "{topic}: the bag's {type_name} has other fields than this version's{}{}",
        list("missing, set to defaults", .missing),
        list("ignored", .dropped)
    )]
    OtherFields {
        topic: String,
        type_name: String,
        /// Fields that the bag lacks; they get default values.
        missing: Vec<String>,
        /// Fields that this version lacks; they are ignored.
        dropped: Vec<String>,
    },
    /// The bag's definition of a type does not fit this version's: messages can be copied and played, not decoded.
    #[error(
        "{topic}: messages are not decoded, because the bag's {type_name} does not fit this version's: {reason}"
    )]
    Undecodable {
        topic: String,
        type_name: String,
        reason: String,
    },
    /// The bag's definition of a type is invalid: messages are decoded as this version's type if they have exactly its
    /// length.
    #[error(
        "{topic}: the bag's definition of {type_name} is invalid ({reason}); messages are decoded as this version's type \
         if they have its length"
    )]
    UnreadableDefinition {
        topic: String,
        type_name: String,
        /// The fault of the definition.
        reason: String,
    },
    /// A compressed file was decompressed to a temporary file.
    #[error("{file} is compressed: read from a temporary file of {bytes} bytes in {folder}")]
    Decompressed {
        file: PathBuf,
        folder: PathBuf,
        bytes: u64,
    },
    /// The end of a compressed file is damaged or missing.
    #[error(
        "{file} is damaged or ends early ({reason}): its first {bytes} decompressed bytes are read"
    )]
    CompressedEnd {
        file: PathBuf,
        bytes: u64,
        reason: String,
    },
    /// The recorder of an sqlite3 file was killed: its journal was applied to a temporary copy.
    #[error(
        "{file} has a journal, because its recorder was killed: read from a copy of {bytes} bytes in {folder}"
    )]
    Journal {
        file: PathBuf,
        folder: PathBuf,
        bytes: u64,
    },
    /// Another form of this file (compressed, for example) was read instead.
    #[error("{file} is skipped: another form of the same file is read")]
    Twice { file: PathBuf },
    /// A message was not copied.
    #[error("a message is skipped: {0}")]
    MessageSkipped(String),
    /// Messages of a topic were not converted.
    #[error("{topic}: {messages} message(s) are skipped: {reason}")]
    Omitted {
        topic: String,
        messages: u64,
        reason: String,
    },
    /// A file that `metadata.yaml` lists is missing.
    #[error("{dir}: metadata.yaml lists {file}, which does not exist; the other files are read")]
    MissingFile { dir: PathBuf, file: PathBuf },
    /// Messages are more than a day from most others.
    #[error(
        "{path}: {messages} message(s) were logged more than a day before or after the others: all from {} to {}, the \
         recording itself from {} to {}; offsets count from there",
        Instant(.all_ns.0),
        Instant(.all_ns.1),
        Instant(.main_ns.0),
        Instant(.main_ns.1)
    )]
    Apart {
        path: PathBuf,
        messages: u64,
        /// First and last log time of all messages \[ns\].
        all_ns: (u64, u64),
        /// First and last log time of the recording itself \[ns\].
        main_ns: (u64, u64),
    },
    /// Gaps without messages.
    #[error(
        "{path}: {gaps} gap(s) of more than 10 s without a message, the longest of {:.3} s after {}",
        seconds(*.longest_ns),
        Instant(.longest_ns.0)
    )]
    Gaps {
        path: PathBuf,
        gaps: u64,
        /// Log times before and after the longest gap \[ns\].
        longest_ns: (u64, u64),
    },
    /// The log times step back, in the order of writing.
    #[error(
        "{path}: log times step back {steps} time(s), first by {:.3} s from {} to {}; messages are read in the order of \
         log times",
        seconds(*.first_ns),
        Instant(.first_ns.0),
        Instant(.first_ns.1)
    )]
    StepsBack {
        path: PathBuf,
        steps: u64,
        /// Log times before and after the first step \[ns\].
        first_ns: (u64, u64),
    },
    /// All messages have the same log time.
    #[error("{path}: all messages have the log time {}", Instant(*.log_time_ns))]
    OneTime {
        path: PathBuf,
        /// The time \[ns\].
        log_time_ns: u64,
    },
    /// `metadata.yaml` and the files have different message counts.
    #[error("{dir}: metadata.yaml counts {metadata} messages, the files have {files}")]
    CountDiffers {
        dir: PathBuf,
        /// The count in `metadata.yaml`.
        metadata: u64,
        /// The count in the files.
        files: u64,
    },
}

/// Fewer messages may have the same log time without a warning.
const MANY: u64 = 10;

impl BagWarning {
    /// Whether messages of the bag are lost.
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

    /// The warning about a channel's fields, if they differ from this version's.
    pub(crate) fn of_fields(topic: &str, type_name: &str, fields: &FieldMatch) -> Option<Self> {
        let (topic, type_name) = (topic.to_owned(), type_name.to_owned());
        match fields {
            FieldMatch::Same | FieldMatch::Unknown => None,
            FieldMatch::Mapped(mapping) => {
                let (missing, dropped) = (mapping.missing().to_vec(), mapping.dropped().to_vec());
                let differs = !missing.is_empty() || !dropped.is_empty();
                differs.then_some(Self::OtherFields {
                    topic,
                    type_name,
                    missing,
                    dropped,
                })
            }
            FieldMatch::Refused(reason) => Some(Self::Undecodable {
                topic,
                type_name,
                reason: reason.clone(),
            }),
            FieldMatch::Unreadable(error) => Some(Self::UnreadableDefinition {
                topic,
                type_name,
                reason: error.to_string(),
            }),
        }
    }

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
        let main = find_main_part(stretches);
        if let Some((main, messages @ 1..)) = main {
            warnings.push(Self::Apart {
                path: path(),
                messages,
                all_ns: (first.start_ns, last.end_ns),
                main_ns: (main.start_ns, main.end_ns),
            });
        }
        // `Apart` covers gaps to messages outside the recording.
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

fn seconds((from_ns, to_ns): (u64, u64)) -> f64 {
    Duration::from_nanos(to_ns.abs_diff(from_ns)).as_secs_f64()
}

/// The end of a text: `names` after a `heading`, or nothing without names.
fn list(heading: &str, names: &[String]) -> String {
    match names {
        [] => String::new(),
        names => format!("; {heading}: {}", names.join(", ")),
    }
}
