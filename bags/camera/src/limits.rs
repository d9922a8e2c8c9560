//! Limits of received pictures.

/// Longest side, for cameras up to 8K \[px\].
pub const MAX_SIDE: u32 = 8192;
/// Largest compressed image \[bytes\].
pub const MAX_COMPRESSED: usize = 32 << 20;
