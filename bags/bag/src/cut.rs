use std::{collections::BTreeSet, path::Path, time::Duration};

use crate::{
    BagError, BagReader, BagSummary, BagWarning, BagWriter, Compression, TopicFilter, TopicInfo,
    WriterOptions, bag_copy::BagCopy,
};

/// The start of a part of a bag.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutStart {
    /// The start of the bag.
    #[default]
    Beginning,
    /// At this offset from the bag's first message.
    After(Duration),
    /// At this log time, in ns since the epoch.
    At(u64),
}

/// The end of a part of a bag.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutEnd {
    /// The end of the bag.
    #[default]
    End,
    /// At this offset from the start; a message of exactly that time is excluded.
    After(Duration),
    /// Before this log time, in ns since the epoch.
    Before(u64),
}

/// The result of [`cut`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Cut {
    /// The new bag.
    pub summary: BagSummary,
    /// Topics with a latched message from before the start.
    pub latched: Vec<String>,
    /// Faults of the old bag.
    pub warnings: Vec<BagWarning>,
}

/// Copies the messages of the bag at `input` between two times, on the topics that `topics` selects, to a new bag at
/// `output`, in log-time order. Copies schemas, channels, notes, and the bytes, times and sequence numbers of messages.
///
/// Latched messages from before the start are copied too: the last message of each transient local topic (for
/// `/tf_static` all distinct ones). Their log time becomes the start, so that they are played first; their publish time
/// stays. Offsets count from the start of the recording itself ([`BagReader::time_at`]).
///
/// # Errors
/// `input` is not a bag, a named topic is missing, the time span is empty, `output` exists, or a file cannot be read or
/// written. Damaged chunks are [`Cut::warnings`].
pub fn cut(
    input: impl AsRef<Path>,
    output: impl AsRef<Path>,
    start: CutStart,
    end: CutEnd,
    topics: &TopicFilter,
) -> Result<Cut, BagError> {
    let reader = BagReader::open(input)?;
    if let Some(missing) = topics
        .named()
        .iter()
        .find(|name| reader.topic(name).is_none())
    {
        return Err(BagError::NoTopic {
            path: reader.path().to_owned(),
            topic: missing.clone(),
            topics: reader
                .topics()
                .iter()
                .map(|topic| topic.name.to_string())
                .collect(),
        });
    }
    // An invalid stamp may be far from the recording itself.
    let (start_ns, origin_ns) = match start {
        CutStart::Beginning => (reader.start_ns(), reader.time_at(Duration::ZERO)),
        CutStart::After(offset) => (reader.time_at(offset), reader.time_at(offset)),
        CutStart::At(time_ns) => (time_ns, time_ns),
    };
    let end_ns = match end {
        CutEnd::End => reader.end_ns().saturating_add(1),
        CutEnd::After(duration) => origin_ns.saturating_add(nanoseconds(duration)),
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
        // Several compressions have no name of their own: the new bag has the default.
        compression: Compression::of_mcap(name).unwrap_or_default(),
        ros_distro: old.ros_distro,
        ..WriterOptions::default()
    };
    let mut copy = BagCopy::new(&reader, BagWriter::create(output, options)?, old.notes);
    copy.add_channels(&reader, |topic| topics.wants(topic))?;

    let mut latched_topics = BTreeSet::new();
    if start_ns > reader.start_ns() {
        let wants = |topic: &TopicInfo| topics.wants(&topic.name);
        let (messages, unreadable) = reader.stored_latched_before(start_ns, wants);
        for error in unreadable {
            copy.readable(Err(error))?;
        }
        for (topic, message) in messages {
            let mut header = message.header;
            header.log_time = start_ns;
            copy.write(&message, header)?;
            latched_topics.insert(topic.to_string());
        }
    }
    let wanted = || {
        let all = reader.topics().iter();
        all.filter(|topic| topics.wants(&topic.name))
    };
    let all: Vec<&str> = wanted().map(|topic| &*topic.name).collect();
    let messages = reader.stored_messages(|messages| {
        let messages = messages.only_topics(all).starting_at(start_ns);
        match end {
            // `end_ns` excludes the largest possible log time.
            CutEnd::End => messages,
            _ => messages.ending_before(end_ns),
        }
    });
    for message in messages {
        if let Some(message) = copy.readable(message)? {
            copy.write(&message, message.header)?;
        }
    }
    Ok(Cut {
        summary: copy.writer.finish()?,
        latched: latched_topics.into_iter().collect(),
        warnings: copy.warnings,
    })
}

/// Saturates at 584 years.
fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
