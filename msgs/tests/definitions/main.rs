//! Holds every Rust type against its ROS definition: the names, order and types of the fields, and the constants.

#![allow(clippy::unwrap_used, reason = "a test's helpers may fail the test")]

mod describe;
#[macro_use]
mod every;
mod hashes;
mod installation;
mod interface;

use describe::{Shape, describe};
use installation::Installation;
use interface::{Interface, Number, parse};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use wm_msgs::{
    Action, Message, Service, action_msgs, diagnostic_msgs, visualization_msgs::Marker,
    wm_msgs as wm,
};

/// Compares a Rust type with the fields of a definition, following nested messages through `definitions`.
fn hold(shape: &Shape, package: &str, text: &str, definitions: &BTreeMap<String, String>) {
    let Shape::Struct { name, fields } = shape else {
        panic!("expected a struct, got {shape:?}")
    };
    let Interface {
        fields: expected, ..
    } = parse(package, text);
    let names: Vec<_> = fields.iter().map(|(name, _)| name.as_str()).collect();
    let expected_names: Vec<_> = expected.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names, expected_names, "fields of {name}");
    for ((field, shape), expected) in fields.iter().zip(&expected) {
        let element = match (shape, expected.number) {
            (Shape::Bytes, Number::Sequence) => {
                assert_eq!(
                    expected.type_name, "uint8",
                    "{name}.{field} is a byte sequence"
                );
                continue;
            }
            (Shape::Sequence(element), Number::Sequence) => {
                assert_ne!(
                    expected.type_name, "uint8",
                    "{name}.{field} wants serde_bytes: 40 times faster"
                );
                element
            }
            (Shape::Array(element, length), Number::Array(expected)) => {
                assert_eq!(*length, expected, "{name}.{field}");
                element
            }
            (shape, Number::One) => shape,
            (shape, number) => panic!("{name}.{field}: expected {number:?}, got {shape:?}"),
        };
        match element {
            Shape::Primitive(primitive) => {
                assert_eq!(primitive, &expected.type_name, "{name}.{field}");
            }
            Shape::Struct {
                name: rust_name, ..
            } => {
                let (package, ros_name) = expected.type_name.split_once("/msg/").unwrap();
                assert_eq!(rust_name, ros_name, "{name}.{field}");
                let text = definitions.get(&expected.type_name).unwrap_or_else(|| {
                    panic!("{name} does not list its dependency {}", expected.type_name)
                });
                hold(element, package, text, definitions);
            }
            other => panic!("{name}.{field}: unexpected {other:?}"),
        }
    }
}

fn hold_message<M: Message>() {
    let definitions: BTreeMap<_, _> = M::dependencies()
        .into_iter()
        .map(|(name, text)| (name.to_owned(), text.to_owned()))
        .collect();
    assert_eq!(
        definitions.len(),
        M::dependencies().len(),
        "{} lists a dependency twice",
        M::NAME
    );
    let shape = describe::<M>();
    assert!(
        matches!(&shape, Shape::Struct { name, .. } if name == M::NAME),
        "{shape:?} is named {}",
        M::NAME
    );
    hold(&shape, M::PACKAGE, M::DEFINITION, &definitions);
}

#[test]
fn every_message_has_the_fields_of_its_definition() {
    every_message!(hold_message);
}

/// The `.msg` files of the package, each of which must have a Rust type, so that none is forgotten.
#[test]
fn every_msg_file_has_a_rust_type() {
    let mut files: Vec<_> = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/msg"))
        .unwrap()
        .map(|entry| {
            entry
                .unwrap()
                .path()
                .file_stem()
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned()
        })
        .collect();
    files.sort();
    let mut types = Vec::new();
    fn note<M: Message>(types: &mut Vec<String>) {
        if M::PACKAGE == "wm_msgs" {
            types.push(M::NAME.to_owned());
        }
    }
    every_message!(note, &mut types);
    types.sort();
    assert_eq!(types, files);
}

/// Holds a type that is given by a part of a definition.
fn hold_part<T: DeserializeOwned>(
    package: &str,
    text: &str,
    dependencies: Vec<(&'static str, &'static str)>,
) {
    let shape = describe::<T>();
    let Shape::Struct { fields, .. } = &shape else {
        panic!("expected a struct, got {shape:?}")
    };
    // what rosidl gives a part without fields
    if let [(name, Shape::Primitive(primitive))] = &fields[..]
        && name == "structure_needs_at_least_one_member"
    {
        assert_eq!((primitive.as_str(), text.trim()), ("uint8", ""));
        return;
    }
    let owned = |(name, text): (&str, &str)| (name.to_owned(), text.to_owned());
    let definitions = dependencies.into_iter().map(owned).collect();
    hold(&shape, package, text, &definitions);
}

#[test]
fn every_service_has_the_fields_of_its_definition() {
    fn hold_service<S: Service>() {
        let (request, response) = S::DEFINITION.split_once("---\n").unwrap();
        hold_part::<S::Request>(S::PACKAGE, request, S::dependencies());
        hold_part::<S::Response>(S::PACKAGE, response, S::dependencies());
    }
    every_service!(hold_service);
}

#[test]
fn every_action_has_the_fields_of_its_definition() {
    fn hold_action<A: Action>() {
        let parts: Vec<&str> = A::DEFINITION.split("---\n").collect();
        let [goal, result, feedback] = parts[..] else {
            panic!("{} has {} parts", A::NAME, parts.len())
        };
        hold_part::<A::Goal>(A::PACKAGE, goal, A::dependencies());
        hold_part::<A::Result>(A::PACKAGE, result, A::dependencies());
        hold_part::<A::Feedback>(A::PACKAGE, feedback, A::dependencies());
    }
    every_action!(hold_action);
}

#[test]
fn constants_are_those_of_the_definitions() {
    let constants = |package, text| parse(package, text).constants;
    let latent = constants("wm_msgs", wm::Latent::DEFINITION);
    assert_eq!(
        latent,
        [
            ("F32", wm::Latent::F32),
            ("F16", wm::Latent::F16),
            ("BF16", wm::Latent::BF16)
        ]
        .map(|(name, value)| (name.to_owned(), value.to_string()))
    );
    assert_eq!(
        constants("wm_msgs", wm::ExecutorStatus::DEFINITION),
        [
            ("DRY_RUN", wm::ExecutorStatus::DRY_RUN),
            ("IDLE", wm::ExecutorStatus::IDLE),
            ("EXECUTING", wm::ExecutorStatus::EXECUTING),
            ("STOPPING", wm::ExecutorStatus::STOPPING),
            ("STOPPED", wm::ExecutorStatus::STOPPED)
        ]
        .map(|(name, value)| (name.to_owned(), value.to_string()))
    );
    use action_msgs::GoalStatus;
    assert_eq!(
        constants("action_msgs", GoalStatus::DEFINITION),
        [
            ("STATUS_UNKNOWN", GoalStatus::STATUS_UNKNOWN),
            ("STATUS_ACCEPTED", GoalStatus::STATUS_ACCEPTED),
            ("STATUS_EXECUTING", GoalStatus::STATUS_EXECUTING),
            ("STATUS_CANCELING", GoalStatus::STATUS_CANCELING),
            ("STATUS_SUCCEEDED", GoalStatus::STATUS_SUCCEEDED),
            ("STATUS_CANCELED", GoalStatus::STATUS_CANCELED),
            ("STATUS_ABORTED", GoalStatus::STATUS_ABORTED)
        ]
        .map(|(name, value)| (name.to_owned(), value.to_string()))
    );
    use action_msgs::CancelGoalResponse as Cancelled;
    let (_, response) = action_msgs::CancelGoal::DEFINITION
        .split_once("---\n")
        .unwrap();
    assert_eq!(
        constants("action_msgs", response),
        [
            ("ERROR_NONE", Cancelled::ERROR_NONE),
            ("ERROR_REJECTED", Cancelled::ERROR_REJECTED),
            ("ERROR_UNKNOWN_GOAL_ID", Cancelled::ERROR_UNKNOWN_GOAL_ID),
            ("ERROR_GOAL_TERMINATED", Cancelled::ERROR_GOAL_TERMINATED)
        ]
        .map(|(name, value)| (name.to_owned(), value.to_string()))
    );
    use diagnostic_msgs::DiagnosticStatus as Status;
    assert_eq!(
        constants("diagnostic_msgs", Status::DEFINITION),
        [
            ("OK", Status::OK),
            ("WARN", Status::WARN),
            ("ERROR", Status::ERROR),
            ("STALE", Status::STALE)
        ]
        .map(|(name, value)| (name.to_owned(), value.to_string()))
    );
}

/// Of many constants only those that the suite uses have a name in Rust.
#[test]
fn constants_of_markers_are_those_of_the_definition() {
    let constants = parse("visualization_msgs", Marker::DEFINITION).constants;
    for (name, value) in [
        ("CUBE", Marker::CUBE),
        ("SPHERE", Marker::SPHERE),
        ("LINE_STRIP", Marker::LINE_STRIP),
        ("LINE_LIST", Marker::LINE_LIST),
        ("SPHERE_LIST", Marker::SPHERE_LIST),
        ("ADD", Marker::ADD),
        ("DELETE", Marker::DELETE),
    ] {
        let constant = (name.to_owned(), value.to_string());
        assert!(constants.contains(&constant), "{constant:?}");
    }
}

/// With a ROS installation at hand, our short definitions are held against its `.msg` files.
#[test]
fn definitions_are_those_of_the_ros_installation() {
    let Some(installation) = Installation::find() else {
        return;
    };
    fn check<M: Message>(installation: &Installation) {
        let Some(text) = installation.read(&M::ros_name(), "msg") else {
            return;
        };
        let theirs = parse(M::PACKAGE, &text);
        assert_eq!(
            parse(M::PACKAGE, M::DEFINITION),
            theirs,
            "{}",
            M::ros_name()
        );
    }
    every_message!(check, &installation);
}
