//! The env's ROS interface.

mod answers;
mod jobs;
mod policy;
mod server;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use anyhow::{Context as _, Result};
use tokio::time::Instant;
use wm_motion::actions::ActionEncoding;
use wm_msgs::{
    std_msgs::{Bool, String as Text},
    wm_msgs::{
        Action, ActionChunk, EnvObservation, EnvReset, EnvResetResponse, EnvStep, EnvStepResponse,
    },
};
use wm_ros::{
    NodeDefinition, Publisher, Qos, Received, Requests, Service, Subscription,
    complaints::Complaints,
};
use wm_zoo::ModelFolder;

use super::{Env, EnvModel, Start, StartRoot, parameters::Parameters, start::INSTRUCTION};
use crate::{
    encoder::EncoderStep,
    harness::{self, ModelNode, ModelSetup},
    history::Timing,
    work::Work,
};
use jobs::{Job, JobResult, RunningJob};
use server::{EnvServer, PendingReset};
use wm_camera::camera_frame::CameraFrame;
use wm_wire::{latent_message::LatentDtype, transport::ImagePublisher};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<EnvServer>();

/// Queue length of the observations by service: a chunk for each of a few episodes.
const OBSERVATIONS: usize = 64;
/// Longest wait for the acknowledgement of the last observation.
const FAREWELL: Duration = Duration::from_millis(500);
/// Longest message that ROS 2 receives with the default buffers of Linux \[byte\].
const SAFE_BYTES: usize = 98_000;

// Reliable publishers also match best effort subscriptions, and a policy must not miss a frame.
wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Actions of a policy, for the episode that is played through topics.
        actions: Subscription<Action> = "action";
        /// Action chunks of a policy, for the episode that is played through topics.
        chunks: Subscription<ActionChunk> = "action_chunk";
        /// Whether the task was done. Ends the episode that is played through topics.
        successes: Subscription<Bool> = "/task/success";
        /// Predicted pictures of the episode that is played through topics.
        pictures: ImagePublisher = "/camera/image_raw";
        /// The policy's task in words.
        instructions: Publisher<Text> = INSTRUCTION, qos(Qos::latched(1));
        /// Predicted pictures of the episodes that are driven through services.
        observations: Publisher<EnvObservation> = "~/observation", qos(Qos::reliable(OBSERVATIONS));
        /// Requests of clients.
        requests: Requests<Request>;
    }
}

wm_ros::endpoints! {
    /// Requests of clients.
    enum Request {
        /// Begins an episode.
        Reset(Service<EnvReset>) = "~/reset", made(|node, name, _| node.service_or_refuse(name, |reason| {
            EnvResetResponse { message: reason.to_owned(), ..EnvResetResponse::default() }
        }));
        /// Executes actions in an episode.
        Step(Service<EnvStep>) = "~/step", made(|node, name, _| node.service_or_refuse(name, |reason| {
            EnvStepResponse { message: reason.to_owned(), ..EnvStepResponse::default() }
        }));
    }
}

/// The loaded parts of the model.
struct Model {
    env: Arc<Mutex<Env>>,
    timing: Timing,
    encoding: ActionEncoding,
    start_root: StartRoot,
}

/// The configured node.
type EnvNode = ModelSetup<EnvServer>;

impl ModelNode for EnvServer {
    const NAME: &'static str = "env";
    const ABOUT: &'static str =
        "Makes the world model the environment of a policy, in place of camera and robot.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Model = Model;

    fn check(parameters: &Parameters) -> Result<()> {
        if parameters.episodes > 0 {
            parameters.own_start()?;
        }
        Ok(())
    }

    fn load(folder: ModelFolder, parameters: &Parameters) -> Result<Model> {
        let encoder = EncoderStep::of_model(&folder, LatentDtype::F32)?;
        let (predictor, decoder) = (folder.world_model()?, folder.decoder()?);
        let decoder = decoder.with_context(|| {
            format!(
                "model {} has no decoder, but the env needs one to publish pictures",
                folder.name()
            )
        })?;
        let world = EnvModel::new(
            encoder,
            predictor,
            decoder,
            parameters.integration_steps,
            parameters.batch,
        );
        let timing = Timing::of_camera(parameters.frame_period, &world.predictor().encoding);
        tracing::info!(
            "world model {} in latent space {}: a step is {} s and takes {} actions",
            world.predictor().name,
            world.predictor().space,
            timing.step_ns() as f64 / 1e9,
            timing.frame_skip,
        );
        if parameters.image_transport.raw && world.raw_bytes() > SAFE_BYTES {
            tracing::warn!(
                "raw pictures have {} bytes: a ROS 2 subscriber with default settings loses messages of more than \
                 {SAFE_BYTES} bytes; use image_transport:=compressed, or enlarge the receive buffer on its machine",
                world.raw_bytes(),
            );
        }
        let encoding = world.predictor().encoding.clone();
        let env = Env::new(world, parameters.settings(), timing);
        if parameters.episodes > 0 {
            // A start that cannot work is an error now, not when the first policy connects.
            let start = parameters.own_start()?;
            if !matches!(start, Start::Topic(_)) {
                env.check(&start)?;
            }
        }
        let env = Arc::new(Mutex::new(env));
        Ok(Model {
            env,
            timing,
            encoding,
            start_root: StartRoot::new(&parameters.start_root)?,
        })
    }

    fn activate(at: &EnvNode) -> Result<Self> {
        let env = Arc::clone(&at.resources.env);
        let clock = at.node.clock();
        let work = Work::new(1, move |job: Job, _| {
            let mut env = lock(&env);
            match job {
                Job::Reset {
                    request,
                    start,
                    begin,
                } => JobResult::Reset(env.reset(&request, &start, begin).map(Box::new)),
                Job::Step(moves) => {
                    let start = clock.now();
                    let moved = env.step(&moves);
                    JobResult::Step {
                        moved,
                        start,
                        end: clock.now(),
                    }
                }
            }
        });
        Ok(Self {
            work,
            running: RunningJob::Nothing,
            waiting_resets: VecDeque::new(),
            waiting_steps: VecDeque::new(),
            gather_until: Instant::now(),
            pending_reset: None,
            topic_episode: None,
            begun: 0,
            clock: at.node.clock(),
            complaints: Complaints::new(at.node.diagnostics()),
            diagnostics: at.node.diagnostics(),
        })
    }

    async fn run(&mut self, at: &mut EnvNode) -> Result<()> {
        let result = self.serve(at).await;
        let env = Arc::clone(&at.resources.env);
        let failed = tokio::task::spawn_blocking(move || lock(&env).close()).await?;
        for error in failed {
            tracing::error!("cannot finish the bag of an episode: {error}");
        }
        result
    }
}

impl EnvServer {
    async fn serve(&mut self, at: &mut EnvNode) -> Result<()> {
        loop {
            if self.start_next(at)? {
                if let Some(jpegs) = at.endpoints.pictures.compressed() {
                    jpegs.wait_for_acknowledgments(FAREWELL).await?;
                }
                return Ok(());
            }
            let wake = self.wake(&at.parameters);
            let endpoints = &mut *at.endpoints;
            tokio::select! {
                biased;
                finished = self.work.finished() => self.finish_job(finished.context("the env's thread")?, at)?,
                request = endpoints.requests.next_request() => match request {
                    None => return Ok(()),
                    Some(Request::Reset(call)) => self.take_reset(call)?,
                    Some(Request::Step(call)) => self.take_step(call, at.parameters.max_episodes),
                },
                received = endpoints.actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = self.topic_episode.as_mut().map(|episode| episode.attached.action(&received.message));
                    self.note(taken, received.message.header.stamp);
                }
                received = endpoints.chunks.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = self.topic_episode.as_mut().map(|episode| episode.attached.chunk(&received.message));
                    self.note(taken, received.message.header.stamp);
                }
                received = endpoints.successes.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    if let Some(episode) = &mut self.topic_episode {
                        episode.outcome = Some(received.message.data);
                        episode.is_over = true;
                    }
                }
                frame = next_image(&mut self.pending_reset) => {
                    let Some(frame) = frame else { return Ok(()) };
                    self.image(frame);
                }
                () = tokio::time::sleep_until(wake) => {}
            }
        }
    }
}

/// The env's state stays valid if a thread panics between two moves.
fn lock(env: &Mutex<Env>) -> MutexGuard<'_, Env> {
    env.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn next_image(pending: &mut Option<PendingReset>) -> Option<CameraFrame> {
    match pending {
        Some(pending) => pending
            .images
            .recv()
            .await
            .map(|Received { message, .. }| message),
        None => std::future::pending().await,
    }
}
