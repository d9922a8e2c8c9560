//! Identities of endpoints: two bytes of the vendor, ten of the participant, four of the endpoint (DDSI-RTPS 2.5, 8.2.4).

use crate::backend::{EndpointId, participant_of};

/// A participant: the first bytes of the identities of its endpoints.
pub(super) type Peer = [u8; 12];

pub(super) fn is_same_participant(one: &EndpointId, other: &EndpointId) -> bool {
    participant_of(one) == participant_of(other)
}

/// Whether the two are of different DDS implementations.
pub(super) fn is_foreign(one: &EndpointId, other: &EndpointId) -> bool {
    one[..2] != other[..2]
}
