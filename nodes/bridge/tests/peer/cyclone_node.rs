//! A node whose services work like those of rmw_cyclonedds, which the real bridge requires: the client's identity and
//! the call's number precede request and response. Other nodes, ours included, have them in the header of the datagram.

use ros2_client::{
    Client, Context, Message, Name, Node, NodeName, NodeOptions, QosProfile, Server,
    ServiceMapping, ServiceTypeName,
    qos::{History, WhenFull},
};
use rustdds::DomainParticipantBuilder;
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, Ipv4Addr};
use wm_msgs::wm_msgs::{ResetRequest, ResetResponse};

/// A request or response.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Body<T>(pub T);

impl<T: Serialize + for<'de> Deserialize<'de>> Message for Body<T> {}

/// The node `/cyclone`.
pub struct CycloneNode {
    node: Node,
    spinning: tokio::task::JoinHandle<()>,
}

impl CycloneNode {
    pub fn join(domain: u16) -> Self {
        let loopback = IpAddr::from(Ipv4Addr::LOCALHOST);
        let participant = DomainParticipantBuilder::new(domain).with_only_networks([loopback]);
        let context = Context::from_domain_participant(participant.build().unwrap()).unwrap();
        let name = NodeName::new("/", "cyclone").unwrap();
        let options = NodeOptions::new().enable_rosout(false);
        let mut node = context.new_node(name, options).unwrap();
        let spinner = node.spinner().unwrap();
        let spinning = tokio::spawn(async move { spinner.spin().await.unwrap() });
        Self { node, spinning }
    }

    pub fn server(&mut self, name: &str) -> Server<Body<ResetRequest>, Body<ResetResponse>> {
        let (name, service) = names(name);
        let server =
            self.node
                .create_server(ServiceMapping::Cyclone, &name, &service, qos(), qos());
        server.unwrap()
    }

    pub fn client(&mut self, name: &str) -> Client<Body<ResetRequest>, Body<ResetResponse>> {
        let (name, service) = names(name);
        let client =
            self.node
                .create_client(ServiceMapping::Cyclone, &name, &service, qos(), qos());
        client.unwrap()
    }

    pub async fn wait_for(&self, client: &Client<Body<ResetRequest>, Body<ResetResponse>>) {
        client.wait_for_service(&self.node).await;
    }
}

impl Drop for CycloneNode {
    fn drop(&mut self) {
        self.spinning.abort();
    }
}

fn names(name: &str) -> (Name, ServiceTypeName) {
    let name = Name::new("/wm", name).unwrap();
    (name, ServiceTypeName::new("wm_msgs", "Reset"))
}

fn qos() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::DEFAULT)
        .history(History::KeepLast { depth: 10 })
}
