use wm_msgs::lifecycle_msgs;

/// A state of a managed node: the four primary states, in which it waits for requests, and the transition states. The
/// numbers are those of `lifecycle_msgs/msg/State`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Listed because rcl lists it; no node is ever in it.
    Unknown = 0,
    /// Has only its parameters.
    Unconfigured = 1,
    /// Has its resources, and does not work.
    Inactive = 2,
    /// Works.
    Active = 3,
    /// Has ended.
    Finalized = 4,
    /// From unconfigured to inactive.
    Configuring = 10,
    /// From inactive to unconfigured.
    CleaningUp = 11,
    /// From any primary state to finalized.
    ShuttingDown = 12,
    /// From inactive to active.
    Activating = 13,
    /// From active to inactive.
    Deactivating = 14,
    /// A transition failed.
    ErrorProcessing = 15,
}

impl State {
    /// All states, in rcl's order.
    pub const ALL: [Self; 11] = [
        Self::Unknown,
        Self::Unconfigured,
        Self::Inactive,
        Self::Active,
        Self::Finalized,
        Self::Configuring,
        Self::CleaningUp,
        Self::ShuttingDown,
        Self::Activating,
        Self::Deactivating,
        Self::ErrorProcessing,
    ];

    /// The number in messages.
    #[must_use]
    pub const fn id(self) -> u8 {
        self as u8
    }

    /// The name in messages.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
            Self::Configuring => "configuring",
            Self::CleaningUp => "cleaningup",
            Self::ShuttingDown => "shuttingdown",
            Self::Activating => "activating",
            Self::Deactivating => "deactivating",
            Self::ErrorProcessing => "errorprocessing",
        }
    }

    pub(super) fn message(self) -> lifecycle_msgs::State {
        lifecycle_msgs::State {
            id: self.id(),
            label: self.label().to_owned(),
        }
    }
}
