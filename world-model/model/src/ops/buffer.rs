//! Memory that a thread uses again and again.

use std::{
    cell::RefCell,
    collections::BTreeMap,
    ops::{Deref, DerefMut},
};

thread_local! {
    /// Free buffers by their length.
    static FREE: RefCell<BTreeMap<usize, Vec<Vec<f32>>>> = RefCell::default();
}

/// Numbers that its owner writes before reading them: what is in a new one is left from an earlier use.
///
/// A training step allocates the same sizes as the one before. Taken from the system, large buffers come as pages that are
/// mapped and cleared anew each time, which costs as much as a layer. The most that a thread had in use is kept until it
/// ends.
#[derive(Debug, Default)]
pub(crate) struct Buffer(Vec<f32>);

impl Buffer {
    pub(crate) fn of(length: usize) -> Self {
        let free = FREE.with_borrow_mut(|free| free.get_mut(&length).and_then(Vec::pop));
        Self(free.unwrap_or_else(|| vec![0.0; length]))
    }

    pub(crate) fn copy_of(values: &[f32]) -> Self {
        let mut buffer = Self::of(values.len());
        buffer.copy_from_slice(values);
        buffer
    }

    pub(crate) fn zeros(length: usize) -> Self {
        let mut buffer = Self::of(length);
        buffer.fill(0.0);
        buffer
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.0);
        // A thread that ends has no free ones any more.
        let _ = FREE.try_with(|free| {
            free.borrow_mut()
                .entry(values.len())
                .or_default()
                .push(values);
        });
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_freed_is_used_again() {
        let first = Buffer::copy_of(&[1.0, 2.0, 3.0]);
        let place = first.as_ptr();
        drop(first);
        assert_ne!(Buffer::of(4).as_ptr(), place);
        let again = Buffer::of(3);
        assert_eq!((again.as_ptr(), &*again), (place, &[1.0, 2.0, 3.0][..]));
        assert_eq!(*Buffer::zeros(3), [0.0; 3]);
    }
}
