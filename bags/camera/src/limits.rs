//! How large a picture may be: its sizes come from outside.

/// Longest side of an image that is accepted \[px\]: 8K cameras and no more.
pub const MAX_SIDE: u32 = 8192;
/// Longest compressed image that is accepted \[byte\].
pub const MAX_COMPRESSED: usize = 32 << 20;
