//! ROS' names and types in DDS, and back.

use crate::backend::{Channel, Endpoint};
use ros2_client::MessageTypeName;

/// ROS 2's spelling of a name in DDS: <https://design.ros2.org/articles/topic_and_service_names.html>.
pub(super) fn dds_name(endpoint: &Endpoint) -> String {
    match endpoint.channel {
        Channel::Topic => format!("rt{}", endpoint.name),
        Channel::Request => format!("rq{}Request", endpoint.name),
        Channel::Response => format!("rr{}Reply", endpoint.name),
    }
}

pub(super) fn dds_type(endpoint: &Endpoint) -> String {
    let (package, name) = (&endpoint.type_name.package, &endpoint.type_name.name);
    match endpoint.channel {
        Channel::Topic => MessageTypeName::new(package, name).dds_msg_type(),
        Channel::Request => format!("{package}::srv::dds_::{name}_Request_"),
        Channel::Response => format!("{package}::srv::dds_::{name}_Response_"),
    }
}

/// What a DDS topic is to ROS, its ROS name and its type; `None` for what is not ROS'.
pub(super) fn ros_names(dds_name: &str, dds_type: &str) -> Option<(Channel, String, String)> {
    let (prefix, rest) = dds_name.split_at_checked(2)?;
    let (channel, name, kind, suffix) = match prefix {
        "rt" => (Channel::Topic, rest, "msg", "_"),
        "rq" => (
            Channel::Request,
            rest.strip_suffix("Request")?,
            "srv",
            "_Request_",
        ),
        "rr" => (
            Channel::Response,
            rest.strip_suffix("Reply")?,
            "srv",
            "_Response_",
        ),
        _ => return None,
    };
    let (package, type_name) = dds_type
        .strip_suffix(suffix)?
        .split_once(&format!("::{kind}::dds_::"))?;
    (name.starts_with('/') && name.len() > 1).then(|| {
        (
            channel,
            name.to_owned(),
            format!("{package}/{kind}/{type_name}"),
        )
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{Qos, names::TypeName};

    pub(in crate::dds) fn endpoint(channel: Channel) -> Endpoint {
        Endpoint {
            channel,
            name: "/wm/predictor/reset".into(),
            type_name: TypeName {
                package: "wm_msgs".into(),
                name: "Reset".into(),
            },
            qos: Qos::reliable(10),
            hears_own: true,
        }
    }

    #[test]
    fn names_are_spelled_as_every_rmw_spells_them() {
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
    }

    #[test]
    fn names_are_read_back_and_what_is_not_ros_is_not() {
        for channel in [Channel::Topic, Channel::Request, Channel::Response] {
            let endpoint = endpoint(channel);
            let kind = match channel {
                Channel::Topic => "msg",
                Channel::Request | Channel::Response => "srv",
            };
            let expected = (
                channel,
                endpoint.name.clone(),
                format!("wm_msgs/{kind}/Reset"),
            );
            let read = ros_names(&dds_name(&endpoint), &dds_type(&endpoint));
            assert_eq!(read, Some(expected));
        }
        assert_eq!(ros_names("rq/a/b", "x::srv::dds_::B_Request_"), None);
        assert_eq!(
            ros_names(
                "ros_discovery_info",
                "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
            ),
            None
        );
        assert_eq!(ros_names("rt", "a::msg::dds_::B_"), None);
    }
}
