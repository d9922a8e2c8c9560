//! A second participant for reliable writers of topics that this process reads as well, where it is bound to loopback.
//!
//! rustdds 0.15.1 connects a new writer with the readers of its own participant, but sends nothing to its own participant
//! by loopback: they acknowledge nothing, and the publisher would start one DDS writer after
//! the other ([`super::line`]). Between two participants this does not happen. Messages between the two are delivered in
//! memory ([`super::super::local`]), as within one. ROS tools show the writers, but not their node.

use super::{
    confine,
    introduction::{introduce, participants_of},
    lease::OwnPort,
    line::Maker,
    parts::peer_of,
};
use crate::{
    Environment, Error, Reliability,
    backend::{Channel, Endpoint},
    dds::{
        Dds,
        lock::lock,
        qos::for_reader,
        shared::{Second, follow},
        topic,
    },
};
use futures::FutureExt as _;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity as _,
    dds::result::CreateError,
};
use std::sync::Arc;

/// rustdds calls it a panic where it cannot have the sockets, timers and threads that a participant needs.
fn cannot_join(environment: &Environment, error: CreateError) -> Error {
    let domain = environment.domain_id;
    let reason = match error {
        CreateError::OutOfResources { reason } if reason.contains("ParticipantId") => {
            return full(domain);
        }
        CreateError::Poisoned { reason } => format!(
            "{reason}; the process may have reached its limit of open files (`ulimit -n`) or of threads"
        ),
        other => other.to_string(),
    };
    Error::middleware(format!("join DDS domain {domain}"), reason)
}

fn full(domain: u16) -> Error {
    let participants = participants_of(domain);
    Error::DomainFull {
        domain,
        participants,
    }
}

/// A participant of the domain, not yet in anybody's book, which hears nothing from outside the environment's reach.
pub(in crate::dds) fn participant(environment: &Environment) -> Result<DomainParticipant, Error> {
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
    if participant.participant_id() >= participants_of(environment.domain_id) {
        return Err(full(environment.domain_id));
    }
    if let Some(addresses) = environment.addresses() {
        let ports = confine::Ports::new(environment.domain_id, participant.participant_id());
        confine::confine(&ports, &before, &addresses).map_err(of_sockets)?;
    }
    Ok(participant)
}

impl Dds {
    /// Whether the writer needs the second participant.
    pub(in crate::dds) fn goes_apart(&self, endpoint: &Endpoint) -> bool {
        self.environment.is_on_loopback()
            && !self.environment.is_alone()
            && endpoint.channel == Channel::Topic
            && endpoint.qos.reliability == Reliability::Reliable
            && self.shared.nodes.reads(endpoint)
    }

    /// Makes writers of the second participant, which joins the domain if it has not done so.
    pub(in crate::dds) fn maker_apart(
        &self,
        endpoint: &Endpoint,
        qos: QosPolicies,
    ) -> Result<Maker, Error> {
        let mut second = lock(&self.shared.second);
        let Second {
            participant,
            publisher,
        } = match &mut *second {
            Some(second) => second,
            none => none.insert(self.join_again()?),
        };
        let topic = topic(participant, endpoint, &for_reader(endpoint.qos))?;
        let publisher = publisher.clone();
        Ok(Maker {
            publisher,
            topic,
            qos,
        })
    }

    /// Starts the tasks of a participant: its discovery events, and the announcements that rustdds does not send.
    pub(in crate::dds) fn attend(&self, participant: &DomainParticipant) -> Result<(), Error> {
        let failed = |source| Error::io("open a UDP socket", source);
        let own = participant.guid().to_bytes();
        let (domain, number) = (self.environment.domain_id, participant.participant_id());
        let (failure, runtime) = (&self.shared.failure, &self.runtime);
        let mut own_port = None;
        if let Some(address) = self.addresses.first() {
            let port = confine::Ports::new(domain, number).discovery();
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

    fn join_again(&self) -> Result<Second, Error> {
        let participant = participant(&self.environment)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant
            .create_publisher(&defaults)
            .map_err(|error| Error::middleware("join a second time", error))?;
        let peer = peer_of(&participant.guid().to_bytes());
        self.shared.second_peer.get_or_init(|| peer);
        self.attend(&participant)?;
        Ok(Second {
            participant,
            publisher,
        })
    }
}
