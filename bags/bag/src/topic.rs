use std::sync::Arc;

use crate::{Durability, MessageEncoding, QosProfile, Schema, known_qos};

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The full name, for example `/camera/image_raw`.
    pub name: Arc<str>,
    /// The type: `package/msg/Type`, for protobuf `package.Type`.
    pub type_name: Arc<str>,
    /// Encoding of the messages.
    pub encoding: MessageEncoding,
    /// The type's definition; for protobuf without a text.
    pub schema: Arc<Schema>,
    /// The recorder's `offered_qos_profiles` (YAML); may be empty.
    pub qos_yaml: Arc<str>,
    /// The recorder's `type_description_hash` (`RIHS01_...`, REP-2016); may be empty.
    pub type_hash: Arc<str>,
    /// Number of messages in all files.
    pub message_count: u64,
}

impl TopicInfo {
    /// The first QoS profile that the recorded publishers offered; if missing or invalid, the conventional one of the topic
    /// ([`known_qos`]).
    #[must_use]
    pub fn qos(&self) -> Option<QosProfile> {
        let recorded = QosProfile::parse_yaml(&self.qos_yaml).ok();
        let recorded = recorded.and_then(|profiles| profiles.into_iter().next());
        recorded.or_else(|| known_qos(&self.name))
    }

    /// Whether late subscribers receive the last message.
    #[must_use]
    pub fn is_latched(&self) -> bool {
        self.qos()
            .is_some_and(|qos| qos.durability == Durability::TransientLocal)
    }
}
