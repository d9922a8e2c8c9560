//! A second participant on loopback, for reliable writers of topics that this process also reads.
//!
//! rustdds 0.15.1 connects a new writer with the readers of its own participant, but sends it nothing on loopback.
//! These readers acknowledge nothing, so the publisher would start DDS writer after DDS writer ([`super::line`]). Two
//! participants do not have this fault. [`crate::dds::local`] delivers between the two. ROS tools show these writers,
//! but not their node.

use super::{introduction::introduce, lease::OwnPort, line::Maker, socket_filter::Ports};
use crate::{
    Error, Reliability,
    backend::{Channel, Endpoint},
    dds::identity::participant_of,
    dds::{
        Dds, participant,
        qos::for_reader,
        shared::{SecondParticipant, follow},
    },
    lock::lock,
};
use futures::FutureExt as _;
use rustdds::{DomainParticipant, QosPolicies, RTPSEntity as _};
use std::sync::Arc;

impl Dds {
    pub(in crate::dds) fn needs_second_participant(&self, endpoint: &Endpoint) -> bool {
        self.environment.is_on_loopback()
            && !self.environment.is_alone()
            && endpoint.channel == Channel::Topic
            && endpoint.qos.reliability == Reliability::Reliable
            && self.shared.nodes.reads(endpoint)
    }

    /// Makes writers of the second participant, which joins the domain if necessary.
    pub(in crate::dds) fn second_maker(
        &self,
        endpoint: &Endpoint,
        qos: QosPolicies,
    ) -> Result<Maker, Error> {
        let mut second = lock(&self.shared.second);
        let SecondParticipant {
            participant,
            publisher,
        } = match &mut *second {
            Some(second) => second,
            none => none.insert(self.join_again()?),
        };
        let topic = participant::topic(participant, endpoint, &for_reader(endpoint.qos))?;
        let publisher = publisher.clone();
        Ok(Maker {
            publisher,
            topic,
            qos,
        })
    }

    /// Starts the tasks of a participant: its discovery events, and the announcements that rustdds does not send.
    pub(in crate::dds) fn start_tasks(&self, participant: &DomainParticipant) -> Result<(), Error> {
        let failed = |source| Error::io("open a UDP socket", source);
        let own = participant.guid().to_bytes();
        let (domain, number) = (self.environment.domain_id, participant.participant_id());
        let (failure, runtime) = (&self.shared.failure, &self.runtime);
        let mut own_port = None;
        if let Some(address) = self.addresses.first() {
            let port = Ports::new(domain, number).discovery();
            let port = Arc::new(OwnPort::new(own, address, port).map_err(failed)?);
            self.shared.own_port.get_or_init(|| Arc::clone(&port));
            own_port = Some(Arc::clone(&port));
            let lease = async move { port.keep_alive().await };
            failure.watch(runtime, "own lease", lease);
        } else if self.environment.is_on_loopback() && !self.environment.is_alone() {
            let socket = self.shared.wire.socket().map_err(failed)?;
            let introduction = introduce(socket, own, domain, number);
            failure.watch(runtime, "announcements", introduction);
        }
        let events = participant.status_listener();
        let follow = follow(events, Arc::clone(&self.shared), own_port);
        failure.watch(runtime, "discovery", follow.boxed());
        Ok(())
    }

    fn join_again(&self) -> Result<SecondParticipant, Error> {
        let participant = participant::join(&self.environment)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant
            .create_publisher(&defaults)
            .map_err(|error| Error::middleware("join a second time", error))?;
        let peer = participant_of(&participant.guid().to_bytes());
        self.shared.second_peer.get_or_init(|| peer);
        self.start_tasks(&participant)?;
        Ok(SecondParticipant {
            participant,
            publisher,
        })
    }
}
