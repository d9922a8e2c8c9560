use std::{collections::BTreeMap, fmt, path::Path, sync::Arc};

use bytes::Bytes;

use crate::{
    BagError, BagMessage, BagReader, BagSummary, BagWarning, BagWriter, MessageEncoding, Schema,
    TopicInfo, WriterOptions, part::Part,
};

/// Replaces the messages of some topics while a bag is converted: packets of a video by pictures, for example.
pub trait Transform {
    /// The transformation of this topic; `None` copies its messages.
    fn of_topic(&mut self, topic: &TopicInfo) -> Option<Box<dyn TopicTransform>>;
}

/// The transformation of one topic. It may keep state from message to message.
pub trait TopicTransform {
    /// The topic that replaces the old one.
    fn topic(&self) -> NewTopic;

    /// Takes the next message, in the order of log times, and gives the new messages that are ready.
    ///
    /// # Errors
    /// What is wrong with the message, which is left out.
    fn convert(&mut self, message: &BagMessage) -> Result<Vec<NewMessage>, String>;

    /// The new messages that are still held back at the bag's end.
    ///
    /// # Errors
    /// Why they are lost.
    fn finish(&mut self) -> Result<Vec<NewMessage>, String> {
        Ok(Vec::new())
    }

    /// Messages that gave no new one although [`convert`](Self::convert) took them. Called after
    /// [`finish`](Self::finish).
    fn omissions(&self) -> Vec<Omission> {
        Vec::new()
    }
}

/// Messages of a topic that a transformation leaves out for one reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Omission {
    /// How many.
    pub messages: u64,
    /// Why.
    pub reason: String,
}

/// A topic of a converted bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewTopic {
    /// Its full name.
    pub name: String,
    /// The type, as `package/msg/Type`.
    pub type_name: String,
    /// The type's definition.
    pub schema: Schema,
    /// Its `offered_qos_profiles`.
    pub qos_yaml: String,
}

/// A message of a converted topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewMessage {
    /// When it was recorded, in ns since the epoch.
    pub log_time_ns: u64,
    /// When it was published, in ns since the epoch.
    pub publish_time_ns: u64,
    /// CDR with its header.
    pub data: Bytes,
}

/// What came of [`convert`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Converted {
    /// The new bag.
    pub summary: BagSummary,
    /// Names of the transformed topics in the old and in the new bag.
    pub transformed: Vec<(String, String)>,
    /// Topics whose type has no definition in the new bag: the old one has none, and it is not known here, or does not fit.
    pub undefined: Vec<String>,
    /// What is wrong with the old bag, and what could not be transformed.
    pub warnings: Vec<BagWarning>,
}

impl Converted {
    /// Whether messages of the old bag are missing from the new one.
    #[must_use]
    pub fn is_lossy(&self) -> bool {
        self.warnings.iter().any(BagWarning::is_loss)
    }
}

/// A line for the bag, for each transformed topic and for each warning.
impl fmt::Display for Converted {
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

/// Writes the bag at `input`, of any storage that is read and compressed in any way, as an MCAP bag at `output`. Bytes, times
/// and sequence numbers of messages stay as they were, and so do definitions and QoS, and what the bag's metadata note of
/// it. The first of `transforms` that takes a topic transforms it.
///
/// # Errors
/// No bag, an `output` that exists, or files that cannot be read or written. A damaged chunk and a message that cannot be
/// transformed are no error: see [`Converted::warnings`].
pub fn convert(
    input: impl AsRef<Path>,
    output: impl AsRef<Path>,
    mut options: WriterOptions,
    transforms: &mut [Box<dyn Transform>],
) -> Result<Converted, BagError> {
    let reader = BagReader::open(input)?;
    let old = reader.summary();
    options.ros_distro = old.ros_distro;
    let mut part = Part::new(&reader, BagWriter::create(output, options)?, old.notes);
    for (topic, lost) in &old.lost {
        part.writer.count_lost(topic, *lost);
    }
    let mut transformed: BTreeMap<Arc<str>, Transformed> = BTreeMap::new();
    for topic in reader.topics() {
        let found = transforms
            .iter_mut()
            .find_map(|transform| transform.of_topic(topic));
        if let Some(transform) = found {
            let new = transform.topic();
            part.writer
                .add_topic_raw(&new.name, &new.type_name, &new.schema, &new.qos_yaml)?;
            let of_topic = Transformed {
                new,
                transform,
                failed: None,
            };
            transformed.insert(Arc::clone(&topic.name), of_topic);
        }
    }
    part.add_channels(&reader, |topic| !transformed.contains_key(topic))?;
    let undefined = reader
        .topics()
        .iter()
        .filter(|topic| topic.schema.text.is_empty() && !transformed.contains_key(&topic.name))
        .filter(|topic| topic.message_count > 0 && topic.encoding == MessageEncoding::Cdr)
        .map(|topic| topic.name.to_string())
        .collect();

    for stored in reader.stored_messages(|messages| messages) {
        let Some(stored) = part.readable(stored)? else {
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
                transformed.put(&mut part, made)?;
            }
            None => part.write(&stored, stored.header)?,
        }
    }
    let mut names: Vec<(String, String)> = Vec::new();
    for (topic, mut transformed) in transformed {
        let made = transformed.transform.finish();
        transformed.put(&mut part, made)?;
        let failed = transformed.failed.take();
        let omissions = transformed.transform.omissions().into_iter();
        part.warnings
            .extend(omissions.chain(failed).map(|omission| BagWarning::Omitted {
                topic: topic.to_string(),
                messages: omission.messages,
                reason: omission.reason,
            }));
        names.push((topic.to_string(), transformed.new.name));
    }
    names.sort();
    Ok(Converted {
        summary: part.writer.finish()?,
        transformed: names,
        undefined,
        warnings: part.warnings,
    })
}

/// A topic while it is transformed.
struct Transformed {
    new: NewTopic,
    transform: Box<dyn TopicTransform>,
    /// Messages that the transformation refused, with the first reason.
    failed: Option<Omission>,
}

impl Transformed {
    /// Writes the new messages, or counts the refused one.
    fn put(
        &mut self,
        part: &mut Part,
        made: Result<Vec<NewMessage>, String>,
    ) -> Result<(), BagError> {
        match made {
            Ok(messages) => {
                for message in messages {
                    let times = (message.log_time_ns, message.publish_time_ns);
                    let (name, data) = (&self.new.name, &message.data);
                    match part.writer.append_at(name, times, data) {
                        Err(error @ BagError::LogTime { .. }) => {
                            part.readable(Err(error))?;
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
                self.failed.get_or_insert(first).messages += 1;
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

    /// Numbers of texts; the last is held back by one.
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
    fn a_topic_is_transformed_and_the_others_stay() {
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
