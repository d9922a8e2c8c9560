use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    time::Duration,
};

use crate::{
    BagError, BagReader, BagSummary, BagWarning, BagWriter, Compression, Durability, TopicFilter,
    WriterOptions, reader::StoredMessage,
};

/// Where a part of a bag begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutStart {
    /// With the bag.
    #[default]
    Beginning,
    /// So long after the bag's first message.
    After(Duration),
    /// At this log time, in ns since the epoch.
    At(u64),
}

/// Where a part of a bag ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutEnd {
    /// With the bag.
    #[default]
    End,
    /// So long after its start; a message of that very time is outside.
    After(Duration),
    /// Before this log time, in ns since the epoch.
    Before(u64),
}

/// What came of [`cut`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Cut {
    /// The new bag.
    pub summary: BagSummary,
    /// Topics whose last message before the start was kept.
    pub latched: Vec<String>,
    /// What is wrong with the old bag.
    pub warnings: Vec<BagWarning>,
}

/// Writes the messages of the bag at `input` that lie between two times and on the topics that `topics` wants to a new
/// bag at `output`, in log-time order. Bytes, times and sequence numbers stay as they were, and so do schemas and
/// channels, and what the bag's metadata note of it: its action space, where it came from.
///
/// What holds until it is replaced would be missing from a part that begins later: of each topic that is offered
/// as transient local, the last message before the start is kept too, with the start as its log time, so that it is
/// played first; its publish time stays.
///
/// # Errors
/// No bag, a topic that is named and not there, a time in which the bag has nothing, an `output` that exists, or files
/// that cannot be read or written. A damaged chunk is no error: see [`Cut::warnings`].
pub fn cut(
    input: impl AsRef<Path>,
    output: impl AsRef<Path>,
    start: CutStart,
    end: CutEnd,
    topics: &TopicFilter,
) -> Result<Cut, BagError> {
    let reader = BagReader::open(input)?;
    if let Some(absent) = topics
        .named()
        .iter()
        .find(|name| reader.topic(name).is_none())
    {
        return Err(BagError::NoTopic {
            path: reader.path().to_owned(),
            topic: absent.clone(),
            topics: reader
                .topics()
                .iter()
                .map(|topic| topic.name.to_string())
                .collect(),
        });
    }
    let start_ns = match start {
        CutStart::Beginning => reader.start_ns(),
        CutStart::After(offset) => reader.start_ns().saturating_add(nanoseconds(offset)),
        CutStart::At(time_ns) => time_ns,
    };
    let end_ns = match end {
        CutEnd::End => reader.end_ns().saturating_add(1),
        CutEnd::After(duration) => start_ns.saturating_add(nanoseconds(duration)),
        CutEnd::Before(time_ns) => time_ns,
    };
    if start_ns >= end_ns || start_ns > reader.end_ns() || end_ns <= reader.start_ns() {
        return Err(BagError::NothingBetween {
            path: reader.path().to_owned(),
            start_ns,
            end_ns,
            bag_start_ns: reader.start_ns(),
            bag_end_ns: reader.end_ns(),
        });
    }

    let old = reader.summary();
    let name = if old.compression == "none" {
        ""
    } else {
        old.compression.as_str()
    };
    let options = WriterOptions {
        compression: Compression::of_mcap(name).unwrap_or_default(),
        ros_distro: old.ros_distro,
        ..WriterOptions::default()
    };
    let mut part = Part {
        writer: BagWriter::create(output, options)?,
        numbers: HashMap::new(),
        warnings: reader.warnings().to_vec(),
    };
    for (key, note) in old.notes {
        part.writer.note(&key, note);
    }
    for (file, channel) in reader.definitions() {
        if topics.wants(&channel.topic) {
            let number = part.writer.add_channel(channel.clone())?;
            part.numbers.insert((file, channel.id), number);
        }
    }

    let is_latched = |topic: &&crate::TopicInfo| {
        topic
            .qos()
            .is_some_and(|qos| qos.durability == Durability::TransientLocal)
    };
    let wanted = || {
        reader
            .topics()
            .iter()
            .filter(|topic| topics.wants(&topic.name))
    };
    let latched: Vec<&str> = wanted()
        .filter(is_latched)
        .map(|topic| &*topic.name)
        .collect();
    let kept = if latched.is_empty() || start_ns <= reader.start_ns() {
        BTreeMap::new()
    } else {
        part.last_before(&reader, start_ns, &latched)?
    };
    for message in kept.values() {
        let mut header = message.header;
        header.log_time = start_ns;
        part.write(message, header)?;
    }
    let all: Vec<&str> = wanted().map(|topic| &*topic.name).collect();
    let messages = reader.stored_messages(|messages| {
        messages
            .only_topics(all)
            .starting_at(start_ns)
            .ending_before(end_ns)
    });
    for message in messages {
        if let Some(message) = part.readable(message)? {
            part.write(&message, message.header)?;
        }
    }
    Ok(Cut {
        summary: part.writer.finish()?,
        latched: kept.into_keys().collect(),
        warnings: part.warnings,
    })
}

/// The new bag.
struct Part {
    writer: BagWriter,
    /// Number in it of each file's channels.
    numbers: HashMap<(usize, u16), usize>,
    warnings: Vec<BagWarning>,
}

impl Part {
    /// The last message of each of these topics before `start_ns`.
    fn last_before(
        &mut self,
        reader: &BagReader,
        start_ns: u64,
        topics: &[&str],
    ) -> Result<BTreeMap<String, StoredMessage>, BagError> {
        let names: HashMap<(usize, u16), &str> = reader
            .definitions()
            .map(|(file, channel)| ((file, channel.id), channel.topic.as_str()))
            .collect();
        let mut last = BTreeMap::new();
        let messages =
            reader.stored_messages(|messages| messages.only_topics(topics).ending_before(start_ns));
        for message in messages {
            let Some(message) = self.readable(message)? else {
                continue;
            };
            if let Some(topic) = names.get(&(message.file, message.header.channel_id)) {
                last.insert((*topic).to_owned(), message);
            }
        }
        Ok(last)
    }

    /// The message, or none for a damaged chunk, which becomes a warning.
    fn readable(
        &mut self,
        message: Result<StoredMessage, BagError>,
    ) -> Result<Option<StoredMessage>, BagError> {
        match message {
            Ok(message) => Ok(Some(message)),
            Err(BagError::Chunk {
                path: file,
                offset,
                reason,
            }) => {
                let warning = BagWarning::Damaged {
                    file,
                    offset,
                    reason,
                };
                if !self.warnings.contains(&warning) {
                    self.warnings.push(warning);
                }
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn write(
        &mut self,
        message: &StoredMessage,
        header: mcap::records::MessageHeader,
    ) -> Result<(), BagError> {
        match self.numbers.get(&(message.file, header.channel_id)) {
            Some(number) => self.writer.copy(*number, header, &message.data),
            None => Ok(()),
        }
    }
}

/// More than 584 years saturate.
fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
