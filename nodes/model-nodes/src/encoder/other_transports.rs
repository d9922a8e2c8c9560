//! Cameras that publish by transports that the nodes do not read.

use std::collections::BTreeSet;

use wm_camera::transport::Transport;
use wm_ros::{Node, RemoteEndpoint, Role, logging::of_others};

/// Topics that are named at most.
const MOST: usize = 8;

/// Logs topics with pictures that the nodes do not read, each with the remedy.
pub(super) fn warn(node: &Node) {
    for advice in advice(node.remote_endpoints()) {
        tracing::warn!("no camera image yet: {advice}");
    }
}

fn advice(endpoints: Vec<RemoteEndpoint>) -> BTreeSet<String> {
    let publishers = endpoints.into_iter().filter(|e| e.role == Role::Publisher);
    let advice = publishers.filter_map(|endpoint| {
        let transport = Transport::of(&endpoint.name, &endpoint.type_name)?;
        transport.advice(&of_others(&endpoint.name))
    });
    advice.take(MOST).collect()
}

#[cfg(test)]
mod tests {
    use wm_ros::Qos;

    use super::*;

    #[test]
    fn topics_that_are_not_read_are_named() {
        let endpoint = |role, name: &str, type_name: &str| RemoteEndpoint {
            role,
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            qos: Qos::sensor_data(),
            participant: [0; 12],
        };
        let packet = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket";
        let found = advice(vec![
            endpoint(Role::Publisher, "/camera/image_raw/ffmpeg", packet),
            endpoint(Role::Subscription, "/other/ffmpeg", packet),
            endpoint(
                Role::Publisher,
                "/camera/image_raw",
                "sensor_msgs/msg/Image",
            ),
            endpoint(Role::Publisher, "/note", "std_msgs/msg/String"),
        ]);
        let found: Vec<String> = found.into_iter().collect();
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].starts_with("/camera/image_raw/ffmpeg is compressed video"),
            "{found:?}"
        );
    }
}
