//! The env on the wire.

mod active;
mod policy;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use anyhow::{Context as _, Result};
use tokio::time::Instant;
use wm_msgs::wm_msgs::EnvResetRequest;
use wm_ros::{Lifecycle, Managed, Node, NodeArgs, Qos, Received};

use super::{Env, Start, World, parameters::Parameters, start::INSTRUCTION};
use crate::{
    encoder::EncoderStep,
    model_choice::{self, ModelChoice},
    timeline::Timing,
    work::Work,
};
use active::{Active, Awaited, Done, InFlight, Job};
use wm_ros::complaints::Complaints;
use wm_wire::{
    camera_frame::CameraFrame,
    latent_message::LatentDtype,
    transport::{Transports, publish_images},
};

/// The node's default name.
pub const NAME: &str = "env";

/// Observations by service that may wait for a client: a chunk of each of some episodes.
const OBSERVATIONS: usize = 64;
/// How long the last observation may take to reach the policy.
const FAREWELL: Duration = Duration::from_millis(500);
/// What a stock ROS 2 machine receives without a larger buffer \[byte\].
const SAFE_BYTES: usize = 98_000;

/// Runs the node until SIGINT or SIGTERM, or until the episodes are played that the parameter `episodes` asks for.
///
/// # Errors
/// Wrong arguments or parameters, weights that cannot be loaded, the graph.
pub fn run(args: &NodeArgs) -> Result<()> {
    args.expect_no_rest()?;
    wm_ros::run(NAME, wm_ros::NAMESPACE, args, body)
}

/// The node itself, in a process that may hold others.
///
/// # Errors
/// As [`run`].
pub async fn body(node: Node) -> Result<()> {
    let lifecycle = Lifecycle::new(&node)?;
    let model = model_choice::declare(&node)?;
    let transports = Transports::declare(&node)?;
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    if parameters.episodes > 0 {
        parameters.start(&EnvResetRequest::default())?;
    }
    let env = EnvNode {
        node,
        model,
        transports,
        parameters,
    };
    lifecycle.run(env).await
}

struct EnvNode {
    node: Node,
    model: ModelChoice,
    transports: Transports,
    parameters: Parameters,
}

struct Configured {
    env: Arc<Mutex<Env>>,
    timing: Timing,
}

impl EnvNode {
    /// That episodes by topics can begin is said now, not when the first policy comes.
    async fn checked(&self, env: Env) -> Result<Env> {
        if self.parameters.episodes == 0 {
            return Ok(env);
        }
        let start = self.parameters.start(&EnvResetRequest::default())?;
        if matches!(start, Start::Topic(_)) {
            return Ok(env);
        }
        let checked = tokio::task::spawn_blocking(move || env.check(&start).map(|()| env)).await?;
        Ok(checked?)
    }
}

impl Managed for EnvNode {
    type Configured = Configured;
    type Active = Active;
    type Error = anyhow::Error;

    async fn configure(&self) -> Result<Configured> {
        let (model, parameters) = (self.model.clone(), &self.parameters);
        let (integration_steps, batch) = (parameters.integration_steps, parameters.batch);
        let world = tokio::task::spawn_blocking(move || -> Result<_> {
            let open = model.open()?;
            let encoder = EncoderStep::new(open.encoder()?, LatentDtype::F32);
            let (predictor, decoder) = (open.predictor()?, open.decoder()?);
            let decoder = decoder.with_context(|| {
                format!(
                    "model {} has no decoder: an env shows pictures",
                    model.name()
                )
            })?;
            Ok(World::new(
                encoder,
                predictor,
                decoder,
                integration_steps,
                batch,
            ))
        })
        .await??;
        let timing = model_choice::timing(parameters.frame_period, &world.predictor().encoding);
        tracing::info!(
            "the world of {} in latent space {}: a step is {} s and takes {} actions",
            world.predictor().name,
            world.predictor().space,
            timing.step_ns() as f64 / 1e9,
            timing.frame_skip,
        );
        if self.transports.raw && world.raw_bytes() > SAFE_BYTES {
            tracing::warn!(
                "raw pictures of {} bytes: a stock ROS 2 subscriber loses messages beyond {SAFE_BYTES} bytes; use \
                 image_transport:=compressed, or give it a larger receive buffer",
                world.raw_bytes(),
            );
        }
        let env = Env::new(world, parameters.settings.clone(), timing);
        Ok(Configured {
            env: Arc::new(Mutex::new(self.checked(env).await?)),
            timing,
        })
    }

    fn activate(&self, configured: &Configured) -> Result<Active> {
        let (node, env) = (&self.node, Arc::clone(&configured.env));
        let clock = node.clock();
        let work = Work::new(1, move |job: Job, _| {
            let mut env = lock(&env);
            match job {
                Job::Reset {
                    request,
                    start,
                    begin,
                } => Done::Reset(env.reset(&request, &start, begin).map(Box::new)),
                Job::Step(moves) => {
                    let start = clock.now();
                    let moved = env.step(&moves);
                    Done::Step {
                        moved,
                        start,
                        end: clock.now(),
                    }
                }
            }
        });
        // Reliable matches who asks for best effort too, and a policy must not miss a frame.
        let qos = Qos::reliable(10);
        let (raws, jpegs) = publish_images(node, "/camera/image_raw", self.transports, qos)?;
        Ok(Active {
            resets: node.service("~/reset")?,
            steps: node.service("~/step")?,
            actions: node.subscription("action", qos)?,
            chunks: node.subscription("action_chunk", qos)?,
            successes: node.subscription("/task/success", qos)?,
            raws,
            jpegs,
            instructions: node.publisher(INSTRUCTION, Qos::latched(1))?,
            observations: node.publisher("~/observation", Qos::reliable(OBSERVATIONS))?,
            work,
            in_flight: InFlight::Nothing,
            waiting_resets: VecDeque::new(),
            waiting_steps: VecDeque::new(),
            gathered: Instant::now(),
            awaited: None,
            played: None,
            begun: 0,
            env: Arc::clone(&configured.env),
            timing: configured.timing,
            clock: node.clock(),
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
        })
    }

    async fn run(&self, active: &mut Active) -> Result<()> {
        let result = self.serve(active).await;
        let env = Arc::clone(&active.env);
        let failed = tokio::task::spawn_blocking(move || lock(&env).close()).await?;
        for error in failed {
            tracing::error!("the bag of an episode is not finished: {error}");
        }
        result
    }
}

impl EnvNode {
    async fn serve(&self, active: &mut Active) -> Result<()> {
        loop {
            if active.go_on(self)? {
                if let Some(jpegs) = &active.jpegs {
                    jpegs.wait_for_acknowledgments(FAREWELL).await?;
                }
                return Ok(());
            }
            let wake = active.wake(&self.parameters);
            tokio::select! {
                biased;
                finished = active.work.finished() => active.done(finished.context("the env's thread")?, self)?,
                Some(call) = active.resets.recv() => active.take_reset(call)?,
                call = active.steps.recv() => {
                    let Some(call) = call else { return Ok(()) };
                    active.take_step(call, self.parameters.settings.max_episodes);
                }
                received = active.actions.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.played.as_mut().map(|played| played.attached.action(&received.message));
                    active.note(taken, received.message.header.stamp);
                }
                received = active.chunks.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    let taken = active.played.as_mut().map(|played| played.attached.chunk(&received.message));
                    active.note(taken, received.message.header.stamp);
                }
                received = active.successes.recv() => {
                    let Some(received) = received else { return Ok(()) };
                    if let Some(played) = &mut active.played {
                        played.outcome = Some(received.message.data);
                        played.is_over = true;
                    }
                }
                frame = next_image(&mut active.awaited) => {
                    let Some(frame) = frame else { return Ok(()) };
                    active.image(frame);
                }
                () = tokio::time::sleep_until(wake) => {}
            }
        }
    }
}

/// The env's state stays whole if a thread panics between two moves.
fn lock(env: &Mutex<Env>) -> MutexGuard<'_, Env> {
    env.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn next_image(awaited: &mut Option<Awaited>) -> Option<CameraFrame> {
    match awaited {
        Some(awaited) => awaited
            .images
            .recv()
            .await
            .map(|Received { message, .. }| message),
        None => std::future::pending().await,
    }
}
