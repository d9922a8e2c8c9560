//! Keys of data, and the names in them.

use crate::names::{TypeKind, TypeName};

/// What the type and the hash of an endpoint of any type match.
const ANY: &str = "*";

/// The key of a topic or service: `<domain>/<name>/<type>/<hash>`. Without a hash, it matches every one.
pub(super) fn data_key(
    domain: u16,
    name: &str,
    type_name: &TypeName,
    hash: Option<&str>,
) -> String {
    let name = name.trim_matches('/');
    let (type_name, hash) = (wire_type(type_name), hash.unwrap_or(ANY));
    format!("{domain}/{name}/{type_name}/{hash}")
}

/// The key of messages that ROS 2 Lyrical sends to subscriptions that receive sequences of bytes in host memory
/// (`buffer_endpoint_helpers.hpp` of rmw_zenoh).
pub(super) fn byte_sequence_key(data_key: &str) -> String {
    format!("{data_key}/_buf_cpu")
}

/// The type of a topic, or of a service, as on the wire: `wm_msgs::msg::dds_::Latent_`.
pub(super) fn wire_type(type_name: &TypeName) -> String {
    let (package, kind, name) = (&type_name.package, type_name.kind.text(), &type_name.name);
    format!("{package}::{kind}::dds_::{name}_")
}

/// The ROS name of a type on the wire; `None` if it does not belong to ROS.
pub(super) fn ros_type(wire_type: &str) -> Option<TypeName> {
    let (scope, name) = wire_type.strip_suffix('_')?.split_once("::dds_::")?;
    let (package, kind) = scope.rsplit_once("::")?;
    TypeKind::parse(kind)?;
    let text = format!("{package}/{kind}/{name}");
    TypeName::parse_message(&text)
        .or_else(|_| TypeName::parse_service(&text))
        .ok()
}

/// A name as one chunk of a liveliness token.
pub(super) fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// The name in a chunk of a liveliness token.
pub(super) fn demangled(chunk: &str) -> String {
    chunk.replace('%', "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::wm_msgs::action::Plan;

    #[test]
    fn keys_are_those_of_rmw_zenoh() {
        let string = TypeName::message("std_msgs", "String");
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        assert_eq!(
            data_key(2, "/chatter", &string, Some(hash)),
            format!("2/chatter/std_msgs::msg::dds_::String_/{hash}")
        );
        assert_eq!(
            data_key(0, "/robot1/chatter", &string, None),
            "0/robot1/chatter/std_msgs::msg::dds_::String_/*"
        );
        let goal = TypeName::of_action::<Plan>("SendGoal");
        assert_eq!(
            data_key(0, "/wm/plan/_action/send_goal", &goal, Some("h")),
            "0/wm/plan/_action/send_goal/wm_msgs::action::dds_::Plan_SendGoal_/h"
        );
    }

    #[test]
    fn types_survive_and_other_types_are_none() {
        for type_name in [
            TypeName::message("std_msgs", "String"),
            TypeName::service("wm_msgs", "Reset"),
            TypeName::of_action::<Plan>("FeedbackMessage"),
        ] {
            assert_eq!(ros_type(&wire_type(&type_name)), Some(type_name));
        }
        for other in [
            "",
            "String",
            "a::b::C_",
            "a::msg::dds_::",
            "::msg::dds_::A_",
        ] {
            assert_eq!(ros_type(other), None, "{other}");
        }
    }
}
