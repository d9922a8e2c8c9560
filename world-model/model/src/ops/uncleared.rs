//! Memory that is not cleared before it is written: one thread would clear it, and the others wait.

use std::mem::MaybeUninit;

/// `length` values, as `write` writes them.
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
