//! Conversion of names and types between ROS and DDS.

use super::buffer_channels;
use crate::{
    backend::{Channel, Endpoint},
    names::TypeKind,
};

/// See <https://design.ros2.org/articles/topic_and_service_names.html>.
pub(super) fn dds_name(endpoint: &Endpoint) -> String {
    match endpoint.channel {
        Channel::Topic => format!("rt{}", endpoint.name),
        Channel::Request => format!("rq{}Request", endpoint.name),
        Channel::Response => format!("rr{}Reply", endpoint.name),
    }
}

pub(super) fn dds_type(endpoint: &Endpoint) -> String {
    let type_name = &endpoint.type_name;
    let (package, kind, name) = (&type_name.package, type_name.kind.text(), &type_name.name);
    let suffix = match endpoint.channel {
        Channel::Topic => "_",
        Channel::Request => "_Request_",
        Channel::Response => "_Response_",
    };
    format!("{package}::{kind}::dds_::{name}{suffix}")
}

/// The channel, ROS name and ROS type of a DDS topic; `None` if it does not belong to ROS, or is a channel of buffers.
pub(super) fn ros_names(dds_name: &str, dds_type: &str) -> Option<(Channel, String, String)> {
    let (prefix, rest) = dds_name.split_at_checked(2)?;
    let (channel, name, kind, suffix) = match prefix {
        "rt" => (Channel::Topic, rest, TypeKind::Message, "_"),
        "rq" => (
            Channel::Request,
            rest.strip_suffix("Request")?,
            TypeKind::Service,
            "_Request_",
        ),
        "rr" => (
            Channel::Response,
            rest.strip_suffix("Reply")?,
            TypeKind::Service,
            "_Response_",
        ),
        _ => return None,
    };
    let (scope, type_name) = dds_type.strip_suffix(suffix)?.split_once("::dds_::")?;
    let (package, found) = scope.rsplit_once("::")?;
    let found = TypeKind::parse(found)?;
    // actions have services and topics
    if found != kind && found != TypeKind::Action {
        return None;
    }
    (name.starts_with('/') && name.len() > 1 && !buffer_channels::is_channel(name)).then(|| {
        let type_name = format!("{package}/{}/{type_name}", found.text());
        (channel, name.to_owned(), type_name)
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{Qos, names::TypeName};
    use wm_msgs::wm_msgs::action::Plan;

    pub(in crate::dds) fn endpoint(channel: Channel) -> Endpoint {
        Endpoint {
            channel,
            name: "/wm/predictor/reset".into(),
            type_name: match channel {
                Channel::Topic => TypeName::message("wm_msgs", "Reset"),
                Channel::Request | Channel::Response => TypeName::service("wm_msgs", "Reset"),
            },
            type_info: None,
            qos: Qos::reliable(10),
            receives_own: true,
            has_siblings: false,
        }
    }

    #[test]
    fn names_match_those_of_other_rmws() {
        assert_eq!(dds_name(&endpoint(Channel::Topic)), "rt/wm/predictor/reset");
        assert_eq!(
            dds_name(&endpoint(Channel::Request)),
            "rq/wm/predictor/resetRequest"
        );
        assert_eq!(
            dds_name(&endpoint(Channel::Response)),
            "rr/wm/predictor/resetReply"
        );
        assert_eq!(
            dds_type(&endpoint(Channel::Topic)),
            "wm_msgs::msg::dds_::Reset_"
        );
        assert_eq!(
            dds_type(&endpoint(Channel::Response)),
            "wm_msgs::srv::dds_::Reset_Response_"
        );
        let feedback = Endpoint {
            name: "/wm/plan/_action/feedback".into(),
            type_name: TypeName::of_action::<Plan>("FeedbackMessage"),
            ..endpoint(Channel::Topic)
        };
        assert_eq!(
            dds_type(&feedback),
            "wm_msgs::action::dds_::Plan_FeedbackMessage_"
        );
    }

    #[test]
    fn ros_names_survive_and_other_names_are_ignored() {
        for channel in [Channel::Topic, Channel::Request, Channel::Response] {
            let of_action = Endpoint {
                name: "/wm/plan/_action/send_goal".into(),
                type_name: TypeName::of_action::<Plan>("SendGoal"),
                ..endpoint(channel)
            };
            for endpoint in [endpoint(channel), of_action] {
                let type_name = endpoint.type_name.to_string();
                let expected = (channel, endpoint.name.clone(), type_name);
                let read = ros_names(&dds_name(&endpoint), &dds_type(&endpoint));
                assert_eq!(read, Some(expected));
            }
        }
        assert_eq!(ros_names("rq/a/b", "x::srv::dds_::B_Request_"), None);
        assert_eq!(
            ros_names(
                "ros_discovery_info",
                "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
            ),
            None
        );
        assert_eq!(ros_names("rt/a", "x::srv::dds_::B_"), None);
        assert_eq!(ros_names("rt", "a::msg::dds_::B_"), None);
    }

    #[test]
    fn buffer_channels_of_lyrical_are_no_topics() {
        let image = "sensor_msgs::msg::dds_::Image_";
        assert_eq!(ros_names("rt/camera/image_raw/_buf_cpu", image), None);
        let plain = ros_names("rt/camera/image_raw", image);
        assert!(plain.is_some_and(|(_, name, _)| name == "/camera/image_raw"));
    }
}
