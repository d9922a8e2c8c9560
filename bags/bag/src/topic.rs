use std::sync::Arc;

use crate::{Durability, MessageEncoding, QosProfile, Schema, known_qos};

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The full name, for example `/camera/image_raw`.
    pub name: Arc<str>,
    /// The type, as `package/msg/Type`; of protobuf as `package.Type`.
    pub type_name: Arc<str>,
    /// How the messages are encoded.
    pub encoding: MessageEncoding,
    /// The type's definition; without a text for protobuf.
    pub schema: Arc<Schema>,
    /// `offered_qos_profiles` as the recorder wrote it (YAML); empty when it wrote none.
    pub qos_yaml: Arc<str>,
    /// `type_description_hash` as the recorder wrote it (`RIHS01_...`, REP-2016); empty when it wrote none.
    pub type_hash: Arc<str>,
    /// Messages of this topic in all files.
    pub message_count: u64,
}

impl TopicInfo {
    /// The first QoS profile that the recorded publishers offered. If it is absent or unreadable, that for which the topic
    /// is known ([`known_qos`]), if there is one.
    #[must_use]
    pub fn qos(&self) -> Option<QosProfile> {
        let recorded = QosProfile::parse_yaml(&self.qos_yaml).ok();
        let recorded = recorded.and_then(|profiles| profiles.into_iter().next());
        recorded.or_else(|| known_qos(&self.name))
    }

    /// Whether a late subscriber receives the last message too.
    #[must_use]
    pub fn is_latched(&self) -> bool {
        self.qos()
            .is_some_and(|qos| qos.durability == Durability::TransientLocal)
    }
}
