use std::fmt;
use uuid::Uuid;
use wm_msgs::unique_identifier_msgs::UUID;

/// Identity of a goal, in the whole graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GoalId(pub [u8; 16]);

impl GoalId {
    /// A unique id: a random UUID (version 4).
    pub(crate) fn new() -> Self {
        Self(Uuid::new_v4().into_bytes())
    }
}

impl From<UUID> for GoalId {
    fn from(message: UUID) -> Self {
        Self(message.uuid)
    }
}

impl From<GoalId> for UUID {
    fn from(id: GoalId) -> Self {
        Self { uuid: id.0 }
    }
}

impl fmt::Display for GoalId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Uuid::from_bytes(self.0).fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_read_as_ros_prints_it() {
        let id = GoalId(std::array::from_fn(|index| index as u8));
        assert_eq!(id.to_string(), "00010203-0405-0607-0809-0a0b0c0d0e0f");
        assert_eq!(GoalId::from(UUID::from(id)), id);
        assert_ne!(GoalId::new(), GoalId::new());
    }
}
