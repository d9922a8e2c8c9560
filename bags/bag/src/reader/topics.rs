//! The topics of a bag, from its files and its `metadata.yaml`.

use std::{collections::BTreeMap, sync::Arc};

use super::file_index::FileIndex;
use crate::{
    BagWarning, MessageEncoding, QosProfile, Schema, TopicInfo,
    metadata::{Metadata, TopicMetadata},
    schema::absolute,
    writer::REPEATED_PREFIX,
};

/// The topics of all files, by name. If a topic has several types, the channels of the less frequent types are skipped.
pub(super) fn merge_topics(index: &mut [FileIndex]) -> BTreeMap<Arc<str>, TopicInfo> {
    let mut types: BTreeMap<Arc<str>, Vec<(Arc<str>, u64)>> = BTreeMap::new();
    for channel in index.iter().flat_map(|file| file.channels.values()) {
        let (topic, counts) = (&channel.topic, types.entry(Arc::clone(&channel.topic.name)));
        let counts = counts.or_default();
        match counts.iter_mut().find(|(name, _)| *name == topic.type_name) {
            Some((_, count)) => *count += topic.message_count,
            None => counts.push((Arc::clone(&topic.type_name), topic.message_count)),
        }
    }
    for (name, counts) in types.iter().filter(|(_, counts)| counts.len() > 1) {
        // On a tie, the first type wins.
        let main = counts.iter().rev().max_by_key(|(_, count)| *count);
        if let Some((main, _)) = main {
            skip_other_types(index, name, main);
        }
    }
    let mut topics: BTreeMap<Arc<str>, TopicInfo> = BTreeMap::new();
    for channel in index.iter().flat_map(|file| file.channels.values()) {
        let topic = &channel.topic;
        match topics.get_mut(&topic.name) {
            Some(known) => {
                known.message_count += topic.message_count;
                if known.qos_yaml.is_empty() {
                    known.qos_yaml = Arc::clone(&topic.qos_yaml);
                }
            }
            None => {
                topics.insert(Arc::clone(&topic.name), topic.clone());
            }
        }
    }
    topics
}

fn skip_other_types(index: &mut [FileIndex], name: &str, main: &str) {
    for file in index {
        let others: Vec<(u16, String)> = file
            .channels
            .iter()
            .filter(|(_, channel)| {
                *channel.topic.name == *name && *channel.topic.type_name != *main
            })
            .map(|(id, channel)| (*id, channel.topic.type_name.to_string()))
            .collect();
        for (id, type_name) in others {
            file.skip(
                id,
                name,
                format!("it has the type {type_name}, most messages have {main}"),
            );
        }
    }
}

/// Subtracts latched messages that later files repeat from the counts.
pub(super) fn subtract_repetitions(
    topics: &mut BTreeMap<Arc<str>, TopicInfo>,
    metadata: &Metadata,
    files: usize,
) {
    let notes = metadata.custom_data.iter().flatten().filter(|_| files > 1);
    for (key, count) in notes {
        let topic = key
            .strip_prefix(REPEATED_PREFIX)
            .and_then(|name| topics.get_mut(name));
        if let (Some(topic), Ok(count)) = (topic, count.parse()) {
            topic.message_count = topic.message_count.saturating_sub(count);
        }
    }
}

/// Adds topics without messages, and missing QoS profiles and type hashes, from `metadata.yaml`.
pub(super) fn add_from_metadata(
    topics: &mut BTreeMap<Arc<str>, TopicInfo>,
    metadata: &Metadata,
    index: &[FileIndex],
    warnings: &mut Vec<BagWarning>,
) {
    for listed in &metadata.topics_with_message_count {
        let listed = &listed.topic_metadata;
        let qos_yaml: Arc<str> = qos_text(listed).into();
        let type_hash: Arc<str> = listed.type_description_hash.as_str().into();
        let name: Arc<str> = absolute(&listed.name).into();
        if let Some(known) = topics.get_mut(&name) {
            let has_qos = QosProfile::parse_yaml(&known.qos_yaml).is_ok_and(|qos| !qos.is_empty());
            if !has_qos && !qos_yaml.is_empty() {
                known.qos_yaml = qos_yaml;
            }
            if known.type_hash.is_empty() {
                known.type_hash = type_hash;
            }
            continue;
        }
        let is_known = |file: &FileIndex| file.skipped.values().any(|s| s.topic == listed.name);
        if index.iter().any(is_known) {
            continue;
        }
        match silent_topic(listed, Arc::clone(&name), qos_yaml, type_hash) {
            Ok(topic) => {
                topics.insert(name, topic);
            }
            Err(reason) => warnings.push(BagWarning::ChannelSkipped {
                file: crate::metadata::FILE_NAME.into(),
                topic: listed.name.clone(),
                messages: 0,
                reason,
            }),
        }
    }
}

/// A topic without messages.
///
/// # Errors
/// The reason why its messages could not be read.
fn silent_topic(
    listed: &TopicMetadata,
    name: Arc<str>,
    qos_yaml: Arc<str>,
    type_hash: Arc<str>,
) -> Result<TopicInfo, String> {
    let (encoding, type_name) =
        MessageEncoding::of_channel(&listed.serialization_format, Some(&listed.type_name))?;
    let schema = Arc::new(Schema {
        encoding: "".into(),
        text: String::new(),
    });
    Ok(TopicInfo {
        name,
        type_name: type_name.into(),
        encoding,
        schema,
        qos_yaml,
        type_hash,
        message_count: 0,
    })
}

/// The profiles as YAML text: metadata has a list since version 9, a text earlier.
fn qos_text(listed: &TopicMetadata) -> String {
    match &listed.offered_qos_profiles {
        serde_yaml_ng::Value::Null => String::new(),
        serde_yaml_ng::Value::String(text) => text.clone(),
        // Cannot fail: the value was read from YAML.
        profiles => serde_yaml_ng::to_string(profiles).unwrap_or_default(),
    }
}
