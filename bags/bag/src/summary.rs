use std::{
    collections::BTreeMap,
    fmt,
    path::PathBuf,
    time::{Duration, UNIX_EPOCH},
};

use crate::BagWarning;

/// Key of the note with the source of an imported bag: `DATASET/FILE`, and `#NUMBER` if the file has several episodes.
pub const ORIGIN: &str = "wm.import.source";
/// Longer notes, such as an action space in JSON, are shown by their size, since they do not fit a terminal line.
const LONGEST_NOTE: usize = 80;

/// The contents of a bag. Its [`Display`](fmt::Display) is the text of `bag info`.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct BagSummary {
    /// The folder or file.
    pub path: PathBuf,
    /// Its files, in the order of reading.
    pub files: Vec<PathBuf>,
    /// Total size of the files, in bytes.
    pub size_bytes: u64,
    /// Log time of the first message in ns since the epoch; 0 for a bag without messages.
    pub start_ns: u64,
    /// Log time of the last message in ns since the epoch; 0 for a bag without messages.
    pub end_ns: u64,
    /// First and last log time of the recording itself, in ns since the epoch: without messages more than a day from most
    /// others, which have invalid stamps.
    pub main_span_ns: Option<(u64, u64)>,
    /// Storage of the files: `mcap`, `sqlite3` or both.
    pub storage: String,
    /// Number of messages.
    pub message_count: u64,
    /// The topics, by name.
    pub topics: Vec<TopicSummary>,
    /// Number of messages that the recorder lost, by topic.
    pub lost: BTreeMap<String, u64>,
    /// Compression of the chunks: `none`, `zstd`, `lz4`, or several of them.
    pub compression: String,
    /// The recorder's ROS distribution; empty if unknown.
    pub ros_distro: String,
    /// The notes: `custom_data` in `metadata.yaml`, without the lost messages.
    pub notes: BTreeMap<String, String>,
    /// Faults of the bag that do not prevent reading.
    pub warnings: Vec<BagWarning>,
}

/// One topic of a [`BagSummary`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicSummary {
    /// The full name.
    pub name: String,
    /// The type, as `package/msg/Type`.
    pub type_name: String,
    /// Encoding of the messages: `cdr` or `protobuf`.
    pub serialization_format: String,
    /// Number of messages.
    pub message_count: u64,
}

impl BagSummary {
    /// Time from the first to the last message of the recording itself, in ns.
    #[must_use]
    pub fn duration_ns(&self) -> u64 {
        let (start_ns, end_ns) = self.main_span_ns.unwrap_or((self.start_ns, self.end_ns));
        end_ns.saturating_sub(start_ns)
    }
}

impl fmt::Display for BagSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Path:         {}", self.path.display())?;
        let names: Vec<String> = self
            .files
            .iter()
            .map(|file| {
                file.file_name()
                    .unwrap_or(file.as_os_str())
                    .to_string_lossy()
                    .into_owned()
            })
            .collect();
        writeln!(f, "Files:        {}", names.join(", "))?;
        writeln!(f, "Size:         {}", Size(self.size_bytes))?;
        writeln!(
            f,
            "Storage:      {}, chunk compression {}",
            self.storage, self.compression
        )?;
        if !self.ros_distro.is_empty() {
            writeln!(f, "ROS distro:   {}", self.ros_distro)?;
        }
        writeln!(
            f,
            "Duration:     {:.3} s",
            Duration::from_nanos(self.duration_ns()).as_secs_f64()
        )?;
        if self.message_count > 0 {
            writeln!(f, "Start:        {}", Instant(self.start_ns))?;
            writeln!(f, "End:          {}", Instant(self.end_ns))?;
        }
        writeln!(f, "Messages:     {}", self.message_count)?;
        if let Some(origin) = self.notes.get(ORIGIN) {
            writeln!(f, "Origin:       {origin}")?;
        }
        for (key, value) in self.notes.iter().filter(|(key, _)| *key != ORIGIN) {
            if value.len() <= LONGEST_NOTE && !value.contains('\n') {
                writeln!(f, "Note:         {key}: {value}")?;
            } else {
                let bytes = value.len();
                writeln!(f, "Note:         {key}, {bytes} bytes in metadata.yaml")?;
            }
        }
        let lost: u64 = self.lost.values().sum();
        if lost > 0 {
            let by_topic: Vec<String> = self
                .lost
                .iter()
                .map(|(topic, count)| format!("{topic} {count}"))
                .collect();
            writeln!(f, "Lost:         {lost} ({})", by_topic.join(", "))?;
        }
        let name_width = self
            .topics
            .iter()
            .map(|topic| topic.name.len())
            .max()
            .unwrap_or(0)
            .max("Topic".len());
        let type_width = self
            .topics
            .iter()
            .map(|topic| topic.type_name.len())
            .max()
            .unwrap_or(0)
            .max("Type".len());
        write!(
            f,
            "\n{:name_width$}  {:type_width$}  {:>9}  Encoding",
            "Topic", "Type", "Count"
        )?;
        for topic in &self.topics {
            write!(
                f,
                "\n{:name_width$}  {:type_width$}  {:>9}  {}",
                topic.name, topic.type_name, topic.message_count, topic.serialization_format
            )?;
        }
        for warning in &self.warnings {
            write!(f, "\nWarning: {warning}")?;
        }
        Ok(())
    }
}

/// Displays a size in bytes with a unit.
struct Size(u64);

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const UNITS: [&str; 4] = ["KiB", "MiB", "GiB", "TiB"];
        // f64 is exact below 2^53, and one decimal is shown.
        let mut value = self.0 as f64;
        let mut unit = "B";
        for larger in UNITS {
            if value < 1024.0 {
                break;
            }
            value /= 1024.0;
            unit = larger;
        }
        if unit == "B" {
            write!(f, "{value} B")
        } else {
            write!(f, "{value:.1} {unit}")
        }
    }
}

/// Displays a time in ns since the epoch as a UTC date and a number.
pub(crate) struct Instant(pub u64);

impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let since_epoch = Duration::from_nanos(self.0);
        let date = humantime::format_rfc3339_nanos(UNIX_EPOCH + since_epoch);
        write!(
            f,
            "{date} ({}.{:09})",
            since_epoch.as_secs(),
            since_epoch.subsec_nanos()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_is_readable() {
        let summary = BagSummary {
            path: "demo".into(),
            files: vec!["demo/demo_0.mcap".into()],
            size_bytes: 1_572_864,
            start_ns: 1_700_000_000_000_000_000,
            end_ns: 1_700_000_009_800_000_000,
            main_span_ns: None,
            storage: "mcap".into(),
            message_count: 12,
            topics: vec![TopicSummary {
                name: "/task/success".into(),
                type_name: "std_msgs/msg/Bool".into(),
                serialization_format: "cdr".into(),
                message_count: 12,
            }],
            lost: BTreeMap::from([("/task/success".into(), 2)]),
            compression: "zstd".into(),
            ros_distro: String::new(),
            notes: BTreeMap::from([
                (ORIGIN.into(), "bridge_v2/train.tfrecord#3".into()),
                ("operator".into(), "Ada".into()),
                ("action_space".into(), "x".repeat(LONGEST_NOTE + 1)),
            ]),
            warnings: vec![BagWarning::NoMetadata { dir: "demo".into() }],
        };
        let text = summary.to_string();
        for part in [
            "Size:         1.5 MiB",
            "Duration:     9.800 s",
            "2023-11-14T22:13:20.000000000Z (1700000000.000000000)",
            "Lost:         2 (/task/success 2)",
            "Origin:       bridge_v2/train.tfrecord#3\n",
            "Note:         operator: Ada\n",
            "Note:         action_space, 81 bytes in metadata.yaml\n",
            "/task/success  std_msgs/msg/Bool         12  cdr",
            "Warning: demo has no metadata.yaml",
        ] {
            assert!(text.contains(part), "{part:?} in\n{text}");
        }
    }
}
