//! Locks that ignore poisoning.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The guarded values are consistent between statements, so they outlive a panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
