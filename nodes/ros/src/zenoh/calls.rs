//! Calls of this process's services by other sessions, which wait for their answers.

use crate::{
    backend::{EndpointId, RequestId},
    lock::lock,
};
use std::{
    collections::{HashMap, VecDeque},
    sync::Mutex,
};

/// The most calls that wait at once. A result of an action may be awaited for hours. Policy DropOldest, with a warning.
const MOST_WAITING: usize = 4096;

/// Queries by the identity of their request.
pub(super) struct Calls<Q> {
    waiting: Mutex<Waiting<Q>>,
}

struct Waiting<Q> {
    queries: HashMap<RequestId, Q>,
    /// In the order of arrival; may name answered ones.
    order: VecDeque<RequestId>,
}

impl<Q> Default for Calls<Q> {
    fn default() -> Self {
        let (queries, order) = (HashMap::new(), VecDeque::new());
        Self {
            waiting: Mutex::new(Waiting { queries, order }),
        }
    }
}

impl<Q> Calls<Q> {
    /// Adds a call; `false` if it waits already. Dropping a query ends the call without an answer.
    pub(super) fn add(&self, request: RequestId, query: Q) -> bool {
        let mut waiting = lock(&self.waiting);
        if waiting.queries.contains_key(&request) {
            return false;
        }
        waiting.queries.insert(request, query);
        waiting.order.push_back(request);
        while waiting.queries.len() > MOST_WAITING || waiting.order.len() > 2 * MOST_WAITING {
            let Some(oldest) = waiting.order.pop_front() else {
                break;
            };
            if waiting.queries.len() > MOST_WAITING && waiting.queries.remove(&oldest).is_some() {
                tracing::warn!(
                    "more than {MOST_WAITING} calls wait for an answer: the oldest is dropped"
                );
            }
        }
        true
    }

    pub(super) fn take(&self, request: &RequestId) -> Option<Q> {
        lock(&self.waiting).queries.remove(request)
    }

    /// A client has gone.
    pub(super) fn forget(&self, client: &EndpointId) {
        lock(&self.waiting)
            .queries
            .retain(|request, _| request.client != *client);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(sequence: i64) -> RequestId {
        RequestId {
            client: [1; 16],
            sequence,
        }
    }

    #[test]
    fn call_is_answered_once() {
        let calls = Calls::default();
        assert!(calls.add(request(1), 'a'));
        assert!(!calls.add(request(1), 'b'));
        assert_eq!(calls.take(&request(1)), Some('a'));
        assert_eq!(calls.take(&request(1)), None);
        calls.add(request(2), 'c');
        calls.forget(&[1; 16]);
        assert_eq!(calls.take(&request(2)), None);
    }

    #[test]
    fn oldest_call_is_dropped_and_memory_is_bounded() {
        let calls = Calls::default();
        for sequence in 0..3 * MOST_WAITING as i64 {
            calls.add(request(sequence), sequence);
        }
        assert_eq!(calls.take(&request(0)), None);
        let newest = 3 * MOST_WAITING as i64 - 1;
        assert_eq!(calls.take(&request(newest)), Some(newest));
        for sequence in 0..100_000 {
            calls.add(request(-1 - sequence), sequence);
            calls.take(&request(-1 - sequence));
        }
        assert!(lock(&calls.waiting).order.len() <= 2 * MOST_WAITING);
    }
}
