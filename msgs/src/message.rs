use serde::{Serialize, de::DeserializeOwned};

/// A ROS message type. Its fields have the order of the `.msg` file, so that serde's view of it is its CDR form.
pub trait Message: Serialize + DeserializeOwned + Clone + Send + Sync + 'static {
    /// The package, for example `sensor_msgs`.
    const PACKAGE: &'static str;
    /// The type's name within the package, for example `Image`.
    const NAME: &'static str;
    /// The text of the `.msg` file.
    const DEFINITION: &'static str;
    /// ROS names (`package/msg/Type`) and texts of the types that [`Self::DEFINITION`] names, transitively, each once.
    fn dependencies() -> Vec<(&'static str, &'static str)>;

    /// The ROS name of the type, `package/msg/Type`.
    fn ros_name() -> String {
        format!("{}/msg/{}", Self::PACKAGE, Self::NAME)
    }
}

/// A ROS service type.
pub trait Service: 'static {
    /// The package, for example `wm_msgs`.
    const PACKAGE: &'static str;
    /// The type's name within the package, for example `Reset`.
    const NAME: &'static str;
    /// The text of the `.srv` file.
    const DEFINITION: &'static str;
    /// The request, sent by a client.
    type Request: Serialize + DeserializeOwned + Clone + Send + Sync + 'static;
    /// The response, sent by a server.
    type Response: Serialize + DeserializeOwned + Clone + Send + Sync + 'static;
    /// ROS names (`package/msg/Type`) and texts of the types that [`Self::DEFINITION`] names, transitively, each once.
    fn dependencies() -> Vec<(&'static str, &'static str)>;

    /// The ROS name of the type, `package/srv/Type`.
    fn ros_name() -> String {
        format!("{}/srv/{}", Self::PACKAGE, Self::NAME)
    }
}

/// A ROS action type.
pub trait Action: 'static {
    /// The package, for example `wm_msgs`.
    const PACKAGE: &'static str;
    /// The type's name within the package, for example `Plan`.
    const NAME: &'static str;
    /// The text of the `.action` file.
    const DEFINITION: &'static str;
    /// The goal, sent by a client.
    type Goal: Serialize + DeserializeOwned + Clone + Send + Sync + 'static;
    /// The result of a goal; the default if the server has none.
    type Result: Serialize + DeserializeOwned + Clone + Default + Send + Sync + 'static;
    /// The progress of a goal.
    type Feedback: Serialize + DeserializeOwned + Clone + Send + Sync + 'static;
    /// ROS names (`package/msg/Type`) and texts of the types that [`Self::DEFINITION`] names, transitively, each once.
    fn dependencies() -> Vec<(&'static str, &'static str)>;

    /// The ROS name of the type, `package/action/Type`.
    fn ros_name() -> String {
        format!("{}/action/{}", Self::PACKAGE, Self::NAME)
    }
}
