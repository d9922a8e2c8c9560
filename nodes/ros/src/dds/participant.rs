//! Makes participants and their topics.

use super::{
    names::{dds_name, dds_type},
    workarounds::{
        introduction::participants_of,
        socket_filter::{self, Ports},
    },
};
use crate::{Environment, Error, backend::Endpoint};
use rustdds::{DomainParticipant, DomainParticipantBuilder, dds::result::CreateError};

/// rustdds reports missing sockets, timers and threads as a poisoned lock.
fn cannot_join(environment: &Environment, error: CreateError) -> Error {
    let domain = environment.domain_id;
    let reason = match error {
        CreateError::OutOfResources { reason } if reason.contains("ParticipantId") => {
            return domain_full(domain);
        }
        CreateError::Poisoned { reason } => format!(
            "{reason}; the process may have reached its limit of open files (`ulimit -n`) or of threads"
        ),
        other => other.to_string(),
    };
    Error::middleware(format!("join DDS domain {domain}"), reason)
}

fn domain_full(domain: u16) -> Error {
    let participants = participants_of(domain);
    Error::DomainFull {
        domain,
        participants,
    }
}

/// Joins the domain with a participant that receives nothing from outside the environment's reach.
pub(super) fn join(environment: &Environment) -> Result<DomainParticipant, Error> {
    let socket_error = |source| Error::io("confine the sockets of DDS", source);
    let before = socket_filter::sockets().map_err(socket_error)?;
    let mut builder = DomainParticipantBuilder::new(environment.domain_id);
    if let Some(addresses) = environment.addresses() {
        builder = builder.with_only_networks(addresses);
    }
    if environment.is_alone() {
        // otherwise it announces itself to the first participants of this host
        builder = builder.same_host_loopback(false);
    }
    let participant = builder
        .build()
        .map_err(|error| cannot_join(environment, error))?;
    if participant.participant_id() >= participants_of(environment.domain_id) {
        return Err(domain_full(environment.domain_id));
    }
    if let Some(addresses) = environment.addresses() {
        let ports = Ports::new(environment.domain_id, participant.participant_id());
        socket_filter::confine(&ports, &before, &addresses).map_err(socket_error)?;
    }
    Ok(participant)
}

pub(super) fn topic(
    participant: &DomainParticipant,
    endpoint: &Endpoint,
    qos: &rustdds::QosPolicies,
) -> Result<rustdds::Topic, Error> {
    let (name, type_name) = (dds_name(endpoint), dds_type(endpoint));
    participant
        .create_topic(name, type_name, qos, rustdds::TopicKind::NoKey)
        .map_err(|error| Error::middleware(format!("create the topic {}", endpoint.name), error))
}
