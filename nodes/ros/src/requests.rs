//! The requests of a node's services and actions as one stream: the enum that [`endpoints!`](crate::endpoints) makes.

use crate::{
    ActionServer, Call, Endpoint, EndpointSet, EndpointSpec, Error, GoalRequest, Node, Service,
    Shutdown, waiting_call::Arrival,
};
use futures::future::{FutureExt as _, LocalBoxFuture};
use std::{future::poll_fn, task::Poll};
use wm_msgs::Action;

/// An enum of requests, one variant for each service or action. Made by [`endpoints!`](crate::endpoints).
pub trait RequestSet: Sized + 'static {
    /// The services and actions, in the order in which they are documented.
    fn specs() -> Vec<EndpointSpec>;

    /// Makes them on `node`.
    ///
    /// # Errors
    /// As [`Endpoint::make`].
    fn sources(node: &Node) -> Result<Vec<Box<dyn RequestSource<Self>>>, Error>;
}

/// An endpoint whose requests become an `R`.
pub trait RequestSource<R> {
    /// When its oldest waiting request arrived, for as long as the handle lives.
    fn arrival(&self) -> Arrival;

    /// Its next request; `None` once the context is shut down. Cancel safe.
    fn request(&mut self) -> LocalBoxFuture<'_, Option<R>>;
}

/// An endpoint that can be a variant of a [`RequestSet`]: `Service<S>`, `ActionServer<A>`, or an `Option` of them.
pub trait RequestEndpoint: Endpoint {
    /// A request with its reply handle.
    type Request;

    /// The endpoint as a source; `None` if it was not made.
    fn source<R: 'static>(self, wrap: fn(Self::Request) -> R) -> Option<Box<dyn RequestSource<R>>>;
}

/// An endpoint and the variant that its requests become.
struct VariantSource<S, Q, R> {
    endpoint: S,
    wrap: fn(Q) -> R,
}

impl<S: wm_msgs::Service, R> RequestSource<R> for VariantSource<Service<S>, Call<S>, R> {
    fn arrival(&self) -> Arrival {
        self.endpoint.arrival()
    }

    fn request(&mut self) -> LocalBoxFuture<'_, Option<R>> {
        let wrap = self.wrap;
        async move { self.endpoint.recv().await.map(wrap) }.boxed_local()
    }
}

impl<A: Action, R> RequestSource<R> for VariantSource<ActionServer<A>, GoalRequest<A>, R> {
    fn arrival(&self) -> Arrival {
        self.endpoint.arrival()
    }

    fn request(&mut self) -> LocalBoxFuture<'_, Option<R>> {
        let wrap = self.wrap;
        async move { self.endpoint.recv().await.map(wrap) }.boxed_local()
    }
}

impl<S: wm_msgs::Service> RequestEndpoint for Service<S> {
    type Request = Call<S>;

    fn source<R: 'static>(self, wrap: fn(Call<S>) -> R) -> Option<Box<dyn RequestSource<R>>> {
        let endpoint = self;
        Some(Box::new(VariantSource { endpoint, wrap }))
    }
}

impl<A: Action> RequestEndpoint for ActionServer<A> {
    type Request = GoalRequest<A>;

    fn source<R: 'static>(
        self,
        wrap: fn(GoalRequest<A>) -> R,
    ) -> Option<Box<dyn RequestSource<R>>> {
        let endpoint = self;
        Some(Box::new(VariantSource { endpoint, wrap }))
    }
}

impl<T: RequestEndpoint> RequestEndpoint for Option<T> {
    type Request = T::Request;

    fn source<R: 'static>(self, wrap: fn(T::Request) -> R) -> Option<Box<dyn RequestSource<R>>> {
        self.and_then(|endpoint| endpoint.source(wrap))
    }
}

/// The services and actions of a node, as one field of its endpoints.
pub struct Requests<R> {
    sources: Vec<Box<dyn RequestSource<R>>>,
    shutdown: Shutdown,
}

impl<R: RequestSet> EndpointSet for Requests<R> {
    fn specs() -> Vec<EndpointSpec> {
        R::specs()
    }

    fn make(node: &Node) -> Result<Self, Error> {
        let sources = R::sources(node)?;
        let shutdown = node.shutdown();
        Ok(Self { sources, shutdown })
    }
}

impl<R> Requests<R> {
    /// The next request, in the order of arrival at all services and actions; `None` once the context is shut down.
    /// Cancel safe.
    pub async fn next_request(&mut self) -> Option<R> {
        let sources = self.sources.iter_mut();
        let mut waiting: Vec<_> = sources
            .map(|source| (source.arrival(), source.request()))
            .collect();
        let first = poll_fn(|context| {
            // The keys are read once: requests arrive while they are compared.
            waiting.sort_by_cached_key(|(arrival, _)| {
                let oldest = arrival.oldest();
                (oldest.is_none(), oldest)
            });
            for (_, request) in &mut waiting {
                if let Poll::Ready(request) = request.poll_unpin(context) {
                    return Poll::Ready(request);
                }
            }
            Poll::Pending
        });
        tokio::select! {
            biased;
            () = self.shutdown.wait() => None,
            request = first => request,
        }
    }
}

/// Answers a call. A failure is only logged, so that the other clients are still served.
pub fn answer<S: wm_msgs::Service>(call: Call<S>, response: &S::Response) {
    if let Err(problem) = call.respond(response) {
        tracing::warn!("a call is not answered: {problem}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        backend::{EndpointId, RequestId},
        mailbox::Mailbox,
        waiting_call::WaitingCall,
    };
    use bytes::Bytes;
    use std::{
        sync::Arc,
        time::{Duration, Instant},
    };

    /// A source whose requests are its calls' numbers.
    struct Numbers(Arc<Mailbox<WaitingCall>>);

    impl RequestSource<i64> for Numbers {
        fn arrival(&self) -> Arrival {
            Arrival(Arc::clone(&self.0))
        }

        fn request(&mut self) -> LocalBoxFuture<'_, Option<i64>> {
            async { self.0.pop().await.map(|call| call.id.sequence) }.boxed_local()
        }
    }

    fn requests(mailboxes: &[Arc<Mailbox<WaitingCall>>]) -> Requests<i64> {
        let source = |mailbox: &Arc<_>| Box::new(Numbers(Arc::clone(mailbox))) as Box<_>;
        Requests {
            sources: mailboxes.iter().map(source).collect(),
            shutdown: Shutdown::new(),
        }
    }

    fn call(sequence: i64, arrival: Instant) -> WaitingCall {
        let client: EndpointId = [0; 16];
        let id = RequestId { client, sequence };
        let request = Bytes::new();
        WaitingCall {
            id,
            request,
            arrival,
        }
    }

    /// A reset that arrived before an emergency stop must not be obeyed after it.
    #[tokio::test(flavor = "current_thread")]
    async fn requests_of_several_services_keep_their_order() {
        let mailboxes = [0; 3].map(|_| Arc::new(Mailbox::new(8)));
        let start = Instant::now();
        for (number, service) in [2, 0, 1, 2, 2, 0, 1].into_iter().enumerate() {
            let arrival = start + Duration::from_millis(number as u64);
            mailboxes[service].push(call(number as i64, arrival));
        }
        let mut requests = requests(&mailboxes);
        let mut order = Vec::new();
        for _ in 0..7 {
            order.extend(requests.next_request().await);
        }
        assert_eq!(order, [0, 1, 2, 3, 4, 5, 6]);
    }

    #[tokio::test(flavor = "current_thread")]
    async fn requests_that_arrive_during_the_wait_keep_their_order() {
        let mailboxes = [0; 2].map(|_| Arc::new(Mailbox::new(8)));
        let mut requests = requests(&mailboxes);
        let (first, second) = tokio::join!(requests.next_request(), async {
            tokio::task::yield_now().await;
            let start = Instant::now();
            mailboxes[1].push(call(1, start));
            mailboxes[0].push(call(2, start + Duration::from_millis(1)));
        });
        assert_eq!((first, second), (Some(1), ()));
        assert_eq!(requests.next_request().await, Some(2));
    }

    #[tokio::test(flavor = "current_thread")]
    async fn a_wait_that_is_dropped_loses_no_request() {
        let mailbox = Arc::new(Mailbox::new(8));
        let mut requests = requests(std::slice::from_ref(&mailbox));
        tokio::select! {
            biased;
            _ = requests.next_request() => panic!("nothing has arrived"),
            () = async { mailbox.push(call(7, Instant::now())); } => {}
        }
        assert_eq!(requests.next_request().await, Some(7));
    }

    #[tokio::test(flavor = "current_thread")]
    async fn the_shutdown_ends_the_requests_even_without_services() {
        for mailboxes in [vec![], vec![Arc::new(Mailbox::new(8))]] {
            let mut requests = requests(&mailboxes);
            let shutdown = requests.shutdown.clone();
            let (request, ()) = tokio::join!(requests.next_request(), async {
                tokio::task::yield_now().await;
                shutdown.trigger();
            });
            assert_eq!(request, None);
        }
    }
}
