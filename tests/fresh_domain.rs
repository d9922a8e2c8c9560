//! ROS domains for tests.

use std::sync::atomic::{AtomicU16, Ordering};

/// A ROS domain that none of the 39 tests before uses. Programs of tests run one after the other.
pub fn fresh_domain() -> u16 {
    // domains up to 101 keep RTPS ports below the ephemeral range of Linux
    static NEXT: AtomicU16 = AtomicU16::new(0);
    20 + (std::process::id() as u16 % 2) * 40 + NEXT.fetch_add(1, Ordering::Relaxed) % 40
}
