use std::{collections::BTreeSet, path::Path, time::Duration};

use crate::{
    BagError, BagReader, BagSummary, BagWarning, BagWriter, Compression, TopicFilter, TopicInfo,
    WriterOptions, part::Part,
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
/// as transient local, the last message before the start is kept too (of `/tf_static` all that differ), with the start as
/// its log time, so that it is played first; its publish time stays. Offsets count from the recording itself
/// ([`BagReader::main_span_ns`]).
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
    // Offsets count from the recording itself, from which a message without a time may be far.
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
        compression: Compression::of_mcap(name).unwrap_or_default(),
        ros_distro: old.ros_distro,
        ..WriterOptions::default()
    };
    let mut part = Part::new(&reader, BagWriter::create(output, options)?, old.notes);
    part.add_channels(&reader, |topic| topics.wants(topic))?;

    let mut kept = BTreeSet::new();
    if start_ns > reader.start_ns() {
        let wants = |topic: &TopicInfo| topics.wants(&topic.name);
        let (messages, unreadable) = reader.stored_latched_before(start_ns, wants);
        for error in unreadable {
            part.readable(Err(error))?;
        }
        for (topic, message) in messages {
            let mut header = message.header;
            header.log_time = start_ns;
            part.write(&message, header)?;
            kept.insert(topic.to_string());
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
            // The last time may be the largest there is.
            CutEnd::End => messages,
            _ => messages.ending_before(end_ns),
        }
    });
    for message in messages {
        if let Some(message) = part.readable(message)? {
            part.write(&message, message.header)?;
        }
    }
    Ok(Cut {
        summary: part.writer.finish()?,
        latched: kept.into_iter().collect(),
        warnings: part.warnings,
    })
}

/// More than 584 years saturate.
fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
