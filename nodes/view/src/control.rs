//! Executes commands on other nodes.

use crate::{
    command::{Command, Permission},
    picture::{Format, Picture},
    shared::Shared,
};
use futures::future::join_all;
use std::{sync::Arc, time::Duration};
use wm_msgs::{
    sensor_msgs::CompressedImage,
    std_msgs::Header,
    std_srvs::{Outcome, SetBool, SetBoolRequest, Trigger, TriggerRequest},
    wm_msgs::{ActionChunk, Reset, ResetRequest},
};
use wm_ros::{Client, Direction, Endpoint as _, EndpointSpec, Error, Node, Publisher, Qos};

/// How long a node may take to reply.
const ANSWER_LIMIT: Duration = Duration::from_secs(3);
/// How long to search a service: running nodes were discovered earlier.
const SEARCH_LIMIT: Duration = Duration::from_secs(1);
/// Nodes with a history.
const HISTORIES: [&str; 3] = ["predictor", "planner", "evaluator"];

/// The QoS of goals: latched, so that a restarted planner gets the goal.
const GOAL_QOS: Qos = Qos::latched(1);
const CHUNK_QOS: Qos = Qos::reliable(10);

/// The endpoints of all commands.
pub(crate) fn specs() -> Vec<EndpointSpec> {
    let published = Direction::Published;
    let mut specs = vec![
        EndpointSpec::topic::<CompressedImage>(
            published,
            "goal/image/compressed",
            GOAL_QOS,
            "A goal that is chosen on the page, with control goals or all.",
        ),
        EndpointSpec::topic::<ActionChunk>(
            published,
            "action_chunk",
            CHUNK_QOS,
            "A candidate that is chosen on the page, with control goals or all.",
        ),
    ];
    for node in HISTORIES {
        let name = format!("{node}/reset");
        let text = "The page's command reset, with control goals or all.";
        specs.extend(Client::<Reset>::specs(&name, CHUNK_QOS, text));
    }
    let arm = "Arms and disarms the executor, with control all.";
    specs.extend(Client::<SetBool>::specs("executor/arm", CHUNK_QOS, arm));
    let stop = "Stops the executor.";
    specs.extend(Client::<Trigger>::specs("executor/stop", CHUNK_QOS, stop));
    let reset = "Ends a stop of the executor, with control all.";
    specs.extend(Client::<Trigger>::specs("executor/reset", CHUNK_QOS, reset));
    specs
}

/// Publishers and clients for the permitted commands.
pub(crate) struct Control {
    node: Node,
    steering: Option<Steering>,
    executor: Option<Arc<ExecutorClients>>,
}

/// For [`Permission::Goals`].
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

/// The result of a command, as text.
pub(crate) type Answer = Result<String, String>;

impl Control {
    /// Creates only what is permitted: without permission, the view publishes nothing.
    ///
    /// # Errors
    /// An endpoint cannot be created.
    pub(crate) fn new(node: &Node, permission: Permission) -> Result<Self, Error> {
        let steering = (permission >= Permission::Goals).then(|| Steering::new(node));
        Ok(Self {
            node: node.clone(),
            steering: steering.transpose()?,
            executor: None,
        })
    }

    /// An executor was discovered.
    ///
    /// # Errors
    /// An endpoint cannot be created.
    pub(crate) fn meet_executor(&mut self) -> Result<(), Error> {
        if self.executor.is_none() {
            self.executor = Some(Arc::new(ExecutorClients {
                arm: self.node.client("executor/arm")?,
                stop: self.node.client("executor/stop")?,
                release: self.node.client("executor/reset")?,
            }));
        }
        Ok(())
    }

    /// Executes a command whose permission was checked. The returned future waits for other nodes.
    pub(crate) fn run(
        &self,
        command: Command,
        shared: &Arc<Shared>,
    ) -> impl Future<Output = Answer> + use<> {
        let (executor, shared) = (self.executor.clone(), Arc::clone(shared));
        let steering = self.steering.as_ref();
        let resets = steering.map(|steering| Arc::clone(&steering.resets));
        // published here, where the publishers are; the goal's picture was found before
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
        let picture = picture.ok_or("this picture has expired")?;
        let format = match picture.format {
            Format::Jpeg => "jpeg",
            Format::Png => "png",
        };
        let goal = CompressedImage {
            header: Header {
                // the time at which the goal was set; plans repeat it
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
            0 => format!("published on {topic}, but has no subscriber"),
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
            goals: node.publisher("goal/image/compressed", GOAL_QOS)?,
            chunks: node.publisher("action_chunk", CHUNK_QOS)?,
            resets: resets?.into(),
        })
    }
}

/// Calls a service that must exist.
async fn call<S: wm_msgs::Service>(
    client: &Client<S>,
    request: &S::Request,
) -> Result<S::Response, String> {
    let found = tokio::time::timeout(SEARCH_LIMIT, client.wait_for_service()).await;
    found.map_err(|_| format!("{} does not exist", client.name()))?;
    let answer = tokio::time::timeout(ANSWER_LIMIT, client.call(request)).await;
    answer
        .map_err(|_| format!("{} does not reply", client.name()))?
        .map_err(|error| error.to_string())
}

/// Resets all running nodes.
async fn reset(resets: &[(&'static str, Client<Reset>)]) -> Answer {
    let request = ResetRequest {
        keep_seed: true,
        ..ResetRequest::default()
    };
    let one =
        async |(name, client): &(&'static str, Client<Reset>)| match call(client, &request).await {
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
            Command::Arm { armed } => call(&self.arm, &SetBoolRequest { data: *armed }).await?,
            Command::Stop => call(&self.stop, &TriggerRequest::default()).await?,
            Command::Release => call(&self.release, &TriggerRequest::default()).await?,
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
