//! The definition that a bag stores for a topic: the bytes of its messages fit it.
//!
//! DDS sends bytes and the name of their type. The publisher's definition may differ from this suite's, and from the
//! installed one. Readers decode a bag by the definition that it stores.

use anyhow::Result;
use std::collections::BTreeMap;
use std::sync::Arc;
use tracing::warn;
use wm_bag::{BagError, BagWriter, QosProfile, Schema, definitions};
use wm_msgs::{ConvertError, Layout};

/// A definition, with the layout of its messages if that is known.
struct Candidate {
    schema: Schema,
    layout: Option<Layout>,
}

impl Candidate {
    /// Whether these bytes fit the layout; true if the layout is unknown.
    fn fits(&self, data: &[u8]) -> bool {
        match self.layout.as_ref().map(|layout| layout.check(data)) {
            None | Some(Ok(()) | Err(ConvertError::Representation(_))) => true,
            Some(Err(_)) => false,
        }
    }
}

/// The channel of a topic in the bag.
enum Channel {
    /// Not created yet, because no message was received. The definitions are candidates.
    Announced(Vec<Candidate>),
    /// Created with this definition.
    Defined(Candidate),
    /// Created without a definition.
    Undefined,
    /// Not created, because the bag refuses the topic's name or type.
    Refused,
}

struct Topic {
    type_name: String,
    qos: QosProfile,
    channel: Channel,
    /// Messages that do not fit the definition.
    foreign: u64,
}

/// The definitions of the topics of a bag.
#[derive(Default)]
pub(super) struct Definitions {
    topics: BTreeMap<Arc<str>, Topic>,
}

impl Definitions {
    /// Adds a topic with its candidate definitions.
    pub fn announce(
        &mut self,
        name: Arc<str>,
        type_name: String,
        candidates: Vec<Schema>,
        qos: QosProfile,
    ) {
        let candidates = candidates.into_iter().map(|schema| {
            let description = schema.description(&type_name).ok().flatten();
            let layout = description.and_then(|description| Layout::of(&description).ok());
            Candidate { schema, layout }
        });
        let topic = Topic {
            channel: Channel::Announced(candidates.collect()),
            type_name,
            qos,
            foreign: 0,
        };
        self.topics.entry(name).or_insert(topic);
    }

    /// Writes a message. Its topic gets the first definition that its first message fits. A later message that does not fit
    /// is written without a definition.
    pub fn write(
        &mut self,
        writer: &mut BagWriter,
        name: &Arc<str>,
        log_time_ns: u64,
        data: &[u8],
    ) -> Result<()> {
        let Some(topic) = self.topics.get_mut(name) else {
            writer.count_lost(name, 1);
            return Ok(());
        };
        if let Channel::Announced(candidates) = &mut topic.channel {
            let is_known = !candidates.is_empty();
            let fitting = candidates.iter().position(|candidate| candidate.fits(data));
            let fitting = fitting.map(|number| candidates.swap_remove(number));
            if is_known && fitting.is_none() {
                warn!(
                    "{name} is recorded without a definition: its messages do not fit the {} that is known here",
                    topic.type_name
                );
            }
            topic.record(writer, name, fitting)?;
        }
        match &topic.channel {
            Channel::Defined(definition) if !definition.fits(data) => {
                if topic.foreign == 0 {
                    let type_name = &topic.type_name;
                    warn!(
                        "{name}: messages of another {type_name} are recorded without a definition"
                    );
                }
                topic.foreign += 1;
                writer.write_undefined(name, log_time_ns, data)?;
            }
            Channel::Defined(definition) => {
                let schema = &definition.schema;
                writer.write_raw(name, &topic.type_name, schema, log_time_ns, data)?;
            }
            Channel::Undefined => {
                let schema = definitions::unknown();
                writer.write_raw(name, &topic.type_name, &schema, log_time_ns, data)?;
            }
            Channel::Announced(_) | Channel::Refused => writer.count_lost(name, 1),
        }
        Ok(())
    }

    /// Adds the topics without a message to the bag, each with its first definition.
    pub fn add_silent(&mut self, writer: &mut BagWriter) -> Result<()> {
        for (name, topic) in &mut self.topics {
            if let Channel::Announced(candidates) = &mut topic.channel {
                let first = (!candidates.is_empty()).then(|| candidates.swap_remove(0));
                topic.record(writer, name, first)?;
            }
        }
        Ok(())
    }
}

impl Topic {
    /// Adds the topic to the bag.
    fn record(
        &mut self,
        writer: &mut BagWriter,
        name: &str,
        definition: Option<Candidate>,
    ) -> Result<()> {
        let unknown = definitions::unknown();
        let schema = definition.as_ref().map_or(&unknown, |known| &known.schema);
        let qos_yaml = self.qos.to_yaml();
        self.channel = match writer.add_topic_raw(name, &self.type_name, schema, &qos_yaml) {
            Ok(()) => definition.map_or(Channel::Undefined, Channel::Defined),
            // The topic's messages count as lost.
            Err(
                error @ (BagError::TopicName(_)
                | BagError::TypeName(_)
                | BagError::TypeConflict { .. }),
            ) => {
                warn!("a topic is not recorded: {error}");
                Channel::Refused
            }
            Err(error) => return Err(error.into()),
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_bag::{BagReader, SchemaEncoding, WriterOptions, type_schema};
    use wm_msgs::{cdr, wm_msgs::Action};

    const NAME: &str = "wm_msgs/msg/Action";

    fn recorded(candidates: Vec<Schema>, messages: &[Vec<u8>]) -> BagReader {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
        let mut definitions = Definitions::default();
        let topic: Arc<str> = "/wm/action".into();
        let qos = QosProfile::reliable();
        definitions.announce(topic.clone(), NAME.to_owned(), candidates, qos);
        for (time, data) in (1..).zip(messages) {
            definitions.write(&mut writer, &topic, time, data).unwrap();
        }
        definitions.add_silent(&mut writer).unwrap();
        writer.finish().unwrap();
        let reader = BagReader::open(&bag).unwrap();
        // Read now: the folder is removed when this function returns.
        assert_eq!(
            reader.messages().filter(Result::is_ok).count(),
            messages.len()
        );
        reader
    }

    fn own() -> Vec<u8> {
        let action = Action {
            values: vec![0.5; 7],
            ..Action::default()
        };
        cdr::to_bytes(&action).unwrap()
    }

    /// An action by a definition with one more field.
    fn foreign() -> Vec<u8> {
        [
            &[0, 1, 0, 0][..],
            &[0; 8],
            &[1, 0, 0, 0, 0, 0, 0, 0],
            &[7, 0, 0, 0, 7, 0, 0, 0],
            &[0; 28],
        ]
        .concat()
    }

    fn older() -> Schema {
        let text = type_schema::<Action>().text;
        Schema::ros2msg(text.replace("float32[] values", "uint32 mode\nfloat32[] values"))
    }

    #[test]
    fn foreign_bytes_never_get_this_suites_definition() {
        let schema = |reader: &BagReader| reader.topics()[0].schema.clone();
        let both = || vec![type_schema::<Action>(), older()];
        assert_eq!(
            *schema(&recorded(both(), &[own()])),
            type_schema::<Action>()
        );
        assert_eq!(*schema(&recorded(both(), &[foreign()])), older());
        assert_eq!(*schema(&recorded(both(), &[])), type_schema::<Action>());
        let alone = recorded(vec![type_schema::<Action>()], &[foreign()]);
        assert_eq!(
            schema(&alone).encoding,
            SchemaEncoding::Other(String::new())
        );
    }

    #[test]
    fn two_publishers_of_two_definitions_stay_apart() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
        let mut definitions = Definitions::default();
        let topic: Arc<str> = "/wm/action".into();
        let qos = QosProfile::reliable();
        definitions.announce(
            topic.clone(),
            NAME.to_owned(),
            vec![type_schema::<Action>()],
            qos,
        );
        for (time, data) in (1..).zip([own(), foreign(), own()]) {
            definitions.write(&mut writer, &topic, time, &data).unwrap();
        }
        writer.finish().unwrap();
        let reader = BagReader::open(&bag).unwrap();
        let decoded = reader
            .messages()
            .map(|m| m.unwrap().decode::<Action>().is_ok());
        assert_eq!(decoded.collect::<Vec<_>>(), [true, false, true]);
    }
}
