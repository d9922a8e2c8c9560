//! What a ROS type is made of, read from its `.msg` or `.srv` text, and the hash by which ROS tells types apart.
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

pub use error::DescriptionError;
pub use field::{Field, FieldType};
pub use hash::TypeHash;

use crate::{Message, Service, packages::service_msgs};
use std::collections::BTreeMap;

/// A type that names more others than this is refused: definitions may come from anywhere.
const REFERENCED_LIMIT: usize = 256;

/// One type, without those that it names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndividualType {
    /// `package/msg/Type`; of a service `package/srv/Type`, and with `_Request`, `_Response`, `_Event` its parts.
    pub name: String,
    /// In order.
    pub fields: Vec<Field>,
}

/// A type and all that it names, transitively.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDescription {
    /// The type itself.
    pub described: IndividualType,
    /// What it names, sorted by name.
    pub referenced: Vec<IndividualType>,
}

impl TypeDescription {
    /// The description of a message type of this crate.
    ///
    /// # Errors
    /// Its definition is not one; a test holds every type of this crate.
    pub fn of<M: Message>() -> Result<Self, DescriptionError> {
        Self::message(&M::ros_name(), M::DEFINITION, M::dependencies())
    }

    /// The description of a service type of this crate.
    ///
    /// # Errors
    /// Its definition is not one; a test holds every type of this crate.
    pub fn of_service<S: Service>() -> Result<Self, DescriptionError> {
        Self::service(&S::ros_name(), S::DEFINITION, S::dependencies())
    }

    /// The description of the message type `name` with this `.msg` text. `dependencies`: names and texts of at least
    /// the types that it names, transitively. Names are `package/msg/Type` or `package/Type`.
    ///
    /// # Errors
    /// A name that is none, a line that is no field, or a type that is named but not given.
    pub fn message<'a>(
        name: &str,
        text: &str,
        dependencies: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let name = canonical(name);
        let described = definition::parse(&name, text)?;
        Self::gather(described, BTreeMap::new(), dependencies)
    }

    /// The description of the service type `name`, `package/srv/Type`, with this `.srv` text.
    ///
    /// # Errors
    /// As [`message`](Self::message), and where the text has no line `---` between request and response.
    pub fn service<'a>(
        name: &str,
        text: &str,
        dependencies: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
        let (request, response) =
            definition::split_service(text).ok_or_else(|| DescriptionError::NoResponse {
                name: name.to_owned(),
            })?;
        let part = |suffix: &str| format!("{name}_{suffix}");
        let nested = |field: &str, suffix: &str| Field::nested(field, &part(suffix));
        let described = IndividualType {
            name: name.to_owned(),
            fields: vec![
                nested("request_message", "Request"),
                nested("response_message", "Response"),
                nested("event_message", "Event"),
            ],
        };
        // What rosidl makes of every service: https://design.ros2.org/articles/service_introspection.html
        let event = IndividualType {
            name: part("Event"),
            fields: vec![
                Field::nested("info", service_msgs::SERVICE_EVENT_INFO.0),
                nested("request", "Request").at_most(1),
                nested("response", "Response").at_most(1),
            ],
        };
        let parts = [
            definition::parse(&part("Request"), request)?,
            definition::parse(&part("Response"), response)?,
            event,
        ];
        let parts = parts.map(|part| (part.name.clone(), part)).into();
        let given = dependencies
            .into_iter()
            .chain([service_msgs::SERVICE_EVENT_INFO, service_msgs::TIME]);
        Self::gather(described, parts, given)
    }

    /// Follows the names from `described`: to `parts`, which are read already, and to the definitions in `given`.
    fn gather<'a>(
        described: IndividualType,
        mut parts: BTreeMap<String, IndividualType>,
        given: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, DescriptionError> {
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

/// `package/Type` as `package/msg/Type`; any other name as it is.
fn canonical(name: &str) -> String {
    match name.split('/').collect::<Vec<_>>()[..] {
        [package, type_name] => format!("{package}/msg/{type_name}"),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests;
