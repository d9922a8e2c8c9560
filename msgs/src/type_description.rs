//! The fields of a ROS type, read from its `.msg`, `.srv` or `.action` text, and the hash by which ROS identifies types.
//!
//! The hash is REP-2016's `RIHS01`: SHA-256 over the canonical JSON of `type_description_interfaces`, as
//! `rosidl_generator_type_description` computes it. Constants, default values and comments are no part of it.
//!
//! ```
//! use wm_msgs::{TypeDescription, std_msgs};
//!
//! let hash = TypeDescription::of::<std_msgs::Header>()?.hash();
//! assert_eq!(hash.to_string(), "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01");
//! # Ok::<(), wm_msgs::DescriptionError>(())
//! ```

mod definition;
mod error;
mod field;
mod hash;
mod idl;

pub use error::DescriptionError;
pub use field::{Field, FieldType, IndividualType};
pub use hash::TypeHash;
pub use idl::idl_definitions;

use crate::{
    Action, Message, Service, builtin_interfaces::Time, service_msgs::ServiceEventInfo,
    unique_identifier_msgs::UUID,
};
use std::collections::BTreeMap;

/// A type that names more types than this is refused: definitions may come from anywhere.
const REFERENCED_LIMIT: usize = 256;

const EVENT_INFO: &str = "service_msgs/msg/ServiceEventInfo";
const TIME: &str = "builtin_interfaces/msg/Time";
const GOAL_ID: &str = "unique_identifier_msgs/msg/UUID";

/// Names and definitions of the types that rosidl adds to every service.
const OF_SERVICES: [(&str, &str); 2] = [
    (EVENT_INFO, ServiceEventInfo::DEFINITION),
    (TIME, Time::DEFINITION),
];

/// A type and all types that it names, transitively.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDescription {
    /// The type itself.
    pub described: IndividualType,
    /// The types that it names, sorted by name.
    pub referenced: Vec<IndividualType>,
}

impl TypeDescription {
    /// The description of a message type.
    ///
    /// # Errors
    /// An invalid definition. A test describes every type of this crate.
    pub fn of<M: Message>() -> Result<Self, DescriptionError> {
        Self::message(&M::ros_name(), M::DEFINITION, M::dependencies())
    }

    /// The description of a service type.
    ///
    /// # Errors
    /// An invalid definition. A test describes every type of this crate.
    pub fn of_service<S: Service>() -> Result<Self, DescriptionError> {
        Self::service(&S::ros_name(), S::DEFINITION, S::dependencies())
    }

    /// The description of an action type of this crate.
    ///
    /// # Errors
    /// Its definition is not one; a test holds every type of this crate.
    pub fn of_action<A: Action>() -> Result<Self, DescriptionError> {
        Self::action(&A::ros_name(), A::DEFINITION, A::dependencies())
    }

    /// The description of the message type `name` with this `.msg` text. `dependencies`: names and texts of at least
    /// the types that it names, transitively. Names are `package/msg/Type` or `package/Type`.
    ///
    /// # Errors
    /// An invalid name or line, or a missing dependency.
    pub fn message<'a>(
        name: &str,
        text: &str,
        dependencies: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let name = canonical(name);
        let described = definition::parse(&name, text)?;
        Self::gather(described, [], dependencies)
    }

    /// The description of the service type `name`, `package/srv/Type`, with this `.srv` text.
    ///
    /// # Errors
    /// As [`message`](Self::message), and a text without the line `---` between request and response.
    pub fn service<'a>(
        name: &str,
        text: &str,
        dependencies: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let [request, response] = &definition::split_parts(text)[..] else {
            return Err(DescriptionError::NoResponse {
                name: name.to_owned(),
            });
        };
        let [described, parts @ ..] = service_types(
            name,
            definition::parse(&part(name, "Request"), request)?,
            definition::parse(&part(name, "Response"), response)?,
        );
        let given = dependencies.into_iter().chain(OF_SERVICES);
        Self::gather(described, parts, given)
    }

    /// The description of the action type `name`, `package/action/Type`, with this `.action` text. `name` may also be a
    /// type that rosidl makes of the action, for example `package/action/Type_SendGoal`.
    ///
    /// # Errors
    /// As [`message`](Self::message), a text without two lines `---` between goal, result and feedback, and a name that
    /// rosidl does not make.
    pub fn action<'a>(
        name: &str,
        text: &str,
        dependencies: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let split = definition::split_parts(text);
        let [goal, result, feedback] = &split[..] else {
            return Err(DescriptionError::NoParts {
                name: name.to_owned(),
                found: split.len() - 1,
            });
        };
        // Packages may have underscores in their names, action types have none.
        let wrong_name = || DescriptionError::Name(name.to_owned());
        let (package, type_name) = name.rsplit_once('/').ok_or_else(wrong_name)?;
        let type_name = type_name.split_once('_').map_or(type_name, |(own, _)| own);
        let mut types = action_types(&format!("{package}/{type_name}"), goal, result, feedback)?;
        let described = types.iter().position(|described| described.name == name);
        let described = types.swap_remove(described.ok_or_else(wrong_name)?);
        let of_actions = [(GOAL_ID, UUID::DEFINITION)];
        let given = dependencies.into_iter().chain(OF_SERVICES);
        Self::gather(described, types, given.chain(of_actions))
    }

    /// Collects the types that `described` names: from `parts`, which are parsed, and from the definitions in `given`.
    fn gather<'a>(
        described: IndividualType,
        parts: impl IntoIterator<Item = IndividualType>,
        given: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let named = |part: IndividualType| (part.name.clone(), part);
        let mut parts: BTreeMap<_, _> = parts.into_iter().map(named).collect();
        let given: BTreeMap<String, &str> = given
            .into_iter()
            .map(|(name, text)| (canonical(name), text))
            .collect();
        let names_of = |part: &IndividualType| -> Vec<(String, String)> {
            let nested = part
                .fields
                .iter()
                .filter_map(|field| field.field_type.nested.clone());
            nested.map(|named| (part.name.clone(), named)).collect()
        };
        let mut referenced: BTreeMap<String, IndividualType> = BTreeMap::new();
        let mut waiting = names_of(&described);
        while let Some((by, name)) = waiting.pop() {
            if referenced.contains_key(&name) {
                continue;
            }
            if referenced.len() >= REFERENCED_LIMIT {
                return Err(DescriptionError::TooMany {
                    name: described.name,
                    limit: REFERENCED_LIMIT,
                });
            }
            let part = match (parts.remove(&name), given.get(&name)) {
                (Some(part), _) => part,
                (None, Some(text)) => definition::parse(&name, text)?,
                (None, None) => return Err(DescriptionError::Missing { name, by }),
            };
            waiting.extend(names_of(&part));
            referenced.insert(name, part);
        }
        Ok(Self {
            described,
            referenced: referenced.into_values().collect(),
        })
    }

    /// The type's hash.
    #[must_use]
    pub fn hash(&self) -> TypeHash {
        TypeHash::of(self)
    }
}

/// The name of a type that rosidl makes of another type.
fn part(name: &str, suffix: &str) -> String {
    format!("{name}_{suffix}")
}

/// A service, its two halves, and the event that rosidl adds to every service:
/// <https://design.ros2.org/articles/service_introspection.html>.
fn service_types(
    name: &str,
    request: IndividualType,
    response: IndividualType,
) -> [IndividualType; 4] {
    let nested = |field: &str, suffix: &str| Field::nested(field, &part(name, suffix));
    let service = IndividualType {
        name: name.to_owned(),
        fields: vec![
            nested("request_message", "Request"),
            nested("response_message", "Response"),
            nested("event_message", "Event"),
        ],
    };
    let event = IndividualType {
        name: part(name, "Event"),
        fields: vec![
            Field::nested("info", EVENT_INFO),
            nested("request", "Request").at_most(1),
            nested("response", "Response").at_most(1),
        ],
    };
    [service, request, response, event]
}

/// An action and all types that rosidl makes of it: <https://design.ros2.org/articles/actions.html>.
fn action_types(
    name: &str,
    goal: &str,
    result: &str,
    feedback: &str,
) -> Result<Vec<IndividualType>, DescriptionError> {
    let nested = |field: &str, suffix: &str| Field::nested(field, &part(name, suffix));
    let made = |suffix: &str, fields: Vec<Field>| IndividualType {
        name: part(name, suffix),
        fields,
    };
    let parse = |suffix: &str, text: &str| definition::parse(&part(name, suffix), text);
    let goal_id = || Field::nested("goal_id", GOAL_ID);
    let stamp = Field::nested("stamp", TIME);

    let action = IndividualType {
        name: name.to_owned(),
        fields: vec![
            nested("goal", "Goal"),
            nested("result", "Result"),
            nested("feedback", "Feedback"),
            nested("send_goal_service", "SendGoal"),
            nested("get_result_service", "GetResult"),
            nested("feedback_message", "FeedbackMessage"),
        ],
    };
    let own = [
        parse("Goal", goal)?,
        parse("Result", result)?,
        parse("Feedback", feedback)?,
        made(
            "FeedbackMessage",
            vec![goal_id(), nested("feedback", "Feedback")],
        ),
    ];
    let mut accepted = parse("SendGoal_Response", "bool accepted")?;
    accepted.fields.push(stamp);
    let send_goal = service_types(
        &part(name, "SendGoal"),
        made("SendGoal_Request", vec![goal_id(), nested("goal", "Goal")]),
        accepted,
    );
    let mut ended = parse("GetResult_Response", "int8 status")?;
    ended.fields.push(nested("result", "Result"));
    let get_result = service_types(
        &part(name, "GetResult"),
        made("GetResult_Request", vec![goal_id()]),
        ended,
    );
    Ok([action]
        .into_iter()
        .chain(own)
        .chain(send_goal)
        .chain(get_result)
        .collect())
}

/// `package/Type` as `package/msg/Type`; any other name as it is.
fn canonical(name: &str) -> String {
    match name.split('/').collect::<Vec<_>>()[..] {
        [package, type_name] => format!("{package}/msg/{type_name}"),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests;
