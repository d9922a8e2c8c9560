use crate::{DescriptionError, MESSAGE_TYPES, Message, TypeDescription};

/// A message type of this crate, found by its ROS name.
///
/// ```
/// use wm_msgs::{Message, MessageType, std_msgs::Header};
///
/// let header = MessageType::find("std_msgs/msg/Header").ok_or("missing")?;
/// assert_eq!(header.definition, Header::DEFINITION);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct MessageType {
    /// The ROS name, `package/msg/Type`.
    pub ros_name: &'static str,
    /// The text of the `.msg` file.
    pub definition: &'static str,
    dependencies: fn() -> Vec<(&'static str, &'static str)>,
}

impl MessageType {
    pub(crate) const fn new<M: Message>(ros_name: &'static str) -> Self {
        Self {
            ros_name,
            definition: M::DEFINITION,
            dependencies: M::dependencies,
        }
    }

    /// The type `package/msg/Type`, if this crate has it.
    #[must_use]
    pub fn find(ros_name: &str) -> Option<&'static Self> {
        MESSAGE_TYPES
            .iter()
            .find(|known| known.ros_name == ros_name)
    }

    /// ROS names and texts of the types that the definition names, transitively, each once.
    #[must_use]
    pub fn dependencies(&self) -> Vec<(&'static str, &'static str)> {
        (self.dependencies)()
    }

    /// The fields of the type.
    ///
    /// # Errors
    /// An invalid definition. A test describes every type of this crate.
    pub fn description(&self) -> Result<TypeDescription, DescriptionError> {
        TypeDescription::message(self.ros_name, self.definition, self.dependencies())
    }
}
