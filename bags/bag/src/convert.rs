use std::{collections::BTreeMap, fmt, path::Path, sync::Arc};

use bytes::Bytes;

use crate::{
    BagError, BagMessage, BagReader, BagSummary, BagWarning, BagWriter, MessageEncoding, Schema,
    TopicInfo, WriterOptions, bag_copy::BagCopy,
};

/// Selects topics whose messages are transformed while a bag is converted, for example video packets into pictures.
pub trait Transform {
    /// The transformation of this topic; `None` copies its messages.
    fn of_topic(&mut self, topic: &TopicInfo) -> Option<Box<dyn TopicTransform>>;
}

/// The transformation of one topic. It may keep state between messages.
pub trait TopicTransform {
    /// The topic that replaces the old one.
    fn topic(&self) -> NewTopic;

    /// Converts the next message, in log-time order, and returns the new messages that are ready.
    ///
    /// # Errors
    /// The fault of the message, which is skipped.
    fn convert(&mut self, message: &BagMessage) -> Result<Vec<NewMessage>, String>;

    /// The new messages that remain at the end of the bag.
    ///
    /// # Errors
    /// The reason why they are lost.
    fn finish(&mut self) -> Result<Vec<NewMessage>, String> {
        Ok(Vec::new())
    }

    /// Messages that [`convert`](Self::convert) accepted without a new message. Called after [`finish`](Self::finish).
    fn omissions(&self) -> Vec<Omission> {
        Vec::new()
    }
}

/// Messages of a topic that a transformation skips for one reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Omission {
    /// Number of messages.
    pub messages: u64,
    /// The reason.
    pub reason: String,
}

/// A topic of a converted bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewTopic {
    /// The full name.
    pub name: String,
    /// The type, as `package/msg/Type`.
    pub type_name: String,
    /// The type's definition.
    pub schema: Schema,
    /// The text of `offered_qos_profiles`.
    pub qos_yaml: String,
}

/// A message of a converted topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewMessage {
    /// Time of recording, in ns since the epoch.
    pub log_time_ns: u64,
    /// Time of publication, in ns since the epoch.
    pub publish_time_ns: u64,
    /// CDR with its header.
    pub data: Bytes,
}

/// The result of [`convert`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Conversion {
    /// The new bag.
    pub summary: BagSummary,
    /// Names of the transformed topics, in the old and in the new bag.
    pub transformed: Vec<(String, String)>,
    /// Topics without a definition in the new bag: the old bag has none, and the known one is missing or does not fit.
    pub undefined: Vec<String>,
    /// Faults of the old bag, and failures transformations.
    pub warnings: Vec<BagWarning>,
}

impl Conversion {
    /// Whether messages of the old bag are missing from the new one.
    #[must_use]
    pub fn is_lossy(&self) -> bool {
        self.warnings.iter().any(BagWarning::is_loss)
    }
}

/// One line each for the bag, the transformed topics and the warnings.
impl fmt::Display for Conversion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "wrote {} message(s) of {} topic(s) to {}",
            self.summary.message_count,
            self.summary.topics.len(),
            self.summary.path.display()
        )?;
        for (old, new) in &self.transformed {
            match old == new {
                true => write!(f, "\nconverted {old}")?,
                false => write!(f, "\nconverted {old} to {new}")?,
            }
        }
        for topic in &self.undefined {
            write!(
                f,
                "\nWarning: the type of {topic} has no definition in the new bag"
            )?;
        }
        for warning in &self.warnings {
            write!(f, "\nWarning: {warning}")?;
        }
        Ok(())
    }
}

/// Writes the bag at `input`, in any storage and compression that [`BagReader`] reads, as an MCAP bag at `output`. Copies
/// definitions, QoS profiles, notes, and the bytes, times and sequence numbers of messages. The first of `transforms`
/// that accepts a topic transforms it.
///
/// # Errors
/// `input` is not a bag, `output` exists, or a file cannot be read or written. Damaged chunks and failures
/// transformations are [`Conversion::warnings`].
pub fn convert(
    input: impl AsRef<Path>,
    output: impl AsRef<Path>,
    mut options: WriterOptions,
    transforms: &mut [Box<dyn Transform>],
) -> Result<Conversion, BagError> {
    let reader = BagReader::open(input)?;
    let old = reader.summary();
    options.ros_distro = old.ros_distro;
    let mut copy = BagCopy::new(&reader, BagWriter::create(output, options)?, old.notes);
    for (topic, lost) in &old.lost {
        copy.writer.count_lost(topic, *lost);
    }
    let mut transformed: BTreeMap<Arc<str>, TransformedTopic> = BTreeMap::new();
    for topic in reader.topics() {
        let found = transforms
            .iter_mut()
            .find_map(|transform| transform.of_topic(topic));
        if let Some(transform) = found {
            let new = transform.topic();
            copy.writer
                .add_topic_raw(&new.name, &new.type_name, &new.schema, &new.qos_yaml)?;
            let of_topic = TransformedTopic {
                new,
                transform,
                failures: None,
            };
            transformed.insert(Arc::clone(&topic.name), of_topic);
        }
    }
    copy.add_channels(&reader, |topic| !transformed.contains_key(topic))?;
    let undefined = reader
        .topics()
        .iter()
        .filter(|topic| topic.schema.text.is_empty() && !transformed.contains_key(&topic.name))
        .filter(|topic| topic.message_count > 0 && topic.encoding == MessageEncoding::Cdr)
        .map(|topic| topic.name.to_string())
        .collect();

    for stored in reader.stored_messages(|messages| messages) {
        let Some(stored) = copy.readable(stored)? else {
            continue;
        };
        let message = match transformed.is_empty() {
            true => None,
            false => reader.message_of(&stored),
        };
        let message = message.and_then(|message| {
            let transform = transformed.get_mut(&message.topic)?;
            Some((message, transform))
        });
        match message {
            Some((message, transformed)) => {
                let made = transformed.transform.convert(&message);
                transformed.put(&mut copy, made)?;
            }
            None => copy.write(&stored, stored.header)?,
        }
    }
    let mut names: Vec<(String, String)> = Vec::new();
    for (topic, mut transformed) in transformed {
        let made = transformed.transform.finish();
        transformed.put(&mut copy, made)?;
        let failures = transformed.failures.take();
        let omissions = transformed.transform.omissions().into_iter();
        copy.warnings.extend(
            omissions
                .chain(failures)
                .map(|omission| BagWarning::Omitted {
                    topic: topic.to_string(),
                    messages: omission.messages,
                    reason: omission.reason,
                }),
        );
        names.push((topic.to_string(), transformed.new.name));
    }
    names.sort();
    Ok(Conversion {
        summary: copy.writer.finish()?,
        transformed: names,
        undefined,
        warnings: copy.warnings,
    })
}

/// The transformation of a topic and its failures.
struct TransformedTopic {
    new: NewTopic,
    transform: Box<dyn TopicTransform>,
    /// Number of messages that failures, and the first reason.
    failures: Option<Omission>,
}

impl TransformedTopic {
    /// Writes the new messages, or counts a failure.
    fn put(
        &mut self,
        copy: &mut BagCopy,
        made: Result<Vec<NewMessage>, String>,
    ) -> Result<(), BagError> {
        match made {
            Ok(messages) => {
                for message in messages {
                    let times = (message.log_time_ns, message.publish_time_ns);
                    let (name, data) = (&self.new.name, &message.data);
                    match copy.writer.append_at(name, times, data) {
                        Err(error @ BagError::LogTime { .. }) => {
                            copy.readable(Err(error))?;
                        }
                        written => written?,
                    }
                }
            }
            Err(reason) => {
                let first = Omission {
                    messages: 0,
                    reason,
                };
                self.failures.get_or_insert(first).messages += 1;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{QosProfile, type_schema};
    use wm_msgs::{
        cdr,
        std_msgs::{Float32, String as Text},
    };

    /// Parses texts as numbers; each number is written one message later.
    struct Numbers {
        held: Option<NewMessage>,
    }

    impl Transform for Numbers {
        fn of_topic(&mut self, topic: &TopicInfo) -> Option<Box<dyn TopicTransform>> {
            (&*topic.name == "/number/text").then(|| Box::new(Self { held: None }) as _)
        }
    }

    impl TopicTransform for Numbers {
        fn topic(&self) -> NewTopic {
            NewTopic {
                name: "/number".into(),
                type_name: "std_msgs/msg/Float32".into(),
                schema: type_schema::<Float32>(),
                qos_yaml: QosProfile::reliable().to_yaml(),
            }
        }

        fn convert(&mut self, message: &BagMessage) -> Result<Vec<NewMessage>, String> {
            let text = message
                .decode::<Text>()
                .map_err(|error| error.to_string())?
                .data;
            let data = text
                .parse()
                .map_err(|_| format!("{text:?} is not a number"))?;
            let number = NewMessage {
                log_time_ns: message.log_time_ns,
                publish_time_ns: message.publish_time_ns,
                data: cdr::to_bytes(&Float32 { data }).unwrap().into(),
            };
            Ok(self.held.replace(number).into_iter().collect())
        }

        fn finish(&mut self) -> Result<Vec<NewMessage>, String> {
            Ok(self.held.take().into_iter().collect())
        }
    }

    #[test]
    fn one_topic_is_transformed_and_the_others_are_copied() {
        let scratch = tempfile::tempdir().unwrap();
        let (old, new) = (scratch.path().join("old"), scratch.path().join("new"));
        let mut writer = BagWriter::create(&old, WriterOptions::default()).unwrap();
        for (time, text) in (1..).zip(["1.5", "none", "2.5", "null"]) {
            let text = Text { data: text.into() };
            writer.write("/number/text", &text, time).unwrap();
            writer.write("/text", &text, time).unwrap();
        }
        writer.count_lost("/text", 2);
        writer.note("operator", "Ada");
        writer.finish().unwrap();
        let numbers: Box<dyn Transform> = Box::new(Numbers { held: None });
        let options = WriterOptions::default();
        let converted = convert(&old, &new, options.clone(), &mut [numbers]).unwrap();
        assert_eq!(
            converted.transformed,
            [("/number/text".to_owned(), "/number".to_owned())]
        );
        assert_eq!(
            converted.warnings,
            [BagWarning::Omitted {
                topic: "/number/text".into(),
                messages: 2,
                reason: "\"none\" is not a number".into(),
            }]
        );
        assert!(converted.is_lossy());
        let reader = BagReader::open(&new).unwrap();
        let numbers: Vec<(u64, f32)> = reader
            .messages()
            .only_topics(["/number"])
            .map(Result::unwrap)
            .map(|message| {
                (
                    message.log_time_ns,
                    message.decode::<Float32>().unwrap().data,
                )
            })
            .collect();
        assert_eq!(numbers, [(1, 1.5), (3, 2.5)]);
        assert_eq!(reader.topic("/text").unwrap().message_count, 4);
        let summary = reader.summary();
        assert_eq!(
            (summary.lost["/text"], summary.notes["operator"].as_str()),
            (2, "Ada")
        );
        assert!(matches!(
            convert(&old, &new, options, &mut []),
            Err(BagError::Exists(_))
        ));
    }
}
