//! Identities of endpoints: two bytes of the vendor, ten of the participant, four of the endpoint (DDSI-RTPS 2.5, 8.2.4).

use crate::backend::{EndpointId, ParticipantId};

/// A participant: the first bytes of the identities of its endpoints.
pub(super) type Peer = ParticipantId;

pub(in crate::dds) fn participant_of(id: &EndpointId) -> Peer {
    std::array::from_fn(|index| id[index])
}

pub(super) fn is_same_participant(one: &EndpointId, other: &EndpointId) -> bool {
    participant_of(one) == participant_of(other)
}

/// Whether the two are of different DDS implementations.
pub(super) fn is_foreign(one: &EndpointId, other: &EndpointId) -> bool {
    one[..2] != other[..2]
}
