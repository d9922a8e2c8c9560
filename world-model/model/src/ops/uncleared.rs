//! Output buffers that are not cleared first: one thread would clear them, and the others wait.

use std::mem::MaybeUninit;

/// A buffer of `length` values, which `write` writes.
///
/// # Safety
/// `write` must write every value.
pub(super) unsafe fn uncleared(
    length: usize,
    write: impl FnOnce(&mut [MaybeUninit<f32>]),
) -> Vec<f32> {
    let mut values = Vec::with_capacity(length);
    write(
        values
            .spare_capacity_mut()
            .get_mut(..length)
            .unwrap_or_default(),
    );
    // SAFETY: the capacity is at least `length`, and `write` has written as many values.
    unsafe { values.set_len(length) };
    values
}
