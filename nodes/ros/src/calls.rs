//! Calls of several services, gathered for one loop that answers them in turn.

use crate::{Call, Service};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// Calls that may wait for the loop, beside those that wait in their services.
const WAITING: usize = 16;

/// What gathers the calls of services for as long as it lives; each comes out as a `C`.
pub struct Calls<C> {
    sender: mpsc::Sender<C>,
    receiver: mpsc::Receiver<C>,
    services: JoinSet<()>,
}

impl<C: Send + 'static> Default for Calls<C> {
    /// No service yet.
    fn default() -> Self {
        let (sender, receiver) = mpsc::channel(WAITING);
        Self {
            sender,
            receiver,
            services: JoinSet::new(),
        }
    }
}

impl<C: Send + 'static> Calls<C> {
    /// Takes the calls of `service`, too. To be called inside a tokio runtime.
    pub fn add<S: wm_msgs::Service>(
        &mut self,
        mut service: Service<S>,
        wrap: impl Fn(Call<S>) -> C + Send + 'static,
    ) {
        let sender = self.sender.clone();
        self.services.spawn(async move {
            while let Some(call) = service.recv().await {
                if sender.send(wrap(call)).await.is_err() {
                    break;
                }
            }
        });
    }

    /// Where other things than calls, such as keys, are put in between.
    pub fn sender(&self) -> mpsc::Sender<C> {
        self.sender.clone()
    }

    /// The next one. Cancel safe.
    pub async fn next(&mut self) -> C {
        match self.receiver.recv().await {
            Some(call) => call,
            // never: a sender lives in `self`
            None => std::future::pending().await,
        }
    }
}

/// A client that cannot be answered is no reason to stop serving the others.
pub fn answer<S: wm_msgs::Service>(call: Call<S>, response: &S::Response) {
    if let Err(problem) = call.respond(response) {
        tracing::warn!("a call is not answered: {problem}");
    }
}
