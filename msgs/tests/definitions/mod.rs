//! Compares the generated Rust types with their ROS definitions, which a second parser reads: names, order and types of the
//! fields, and constants.

mod describe;
mod hashes;
mod installation;
mod interface;

use describe::{Shape, describe};
use installation::Installation;
use interface::{Interface, Number, parse};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use wm_msgs::{
    Action, Message, MessageType, Service, TypeDescription,
    action_msgs::GoalStatus,
    diagnostic_msgs::DiagnosticStatus,
    geometry_msgs::Quaternion,
    rcl_interfaces::ListParametersRequest,
    visualization_msgs::Marker,
    wm_msgs::{EnvStepRequest, Latent},
};

// `DEFINITIONS` has names and texts of all types; `every_message!`, `every_service!` and `every_action!` call a generic
// function for each.
include!(concat!(env!("OUT_DIR"), "/every.rs"));

/// Compares a Rust type with the fields of a definition, following nested messages through `definitions`.
fn compare(shape: &Shape, package: &str, text: &str, definitions: &BTreeMap<String, String>) {
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
                compare(element, package, text, definitions);
            }
            other => panic!("{name}.{field}: unexpected {other:?}"),
        }
    }
}

fn compare_message<M: Message>() {
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
    compare(&shape, M::PACKAGE, M::DEFINITION, &definitions);
}

fn find_message<M: Message>() {
    let name = M::ros_name();
    let found = MessageType::find(&name);
    let found = found.map(|found| (found.definition, found.dependencies(), found.description()));
    let expected = (M::DEFINITION, M::dependencies(), TypeDescription::of::<M>());
    assert_eq!(found, Some(expected), "{name}");
}

#[test]
fn every_message_is_found_by_its_name() {
    every_message!(find_message);
    assert!(MessageType::find("std_srvs/srv/Trigger").is_none());
}

#[test]
fn every_message_has_the_fields_of_its_definition() {
    every_message!(compare_message);
}

/// Compares a type with a part of a definition.
fn compare_part<T: DeserializeOwned>(
    package: &str,
    text: &str,
    dependencies: Vec<(&'static str, &'static str)>,
) {
    let shape = describe::<T>();
    let Shape::Struct { fields, .. } = &shape else {
        panic!("expected a struct, got {shape:?}")
    };
    // rosidl gives this field to a part without fields
    if let [(name, Shape::Primitive(primitive))] = &fields[..]
        && name == "structure_needs_at_least_one_member"
    {
        assert_eq!((primitive.as_str(), text.trim()), ("uint8", ""));
        return;
    }
    let owned = |(name, text): (&str, &str)| (name.to_owned(), text.to_owned());
    let definitions = dependencies.into_iter().map(owned).collect();
    compare(&shape, package, text, &definitions);
}

#[test]
fn every_service_has_the_fields_of_its_definition() {
    fn compare_service<S: Service>() {
        let (request, response) = S::DEFINITION.split_once("---\n").unwrap();
        compare_part::<S::Request>(S::PACKAGE, request, S::dependencies());
        compare_part::<S::Response>(S::PACKAGE, response, S::dependencies());
    }
    every_service!(compare_service);
}

#[test]
fn every_action_has_the_fields_of_its_definition() {
    fn compare_action<A: Action>() {
        let parts: Vec<&str> = A::DEFINITION.split("---\n").collect();
        let [goal, result, feedback] = parts[..] else {
            panic!("{} has {} parts", A::NAME, parts.len())
        };
        compare_part::<A::Goal>(A::PACKAGE, goal, A::dependencies());
        compare_part::<A::Result>(A::PACKAGE, result, A::dependencies());
        compare_part::<A::Feedback>(A::PACKAGE, feedback, A::dependencies());
    }
    every_action!(compare_action);
}

#[test]
fn constants_and_defaults_are_those_of_the_definitions() {
    assert_eq!([Latent::F32, Latent::F16, Latent::BF16], [0, 1, 2]);
    assert_eq!(EnvStepRequest::FAILURE, 2);
    assert_eq!(GoalStatus::STATUS_ABORTED, 6_i8);
    assert_eq!(DiagnosticStatus::STALE, 3_u8);
    assert_eq!((Marker::SPHERE_LIST, Marker::DELETE), (7, 2));
    assert_eq!(ListParametersRequest::DEPTH_RECURSIVE, 0_u64);
    assert_eq!(Quaternion::default().w, 1.0);
    assert_eq!(Latent::default().height, 0);
}

/// If a ROS installation is found, our definitions are compared with its `.msg` files.
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
