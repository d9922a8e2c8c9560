//! Blocking calls into Zenoh, on threads of their own: Zenoh panics if it blocks on a thread of a tokio runtime of one
//! thread, as the nodes have.

use crate::Error;
use std::thread;

/// Makes a call that may block.
pub(super) fn apart<R: Send>(call: impl FnOnce() -> R + Send) -> Result<R, Error> {
    thread::scope(|scope| {
        let thread = thread::Builder::new().name("zenoh_call".to_owned());
        let thread = thread
            .spawn_scoped(scope, call)
            .map_err(|source| Error::io("start a thread", source))?;
        let panicked = |_| Error::middleware("use the Zenoh session", "Zenoh has panicked");
        thread.join().map_err(panicked)
    })
}

/// A value of Zenoh that may block when it is dropped.
pub(super) struct DroppedApart<T: Send>(Option<T>);

impl<T: Send> DroppedApart<T> {
    pub(super) fn new(value: T) -> Self {
        Self(Some(value))
    }

    /// The value; `None` only while it is dropped.
    pub(super) fn get(&self) -> Option<&T> {
        self.0.as_ref()
    }
}

impl<T: Send> Drop for DroppedApart<T> {
    fn drop(&mut self) {
        let value = self.0.take();
        if let Err(error) = apart(|| drop(value)) {
            tracing::debug!("a Zenoh endpoint or session is not closed in order: {error}");
        }
    }
}
