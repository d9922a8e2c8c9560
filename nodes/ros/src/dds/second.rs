//! A second participant for reliable writers of topics that this process reads as well, where it is bound to loopback.
//!
//! rustdds 0.15.1 connects a new writer with the readers of its own participant, but sends nothing to its own participant
//! by loopback: they acknowledge nothing, and after [`RELIABLE_WINDOW`](super::qos::RELIABLE_WINDOW) samples the writer
//! takes no more, whoever else listens. Between two participants all is well; what the two say to each other is left, as
//! within one, for the delivery in memory ([`super::local`]). ROS tools show the writers, but not whose they are.

use super::{
    Dds,
    codec::Raw,
    lock::lock,
    parts::peer_of,
    shared::{Second, follow},
    topic,
};
use crate::{
    Environment, Error, Reliability,
    backend::{Channel, Endpoint},
};
use bytes::Bytes;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity as _,
    dds::result::CreateResult, no_key::DataWriter,
};
use std::sync::Arc;

/// A participant of the domain, not yet in anybody's book.
pub(super) fn participant(environment: &Environment) -> Result<DomainParticipant, Error> {
    let mut builder = DomainParticipantBuilder::new(environment.domain_id);
    if let Some(addresses) = environment.addresses() {
        builder = builder.with_only_networks(addresses);
    }
    if environment.is_alone() {
        // without it, it would announce itself to the first participants of this host
        builder = builder.same_host_loopback(false);
    }
    builder.build().map_err(|error| {
        Error::middleware(format!("join DDS domain {}", environment.domain_id), error)
    })
}

impl Dds {
    /// Whether the writer needs the second participant.
    pub(super) fn goes_apart(&self, endpoint: &Endpoint) -> bool {
        self.environment.is_on_loopback()
            && !self.environment.is_alone()
            && endpoint.channel == Channel::Topic
            && endpoint.qos.reliability == Reliability::Reliable
            && self.shared.nodes.reads(endpoint)
    }

    /// A writer of the second participant, which joins the domain if it has not done so.
    pub(super) fn writer_apart(
        &self,
        endpoint: &Endpoint,
        qos: QosPolicies,
    ) -> Result<CreateResult<DataWriter<Bytes, Raw>>, Error> {
        let mut second = lock(&self.shared.second);
        let Second {
            participant,
            publisher,
        } = match &mut *second {
            Some(second) => second,
            none => none.insert(self.join_again()?),
        };
        let topic = topic(participant, endpoint, &qos)?;
        Ok(publisher.create_datawriter_no_key(&topic, Some(qos)))
    }

    fn join_again(&self) -> Result<Second, Error> {
        let participant = participant(&self.environment)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant
            .create_publisher(&defaults)
            .map_err(|error| Error::middleware("join a second time", error))?;
        let peer = peer_of(&participant.guid().to_bytes());
        self.shared.second_peer.get_or_init(|| peer);
        let events = participant.status_listener();
        self.runtime.spawn(follow(events, Arc::clone(&self.shared)));
        Ok(Second {
            participant,
            publisher,
        })
    }
}
