//! Workarounds around faults and gaps of rustdds.

pub(super) mod addresses;
pub(super) mod catch_up;
pub(super) mod confine;
pub(super) mod datagram;
pub(super) mod introduction;
pub(super) mod latched;
pub(super) mod lease;
pub(super) mod line;
pub(super) mod one_way;
pub(super) mod parts;
pub(super) mod reconcile;
mod rematch;
pub(super) mod resend;
pub(super) mod rtps;
pub(super) mod second;
mod window;
pub(super) mod wire;
