//! `~/get_type_description`: the definitions of the types that a node uses, as in rcl.

use crate::{
    backend::TypeInfo,
    type_description_interfaces::{
        Field, FieldType, GetTypeDescriptionRequest, GetTypeDescriptionResponse,
        IndividualTypeDescription, TypeDescription as Description, TypeSource,
    },
};
use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard, PoisonError},
};
use wm_msgs::{
    Action, DescriptionError, IndividualType, Message, MessageType, Service, TypeDescription,
    action_msgs::{CancelGoal, GoalStatusArray},
};

/// The text of a type, and the texts of the types that it contains.
#[derive(Clone)]
struct Interface {
    /// The type of the text: for a generated type, the type from which rosidl generates it.
    defined: String,
    text: &'static str,
    dependencies: Vec<(&'static str, &'static str)>,
}

/// The types that a node uses, by their ROS names.
#[derive(Default)]
pub(super) struct Interfaces {
    used: Mutex<BTreeMap<String, Interface>>,
    /// Types with definitions from elsewhere.
    foreign: Mutex<BTreeMap<String, TypeInfo>>,
}

impl Interfaces {
    pub(super) fn message<M: Message>(&self) {
        let name = M::ros_name();
        self.add(name.clone(), name, M::DEFINITION, M::dependencies);
    }

    pub(super) fn service<S: Service>(&self) {
        let name = S::ros_name();
        self.add(name.clone(), name, S::DEFINITION, S::dependencies);
    }

    /// An action, and the types that rosidl generates for its server and its clients.
    pub(super) fn action<A: Action>(&self) {
        let action = A::ros_name();
        for made in ["", "_SendGoal", "_GetResult", "_FeedbackMessage"] {
            let name = format!("{action}{made}");
            self.add(name, action.clone(), A::DEFINITION, A::dependencies);
        }
        self.service::<CancelGoal>();
        self.message::<GoalStatusArray>();
    }

    fn add(
        &self,
        name: String,
        defined: String,
        text: &'static str,
        dependencies: impl FnOnce() -> Vec<(&'static str, &'static str)>,
    ) {
        self.used().entry(name).or_insert_with(|| Interface {
            defined,
            text,
            dependencies: dependencies(),
        });
    }

    /// The hash of a type that the node uses, or that this suite defines; `None` for any other.
    pub(super) fn info(&self, name: &str) -> Option<TypeInfo> {
        let interface = self.used().get(name).cloned();
        let description = match (interface, MessageType::find(name)) {
            (Some(interface), _) => interface.describe(name),
            (None, Some(message)) => message.description(),
            (None, None) if name == GetTypeDescriptionRequest::SERVICE => {
                return Some(TypeInfo {
                    hash: Some(GetTypeDescriptionRequest::HASH.to_owned()),
                    has_byte_sequence: false,
                });
            }
            (None, None) => return None,
        };
        // a test describes every definition of the suite
        description
            .ok()
            .map(|description| TypeInfo::of(&description))
    }

    /// As [`info`](Self::info), of the definition given to [`describe`](Self::describe), if any.
    pub(super) fn described(&self, name: &str) -> Option<TypeInfo> {
        let foreign = self.foreign().get(name).cloned();
        foreign.or_else(|| self.info(name))
    }

    /// Sets the definition of a type for endpoints made by name.
    pub(super) fn describe(&self, description: &TypeDescription) {
        let name = description.described.name.clone();
        self.foreign().insert(name, TypeInfo::of(description));
    }

    /// No invariant spans the lock.
    fn used(&self) -> MutexGuard<'_, BTreeMap<String, Interface>> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// No invariant spans the lock.
    fn foreign(&self) -> MutexGuard<'_, BTreeMap<String, TypeInfo>> {
        self.foreign.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The reply to a request.
    pub(super) fn answer(&self, request: &GetTypeDescriptionRequest) -> GetTypeDescriptionResponse {
        match self.find(request) {
            Ok(response) => response,
            Err(failure_reason) => GetTypeDescriptionResponse {
                failure_reason,
                ..GetTypeDescriptionResponse::default()
            },
        }
    }

    fn find(
        &self,
        request: &GetTypeDescriptionRequest,
    ) -> Result<GetTypeDescriptionResponse, String> {
        let name = request.type_name.as_str();
        let interface = self.used().get(name).cloned();
        let interface =
            interface.ok_or_else(|| format!("this node does not use the type {name}"))?;
        let description = interface
            .describe(name)
            .map_err(|error| error.to_string())?;
        let hash = description.hash().to_string();
        if request.type_hash != hash {
            return Err(format!(
                "the type {name} has the hash {hash} in this node, not `{}`",
                request.type_hash
            ));
        }
        let type_sources = match request.include_type_sources {
            true => interface.sources(&description),
            false => Vec::new(),
        };
        Ok(GetTypeDescriptionResponse {
            successful: true,
            failure_reason: String::new(),
            type_description: Description {
                type_description: individual(description.described),
                referenced_type_descriptions: description
                    .referenced
                    .into_iter()
                    .map(individual)
                    .collect(),
            },
            type_sources,
            extra_information: Vec::new(),
        })
    }
}

impl Interface {
    fn describe(&self, name: &str) -> Result<TypeDescription, DescriptionError> {
        let dependencies = self.dependencies.iter().copied();
        if name.contains("/srv/") {
            TypeDescription::service(name, self.text, dependencies)
        } else if name.contains("/action/") {
            TypeDescription::action(name, self.text, dependencies)
        } else {
            TypeDescription::message(name, self.text, dependencies)
        }
    }

    /// The text of the type and of each type that it contains; `implicit` if rosidl generates the type from another's
    /// text.
    fn sources(&self, description: &TypeDescription) -> Vec<TypeSource> {
        let source = |part: &IndividualType| {
            let is_own = part.name == self.defined;
            let given = self
                .dependencies
                .iter()
                .find(|(name, _)| *name == part.name);
            let text = if is_own {
                Some(self.text)
            } else {
                given.map(|(_, text)| *text)
            };
            let encoding = match text {
                Some(_) if part.name.contains("/srv/") => "srv",
                Some(_) if part.name.contains("/action/") => "action",
                Some(_) => "msg",
                None => "implicit",
            };
            TypeSource {
                type_name: part.name.clone(),
                encoding: encoding.to_owned(),
                raw_file_contents: text.unwrap_or_default().to_owned(),
            }
        };
        std::iter::once(&description.described)
            .chain(&description.referenced)
            .map(source)
            .collect()
    }
}

/// The type ids of unbounded sequences of `uint8` and `char` (REP 2016).
const BYTE_SEQUENCES: [u8; 2] = [147, 157];

impl TypeInfo {
    fn of(description: &TypeDescription) -> Self {
        let parts = std::iter::once(&description.described).chain(&description.referenced);
        let mut fields = parts.flat_map(|part| &part.fields);
        Self {
            hash: Some(description.hash().to_string()),
            has_byte_sequence: fields
                .any(|field| BYTE_SEQUENCES.contains(&field.field_type.type_id)),
        }
    }
}

fn individual(part: IndividualType) -> IndividualTypeDescription {
    let field = |field: wm_msgs::Field| Field {
        name: field.name,
        r#type: FieldType {
            type_id: field.field_type.type_id,
            capacity: field.field_type.capacity,
            string_capacity: field.field_type.string_capacity,
            nested_type_name: field.field_type.nested.unwrap_or_default(),
        },
        // Neither hash nor serialisation depends on it, and the texts contain it.
        default_value: String::new(),
    };
    IndividualTypeDescription {
        type_name: part.name,
        fields: part.fields.into_iter().map(field).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{
        rcl_interfaces::{Log, SetParameters},
        std_msgs::Header,
        wm_msgs::{Reset, action::Plan},
    };

    fn ask(name: &str, type_hash: String) -> GetTypeDescriptionResponse {
        let interfaces = Interfaces::default();
        interfaces.message::<Header>();
        interfaces.service::<Reset>();
        interfaces.action::<Plan>();
        interfaces.message::<Log>();
        interfaces.service::<SetParameters>();
        interfaces.answer(&GetTypeDescriptionRequest {
            type_name: name.to_owned(),
            type_hash,
            include_type_sources: true,
        })
    }

    #[test]
    fn types_in_use_are_described_and_others_are_not() {
        let hash = TypeDescription::of::<Header>().unwrap().hash().to_string();
        let answer = ask("std_msgs/msg/Header", hash.clone());
        assert!(answer.successful, "{}", answer.failure_reason);
        let described = answer.type_description;
        assert_eq!(described.type_description.type_name, "std_msgs/msg/Header");
        assert_eq!(described.type_description.fields.len(), 2);
        assert_eq!(described.referenced_type_descriptions.len(), 1);
        let sources: Vec<_> = answer
            .type_sources
            .iter()
            .map(|source| (source.type_name.as_str(), source.encoding.as_str()))
            .collect();
        assert_eq!(
            sources,
            [
                ("std_msgs/msg/Header", "msg"),
                ("builtin_interfaces/msg/Time", "msg")
            ]
        );

        let wrong = ask("std_msgs/msg/Header", "RIHS01_00".to_owned());
        assert!(!wrong.successful && wrong.failure_reason.contains(&hash));
        let unused = ask("std_msgs/msg/String", hash);
        assert!(!unused.successful && unused.failure_reason.contains("std_msgs/msg/String"));
    }

    #[test]
    fn services_and_types_without_a_rust_type_are_described() {
        let hash = TypeDescription::of_service::<Reset>().unwrap().hash();
        let answer = ask("wm_msgs/srv/Reset", hash.to_string());
        assert!(answer.successful, "{}", answer.failure_reason);
        let encodings = answer.type_sources.iter();
        let encodings: Vec<_> = encodings.map(|source| source.encoding.as_str()).collect();
        assert!(encodings.contains(&"srv") && encodings.contains(&"implicit"));
        for name in ["rcl_interfaces/msg/Log", "rcl_interfaces/srv/SetParameters"] {
            let reason = ask(name, String::new()).failure_reason;
            let (_, hash) = reason.split_once("the hash ").unwrap();
            let hash = hash.split(' ').next().unwrap();
            let answer = ask(name, hash.to_owned());
            assert!(answer.successful, "{name}: {}", answer.failure_reason);
        }
    }

    #[test]
    fn an_action_is_described_with_what_is_made_of_it() {
        let (text, given) = (Plan::DEFINITION, Plan::dependencies());
        for made in ["", "_SendGoal", "_GetResult", "_FeedbackMessage"] {
            let name = format!("wm_msgs/action/Plan{made}");
            let description = TypeDescription::action(&name, text, given.iter().copied()).unwrap();
            let answer = ask(&name, description.hash().to_string());
            assert!(answer.successful, "{name}: {}", answer.failure_reason);
            let sources = answer.type_sources.iter();
            let of_action = sources.filter(|source| source.encoding == "action").count();
            // rosidl has no text for generated types
            assert_eq!(of_action, usize::from(made.is_empty()), "{name}");
        }
        for name in [
            "action_msgs/srv/CancelGoal",
            "action_msgs/msg/GoalStatusArray",
        ] {
            assert!(
                ask(name, String::new()).failure_reason.contains("hash"),
                "{name}"
            );
        }
    }
}
