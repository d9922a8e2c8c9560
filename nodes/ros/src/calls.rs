//! Calls of several services, gathered for one loop that answers them in turn.

use crate::{Call, Error, Node};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// Calls that may wait for the loop, beside those that wait in their services.
const WAITING: usize = 16;

/// What serves a node's services for as long as it lives; each call comes out as a `C`.
pub struct Calls<C> {
    node: Node,
    sender: mpsc::Sender<C>,
    receiver: mpsc::Receiver<C>,
    services: JoinSet<()>,
}

impl<C: Send + 'static> Calls<C> {
    /// No service yet.
    pub fn new(node: &Node) -> Self {
        let (sender, receiver) = mpsc::channel(WAITING);
        Self {
            node: node.clone(),
            sender,
            receiver,
            services: JoinSet::new(),
        }
    }

    /// Serves `S` as `~/name`. To be called inside a tokio runtime.
    ///
    /// # Errors
    /// The middleware failed.
    pub fn serve<S: wm_msgs::Service>(
        &mut self,
        name: &str,
        wrap: impl Fn(Call<S>) -> C + Send + 'static,
    ) -> Result<(), Error> {
        let mut service = self.node.service::<S>(&format!("~/{name}"))?;
        let sender = self.sender.clone();
        self.services.spawn(async move {
            while let Some(call) = service.recv().await {
                if sender.send(wrap(call)).await.is_err() {
                    break;
                }
            }
        });
        Ok(())
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
