//! Definitions of types that are unknown to this suite and to the installed ROS packages. A live publisher describes
//! its type by the service `~/get_type_description` (REP 2016), for the type hash that it announces.

use std::{collections::BTreeSet, fmt::Write as _, sync::Arc, time::Duration};
use tokio::{
    sync::{Semaphore, mpsc},
    time::timeout,
};
use wm_bag::Schema;
use wm_msgs::{IndividualType, TypeDescription};
use wm_ros::{Node, TopicInfo};

/// Log text for a type without a definition.
pub(super) const UNDEFINED: &str =
    "is not on AMENT_PREFIX_PATH: it is recorded without its definition";
/// Longest wait for all publishers of a topic.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest wait for one node.
const NODE_PATIENCE: Duration = Duration::from_secs(2);
/// Time between two attempts, while the services of nodes are not discovered yet.
const PAUSE: Duration = Duration::from_millis(200);
/// Most topics that are looked up at the same time.
const AT_A_TIME: usize = 8;

/// Name of a type without a definition, and the reason.
pub(super) type Undefined = (String, String);

/// The lookups of a recording.
pub(super) struct Lookups {
    node: Node,
    permits: Arc<Semaphore>,
    undefined: mpsc::UnboundedSender<Undefined>,
}

/// The lookup of the definition of one topic's type.
pub(super) struct Lookup {
    node: Node,
    permits: Arc<Semaphore>,
    undefined: mpsc::UnboundedSender<Undefined>,
    type_name: String,
    /// GUID prefix of each publisher's participant, and its type hash.
    publishers: BTreeSet<([u8; 12], String)>,
}

impl Lookups {
    /// Lookups for `node`. The receiver gets the types without a definition.
    pub fn new(node: &Node) -> (Self, mpsc::UnboundedReceiver<Undefined>) {
        let (undefined, types) = mpsc::unbounded_channel();
        let lookups = Self {
            node: node.clone(),
            permits: Arc::new(Semaphore::new(AT_A_TIME)),
            undefined,
        };
        (lookups, types)
    }

    /// A lookup for this topic; `None` if no publisher announces the hash of its type.
    pub fn of(&self, topic: &TopicInfo) -> Option<Lookup> {
        let publishers = self.node.type_hashes(&topic.name);
        (!publishers.is_empty()).then(|| Lookup {
            node: self.node.clone(),
            permits: Arc::clone(&self.permits),
            undefined: self.undefined.clone(),
            type_name: topic.type_name.clone(),
            publishers,
        })
    }
}

impl Lookup {
    /// The definitions of the publishers, requested for at most [`PATIENCE`]. Reports the type if there is none.
    pub async fn candidates(self) -> Vec<Schema> {
        let reason = match timeout(PATIENCE, self.request_all()).await {
            Ok(Ok(found)) => return found,
            Ok(Err(reason)) => reason,
            Err(_) => format!("no publisher describes it within {} s", PATIENCE.as_secs()),
        };
        let what = format!("{UNDEFINED} ({reason})");
        // The receiver is gone after the recording.
        self.undefined.send((self.type_name, what)).ok();
        Vec::new()
    }

    async fn request_all(&self) -> Result<Vec<Schema>, String> {
        let permit = self.permits.acquire().await;
        let _permit = permit.map_err(|error| error.to_string())?;
        let mut refused = BTreeSet::new();
        loop {
            let mut found = Vec::new();
            let mut described = BTreeSet::new();
            let mut problem = None;
            for (participant, hash) in &self.publishers {
                for node in self.node.nodes_of(*participant) {
                    if described.contains(hash) || refused.contains(&node) {
                        continue;
                    }
                    match self.request(&node, hash).await {
                        Some(Ok(schema)) => {
                            described.insert(hash);
                            found.push(schema);
                        }
                        Some(Err(reason)) => {
                            problem = Some(reason);
                            refused.insert(node);
                        }
                        None => {}
                    }
                }
            }
            match problem {
                _ if !found.is_empty() => return Ok(found),
                Some(reason) => return Err(reason),
                None => tokio::time::sleep(PAUSE).await,
            }
        }
    }

    /// Requests the definition from a node; `None` if it does not answer.
    async fn request(&self, node: &str, hash: &str) -> Option<Result<Schema, String>> {
        let description = self.node.type_description(node, &self.type_name, hash);
        let description = timeout(NODE_PATIENCE, description).await.ok()?;
        Some(match description {
            Ok(Ok(description)) => schema(&description),
            Ok(Err(reason)) => Err(reason),
            Err(error) => Err(error.to_string()),
        })
    }
}

/// The definition as `.msg` text: without comments, constants and default values, which a description lacks.
///
/// # Errors
/// The reason: a name or a type that `.msg` text cannot have.
pub(super) fn schema(description: &TypeDescription) -> Result<Schema, String> {
    let described = &description.described;
    let parts: Vec<(&str, String)> = description
        .referenced
        .iter()
        .map(|part| (part.name.as_str(), text(part)))
        .collect();
    let own = text(described);
    // A peer chose the names: the text is valid only if it reads as the same type.
    let given = parts.iter().map(|(name, text)| (*name, text.as_str()));
    let read = TypeDescription::message(&described.name, &own, given);
    let read = read.map_err(|error| error.to_string())?;
    if read.hash() != description.hash() {
        return Err(format!(
            "its description has names or types that a .msg file cannot have: {}",
            described.name.escape_debug()
        ));
    }
    let mut all = own;
    for (name, text) in &parts {
        let name = name.replace("/msg/", "/");
        // Writing to a String cannot fail.
        write!(all, "\n{}\nMSG: {name}\n{text}", "=".repeat(80)).ok();
    }
    Ok(Schema::ros2msg(all))
}

fn text(part: &IndividualType) -> String {
    let fields = part.fields.iter();
    fields
        .map(|field| format!("{} {}\n", field.field_type, field.name))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{
        Message, diagnostic_msgs::DiagnosticArray, sensor_msgs::CameraInfo, std_msgs,
        tf2_msgs::TFMessage, trajectory_msgs::JointTrajectory, wm_msgs::Plan,
    };

    fn assert_described<M: Message>() {
        let description = TypeDescription::of::<M>().unwrap();
        let schema = schema(&description).unwrap();
        let read = schema.description(&M::ros_name()).unwrap();
        assert_eq!(read, Some(description));
    }

    #[test]
    fn definition_of_a_description_reads_as_the_same_type() {
        assert_described::<std_msgs::String>();
        assert_described::<std_msgs::Header>();
        assert_described::<CameraInfo>();
        assert_described::<TFMessage>();
        assert_described::<DiagnosticArray>();
        assert_described::<JointTrajectory>();
        assert_described::<Plan>();
    }

    #[test]
    fn bounds_arrays_and_parts_are_in_the_text() {
        let own =
            "string<=9[<=3] names\nfloat64[9] k\nPart[] parts\nwstring w\n# nothing\nint8 A=1\n";
        let given = [("my_msgs/msg/Part", "builtin_interfaces/Time at\n")];
        let time = ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n");
        let description =
            TypeDescription::message("my_msgs/msg/Whole", own, given.into_iter().chain([time]));
        let description = description.unwrap();
        let line = "=".repeat(80);
        let expected = format!(
            "string<=9[<=3] names\nfloat64[9] k\nmy_msgs/Part[] parts\nwstring w\n\n{line}\nMSG: builtin_interfaces/Time\n\
             int32 sec\nuint32 nanosec\n\n{line}\nMSG: my_msgs/Part\nbuiltin_interfaces/Time at\n"
        );
        assert_eq!(schema(&description), Ok(Schema::ros2msg(expected)));
    }

    #[test]
    fn descriptions_that_no_text_can_have_are_refused() {
        let good = TypeDescription::of::<std_msgs::Header>().unwrap();
        let with = |edit: fn(&mut TypeDescription)| {
            let mut description = good.clone();
            edit(&mut description);
            schema(&description)
        };
        for edit in [
            (|d| d.described.fields[1].name = "a b".into()) as fn(&mut TypeDescription),
            |d| d.described.fields[1].name = "a\nint8 b".into(),
            |d| d.described.fields[1].field_type.type_id = 200,
            |d| d.described.fields[0].field_type.nested = Some("../Time".into()),
            |d| d.described.name = "std_msgs/Header\nMSG".into(),
            |d| d.referenced.clear(),
            |d| d.referenced.push(d.described.clone()),
        ] {
            assert!(with(edit).is_err());
        }
        assert!(with(|_| {}).is_ok());
    }
}
