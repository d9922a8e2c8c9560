//! Nodes in participants of their own, on loopback.

use std::{thread::JoinHandle, time::Duration};

use wm_msgs::Message;
use wm_ros::{Context, Environment, Node, NodeArgs, Reach, Subscription};

/// Far above anything that happens here; it only ends a test that hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A participant of ROS domain `domain_id`.
pub fn context(domain_id: u16) -> Context {
    Context::new(&Environment {
        domain_id,
        reach: Reach::Localhost,
    })
    .unwrap()
}

/// A node at work.
pub struct Running {
    context: Context,
    thread: JoinHandle<anyhow::Result<()>>,
}

impl Running {
    /// Starts a node in the participant `context` and a thread of its own.
    pub fn start<F: Future<Output = anyhow::Result<()>>>(
        context: Context,
        name: &'static str,
        parameters: &str,
        body: impl FnOnce(Node) -> F + Send + 'static,
    ) -> Self {
        let words = format!("--ros-args {parameters}");
        let args = NodeArgs::parse(words.split_whitespace()).unwrap();
        let of_thread = context.clone();
        let thread = std::thread::spawn(move || {
            let node = Node::new(&of_thread, name, wm_ros::NAMESPACE, &args)?;
            tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()?
                .block_on(body(node))
                .inspect_err(|error| eprintln!("{name}: {error:#}"))
        });
        Self { context, thread }
    }

    /// Ends the node; what it ended with.
    pub fn stop(self) -> anyhow::Result<()> {
        self.context.shutdown().trigger();
        let result = self.thread.join().unwrap();
        self.context.close();
        result
    }
}

/// The next message.
#[allow(dead_code, reason = "not every test waits for single messages")]
pub async fn soon<M: Message>(what: &str, subscription: &mut Subscription<M>) -> M {
    let received = tokio::time::timeout(PATIENCE, subscription.recv()).await;
    received
        .unwrap_or_else(|_| {
            panic!(
                "{what}: nothing on {} for {PATIENCE:?}",
                subscription.topic()
            )
        })
        .unwrap()
        .message
}
