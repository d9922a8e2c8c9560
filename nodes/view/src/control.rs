//! What commands do to the other nodes.

use crate::{
    command::{Command, Permission},
    picture::{Format, Picture},
    server::Shared,
};
use futures::future::join_all;
use std::{sync::Arc, time::Duration};
use wm_msgs::{
    sensor_msgs::CompressedImage,
    std_msgs::Header,
    std_srvs::{Outcome, SetBool, SetBoolRequest, Trigger, TriggerRequest},
    wm_msgs::{ActionChunk, Reset, ResetRequest},
};
use wm_ros::{Client, Error, Node, Publisher, Qos};

/// How long a node may take to answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(3);
/// How long a service is looked for: those of nodes that run have been found long before.
const SEARCH_LIMIT: Duration = Duration::from_secs(1);
/// The nodes that have a history to forget.
const HISTORIES: [&str; 3] = ["predictor", "planner", "evaluator"];

/// The ways to the other nodes, as far as they are permitted.
pub struct Control {
    node: Node,
    steering: Option<Steering>,
    executor: Option<Arc<ExecutorClients>>,
}

/// For what needs [`Permission::Goals`].
struct Steering {
    goals: Publisher<CompressedImage>,
    chunks: Publisher<ActionChunk>,
    resets: Arc<[(&'static str, Client<Reset>)]>,
}

struct ExecutorClients {
    arm: Client<SetBool>,
    stop: Client<Trigger>,
    release: Client<Trigger>,
}

/// How a command went, in words.
pub type Answer = Result<String, String>;

impl Control {
    /// What is permitted, and no more: a view that may only look publishes nothing.
    ///
    /// # Errors
    /// The graph refuses.
    pub fn new(node: &Node, permission: Permission) -> Result<Self, Error> {
        let steering = (permission >= Permission::Goals).then(|| Steering::new(node));
        Ok(Self {
            node: node.clone(),
            steering: steering.transpose()?,
            executor: None,
        })
    }

    /// There is an executor.
    ///
    /// # Errors
    /// The graph refuses.
    pub fn meet_executor(&mut self) -> Result<(), Error> {
        if self.executor.is_none() {
            self.executor = Some(Arc::new(ExecutorClients {
                arm: self.node.client("executor/arm")?,
                stop: self.node.client("executor/stop")?,
                release: self.node.client("executor/reset")?,
            }));
        }
        Ok(())
    }

    /// Begins with a command, whose permission was checked; what is left of it waits for other nodes.
    pub fn run(
        &self,
        command: Command,
        shared: &Arc<Shared>,
    ) -> impl Future<Output = Answer> + use<> {
        let (executor, shared) = (self.executor.clone(), Arc::clone(shared));
        let steering = self.steering.as_ref();
        let resets = steering.map(|steering| Arc::clone(&steering.resets));
        // Published from here, where the publishers are; what a goal takes was looked up by then.
        let published = match &command {
            Command::Choose { stamp, index } => Some(self.choose(&shared, *stamp, *index)),
            Command::Goal(label) => {
                let picture = shared.known().state.album.find(label).cloned();
                Some(self.set_goal(picture.as_deref()))
            }
            _ => None,
        };
        async move {
            if let Some(published) = published {
                return published;
            }
            match command {
                Command::Reset => reset(&resets.ok_or_else(not_permitted)?).await,
                command => {
                    let executor = executor.ok_or("no executor has been heard of")?;
                    executor.run(&command).await
                }
            }
        }
    }

    fn steering(&self) -> Result<&Steering, String> {
        self.steering.as_ref().ok_or_else(not_permitted)
    }

    fn set_goal(&self, picture: Option<&Picture>) -> Answer {
        let steering = self.steering()?;
        let picture = picture.ok_or("this picture is no longer kept")?;
        let format = match picture.format {
            Format::Jpeg => "jpeg",
            Format::Png => "png",
        };
        let goal = CompressedImage {
            header: Header {
                // When the goal was set, which plans repeat.
                stamp: self.node.now(),
                frame_id: picture.frame_id.clone(),
            },
            format: format.to_owned(),
            data: picture.data().into(),
        };
        let topic = steering.goals.topic();
        steering
            .goals
            .publish(&goal)
            .map_err(|error| error.to_string())?;
        Ok(match steering.goals.subscribers() {
            0 => format!("published on {topic}, but nobody hears it"),
            _ => "the goal is set".to_owned(),
        })
    }

    fn choose(&self, shared: &Shared, stamp_ns: i64, index: usize) -> Answer {
        let steering = self.steering()?;
        let known = shared.known();
        let offered = known.state.offered(stamp_ns, index);
        let chunk = offered.ok_or("this candidate is no longer on offer")?;
        steering
            .chunks
            .publish(chunk)
            .map_err(|error| error.to_string())?;
        Ok(format!(
            "candidate {index} is published on {}",
            steering.chunks.topic()
        ))
    }
}

fn not_permitted() -> String {
    "not permitted: start the page with the parameter control (goals, or all)".to_owned()
}

impl Steering {
    fn new(node: &Node) -> Result<Self, Error> {
        let reset = |name: &'static str| Ok((name, node.client(&format!("{name}/reset"))?));
        let resets: Result<Vec<_>, Error> = HISTORIES.into_iter().map(reset).collect();
        Ok(Self {
            // Latched: a planner that is started again finds the goal.
            goals: node.publisher("goal/image/compressed", Qos::latched(1))?,
            chunks: node.publisher("action_chunk", Qos::reliable(10))?,
            resets: resets?.into(),
        })
    }
}

/// The answer of a service that must be there.
async fn ask<S: wm_msgs::Service>(
    client: &Client<S>,
    request: &S::Request,
) -> Result<S::Response, String> {
    let found = tokio::time::timeout(SEARCH_LIMIT, client.wait_for_service()).await;
    found.map_err(|_| format!("{} is not there", client.name()))?;
    let answer = tokio::time::timeout(ANSWER_LIMIT, client.call(request)).await;
    answer
        .map_err(|_| format!("{} does not answer", client.name()))?
        .map_err(|error| error.to_string())
}

/// Resets all nodes that run.
async fn reset(resets: &[(&'static str, Client<Reset>)]) -> Answer {
    let request = ResetRequest {
        keep_seed: true,
        ..ResetRequest::default()
    };
    let one =
        async |(name, client): &(&'static str, Client<Reset>)| match ask(client, &request).await {
            Ok(answer) => (answer.success, format!("{name}: {}", answer.message)),
            Err(reason) => (false, reason),
        };
    let answers = join_all(resets.iter().map(one)).await;
    let has_any = answers.iter().any(|(is_reset, _)| *is_reset);
    let texts: Vec<String> = answers.into_iter().map(|(_, text)| text).collect();
    let text = texts.join("; ");
    if has_any { Ok(text) } else { Err(text) }
}

impl ExecutorClients {
    async fn run(&self, command: &Command) -> Answer {
        let outcome: Outcome = match command {
            Command::Arm { armed } => ask(&self.arm, &SetBoolRequest { data: *armed }).await?,
            Command::Stop => ask(&self.stop, &TriggerRequest::default()).await?,
            Command::Release => ask(&self.release, &TriggerRequest::default()).await?,
            Command::Reset | Command::Goal(_) | Command::Choose { .. } => {
                return Err("not a command for the executor".to_owned());
            }
        };
        if outcome.success {
            Ok(outcome.message)
        } else {
            Err(outcome.message)
        }
    }
}
