//! A second participant for reliable writers of topics that this process reads as well, where it is bound to loopback.
//!
//! rustdds 0.15.1 connects a new writer with the readers of its own participant, but sends nothing to its own participant
//! by loopback: they acknowledge nothing, and after [`RELIABLE_WINDOW`](super::qos::RELIABLE_WINDOW) samples the writer
//! takes no more, whoever else listens. Between two participants all is well; what the two say to each other is left, as
//! within one, for the delivery in memory ([`super::local`]). ROS tools show the writers, but not whose they are.

use super::{
    Dds,
    codec::Raw,
    confine,
    lock::lock,
    parts::peer_of,
    shared::{Second, follow},
    topic,
    wire::Wire,
};
use crate::{
    Environment, Error, Reliability,
    backend::{Channel, Endpoint},
};
use bytes::Bytes;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity as _,
    dds::result::{CreateError, CreateResult},
    no_key::DataWriter,
};
use std::sync::Arc;

/// rustdds calls it a panic where it cannot have the sockets, timers and threads that a participant needs.
fn cannot_join(environment: &Environment, error: CreateError) -> Error {
    let reason = match error {
        CreateError::Poisoned { reason } => format!(
            "{reason}; the process may have reached its limit of open files (`ulimit -n`) or of threads"
        ),
        other => other.to_string(),
    };
    Error::middleware(format!("join DDS domain {}", environment.domain_id), reason)
}

/// A participant of the domain, not yet in anybody's book, which hears nothing from outside the environment's reach.
pub(super) fn participant(
    environment: &Environment,
    wire: &Wire,
) -> Result<DomainParticipant, Error> {
    let of_sockets = |source| Error::io("confine the sockets of DDS", source);
    let before = confine::sockets().map_err(of_sockets)?;
    let mut builder = DomainParticipantBuilder::new(environment.domain_id);
    if let Some(addresses) = environment.addresses() {
        builder = builder.with_only_networks(addresses);
    }
    if environment.is_alone() {
        // without it, it would announce itself to the first participants of this host
        builder = builder.same_host_loopback(false);
    }
    let participant = builder
        .build()
        .map_err(|error| cannot_join(environment, error))?;
    let ports = confine::Ports::new(environment.domain_id, participant.participant_id());
    if let Some(addresses) = environment.addresses() {
        confine::confine(&ports, &before, &addresses).map_err(of_sockets)?;
    }
    wire.add_own(peer_of(&participant.guid().to_bytes()), ports.discovery());
    Ok(participant)
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
        let participant = participant(&self.environment, &self.shared.wire)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant
            .create_publisher(&defaults)
            .map_err(|error| Error::middleware("join a second time", error))?;
        let peer = peer_of(&participant.guid().to_bytes());
        self.shared.second_peer.get_or_init(|| peer);
        let events = participant.status_listener();
        let follow = follow(events, Arc::clone(&self.shared));
        self.shared
            .failure
            .watch(&self.runtime, "discovery", follow);
        Ok(Second {
            participant,
            publisher,
        })
    }
}
