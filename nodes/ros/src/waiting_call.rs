//! Calls that wait for their server, and when the oldest of them arrived.

use crate::{backend::RequestId, mailbox::Mailbox};
use bytes::Bytes;
use std::{sync::Arc, time::Instant};

/// A call that waits for its server.
pub(crate) struct WaitingCall {
    pub(crate) id: RequestId,
    pub(crate) request: Bytes,
    /// Orders the calls of several services.
    pub(crate) arrival: Instant,
}

/// Reports when the oldest waiting request of a source arrived.
#[derive(Clone)]
pub struct Arrival(pub(crate) Arc<Mailbox<WaitingCall>>);

impl Arrival {
    pub(crate) fn oldest(&self) -> Option<Instant> {
        self.0.peek(|call| call.arrival)
    }
}
