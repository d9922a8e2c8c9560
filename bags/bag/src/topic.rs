use std::sync::Arc;

use crate::{QosProfile, Schema};

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The full name, for example `/camera/image_raw`.
    pub name: Arc<str>,
    /// The type, as `package/msg/Type`.
    pub type_name: Arc<str>,
    /// The type's definition.
    pub schema: Arc<Schema>,
    /// `offered_qos_profiles` as the recorder wrote it (YAML); empty when it wrote none.
    pub qos_yaml: Arc<str>,
    /// `type_description_hash` as the recorder wrote it (`RIHS01_...`, REP-2016); empty when it wrote none.
    pub type_hash: Arc<str>,
    /// Messages of this topic in all files.
    pub message_count: u64,
}

impl TopicInfo {
    /// The first QoS profile that the recorded publishers offered; none when absent or unreadable.
    #[must_use]
    pub fn qos(&self) -> Option<QosProfile> {
        QosProfile::parse_yaml(&self.qos_yaml)
            .ok()?
            .into_iter()
            .next()
    }
}
