//! The trials on the wire.

use std::{fmt, path::PathBuf, sync::Arc, time::Duration};

use anyhow::{Context as _, Result, bail, ensure};
use image::RgbImage;
use serde::Serialize;
use tracing::{info, warn};
use wm_camera::camera_frame::CameraFrame;
use wm_metrics::findings::{ClosedLoop, Episode, PlanTime};
use wm_msgs::{
    std_msgs::{Bool, Float64},
    wm_msgs::Plan,
};
use wm_ros::{Node, NodeDefinition, NodeProgram, Qos, Setup, Subscription};
use wm_sim::SUCCESS_TOPIC;
use wm_wire::transport::{ImageSubscription, Transports};

use super::{EpisodeWatch, Shots, files, setting::Setting, strip::strip, task::Task};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Trials>();

/// Frames that an encoder may still be busy with when a new table is laid.
const FRAMES_BEFORE: usize = 3;

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// The tasks, in their order: reach, push or pick-place; with longest_time any that the arm knows.
        tasks: Vec<String> = vec!["reach".to_owned()];
        /// Episodes of each task.
        episodes: usize = 1, in 1..=100_000;
        /// Seed of the first episode of each task; each later one adds 1. The bundled model was not trained on the default.
        seed: u64 = 5_000_000;
        /// An episode takes so many times the time of the simulator's own controller at most.
        patience: f64 = 5.0, in 0.1..=1000.0;
        /// Time that every episode is given at least [s].
        least_time: f64 = 4.0, in 0.2..=3600.0;
        /// Longest time of an episode [s], in place of patience and least_time; 0: they hold. Needed for tasks that the
        /// simulator of this suite does not have.
        longest_time: f64 = 0.0, in 0.0..=3600.0;
        /// For how long a node or a message is waited for [s].
        timeout: Duration = 60.0, in 1.0..=3600.0;
        /// Folder for the findings, relative to the working directory.
        output: PathBuf = "out/arm";
        /// Image transport of the camera and of the pictures of plans.
        _image_transport as "image_transport": Transports = "raw";
    }
}

wm_ros::endpoints! {
    /// Topics.
    struct Endpoints {
        /// What the camera sees.
        frames: ImageSubscription = "/camera/image_raw", qos(Qos::best_effort(8));
        /// What it is to see.
        goals: ImageSubscription = "goal/image", made(ImageSubscription::catching_up);
        /// What it would see after the plan.
        outcomes: ImageSubscription = "plan/image", qos(Qos::best_effort(8));
        /// Its subgoals.
        subgoals: ImageSubscription = "plan/subgoals/image", qos(Qos::best_effort(8));
        /// Plans.
        plans: Subscription<Plan> = "plan", qos(Qos::reliable(64));
        /// What is missing to the goal [m].
        distances: Subscription<Float64> = "sim_arm/distance", qos(Qos::reliable(64));
        /// Whether the task is done.
        successes: Subscription<Bool> = SUCCESS_TOPIC, qos(Qos::latched(1));
        /// The services of the other nodes.
        setting: Setting;
    }
}

/// A run in words.
#[derive(Clone, Debug, Serialize)]
struct About {
    task: String,
    planner: String,
    live: bool,
    seed: u64,
    /// What [`ClosedLoop`] calls a model step \[ms\].
    step_ms: f64,
}

impl fmt::Display for About {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} by {}, live", self.task, self.planner)
    }
}

struct Trials {
    goal: Option<RgbImage>,
}

impl NodeProgram for Trials {
    const NAME: &'static str = "trials";
    const ABOUT: &'static str =
        "Has the simulated arm do its tasks by the planner, and counts how often it succeeds.";
    const RUNS_ALONE: bool = true;
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = ();
    type Error = anyhow::Error;

    fn check(parameters: &Parameters) -> Result<()> {
        parameters.tasks().map(drop)
    }

    async fn load(_: &Node, _: &Arc<Parameters>) -> Result<()> {
        Ok(())
    }

    fn activate(_: &Setup<Self>) -> Result<Self> {
        Ok(Self { goal: None })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let shutdown = at.node.shutdown();
        tokio::select! {
            () = shutdown.wait() => bail!("ended before the last episode"),
            done = self.tasks(at) => done,
        }
    }
}

impl Parameters {
    /// The tasks.
    fn tasks(&self) -> Result<Vec<Task>> {
        ensure!(
            !self.tasks.is_empty(),
            "parameter tasks is empty: expected reach, push or pick-place"
        );
        let parse = |name: &String| Task::new(name, self.longest_time).context("parameter tasks");
        self.tasks.iter().map(parse).collect()
    }
}

/// An input that a trial cannot do without has ended.
fn ended() -> anyhow::Error {
    anyhow::anyhow!("the graph is shut down")
}

fn decoded(frame: &CameraFrame) -> Option<RgbImage> {
    let decoded = frame.decode();
    decoded
        .map_err(|problem| warn!("picture ignored: {problem}"))
        .ok()
}

impl Trials {
    async fn tasks(&mut self, at: &mut Setup<Self>) -> Result<()> {
        tokio::time::timeout(at.parameters.timeout, at.endpoints.setting.wait())
            .await
            .context("sim_arm, planner and executor are needed, and not all of them are running")?;
        for task in at.parameters.tasks()? {
            self.task(at, &task).await?;
        }
        Ok(())
    }

    /// All episodes of a task, and what came of them.
    async fn task(&mut self, at: &mut Setup<Self>, task: &Task) -> Result<()> {
        let (first, count) = (at.parameters.seed, at.parameters.episodes);
        let (mut episodes, mut plans): (Vec<Episode>, Vec<PlanTime>) = (Vec::new(), Vec::new());
        let (mut planner, mut shown) = (None, Shots::default());
        for index in 0..count {
            let watch = self
                .episode(at, task, first.wrapping_add(index as u64))
                .await?;
            planner = watch
                .planner()
                .map(|(name, ms)| (name.to_owned(), ms))
                .or(planner);
            let (episode, of_episode, shots) = watch.finish();
            info!(
                "{task} {} of {count}, seed {}: {} after {} steps, {:.3} m to the goal",
                index + 1,
                episode.seed,
                if episode.success { "done" } else { "not done" },
                episode.steps,
                episode.distance_m
            );
            episodes.push(episode);
            plans.extend(of_episode);
            shown = shots;
        }
        let (planner, step_ms) =
            planner.context("no plan has come on plan: is there a planner?")?;
        let title = format!(
            "{task} by {planner}, seed {}",
            first.wrapping_add(count as u64 - 1)
        );
        let about = About {
            task: task.to_string(),
            planner,
            live: true,
            seed: first,
            step_ms,
        };
        let findings = ClosedLoop::of(about, step_ms, episodes, &plans)?;
        let picture = strip(&shown, self.goal.as_ref(), &title);
        let folder = &at.parameters.output;
        let written = files::write(folder, task.name(), &findings, picture.as_ref())?;
        let mut text = format!("{findings}\n");
        for path in written {
            text.push_str(&format!("{}\n", path.display()));
        }
        wm_ros::logging::print(text);
        Ok(())
    }

    /// One episode, from the reset to the end.
    async fn episode(
        &mut self,
        at: &mut Setup<Self>,
        task: &Task,
        seed: u64,
    ) -> Result<EpisodeWatch> {
        let timeout = at.parameters.timeout;
        let (patience, least_s) = (at.parameters.patience, at.parameters.least_time);
        let own = task.clone();
        let most = tokio::task::spawn_blocking(move || own.most_steps(seed, patience, least_s));
        let most = most.await??;
        tokio::time::timeout(timeout, begin(at, task, seed))
            .await
            .with_context(|| {
                format!("{task} with seed {seed} does not begin: no answer, no frame or no plan")
            })??;
        let mut watch = EpisodeWatch::new(seed, most);
        while !watch.is_over() {
            tokio::time::timeout(timeout, self.watch(&mut at.endpoints, &mut watch))
                .await
                .context("sim_arm has fallen silent")??;
        }
        at.endpoints.setting.arm(false).await?;
        Ok(watch)
    }

    /// Takes the next message.
    async fn watch(&mut self, endpoints: &mut Endpoints, watch: &mut EpisodeWatch) -> Result<()> {
        tokio::select! {
            biased;
            // The arm publishes it before the success that it leads to.
            distance = endpoints.distances.recv() => {
                watch.distance(distance.ok_or_else(ended)?.message.data);
            }
            success = endpoints.successes.recv() => {
                watch.success(success.ok_or_else(ended)?.message.data);
            }
            Some(goal) = endpoints.goals.recv() => {
                self.goal = decoded(&goal.message).or_else(|| self.goal.take());
            }
            plan = endpoints.plans.recv() => watch.plan(&plan.ok_or_else(ended)?.message),
            Some(outcome) = endpoints.outcomes.recv() => {
                if let Some(picture) = decoded(&outcome.message) {
                    watch.outcome(picture);
                }
            }
            Some(subgoals) = endpoints.subgoals.recv() => {
                if let Some(picture) = decoded(&subgoals.message) {
                    watch.subgoals(picture);
                }
            }
            frame = endpoints.frames.recv() => {
                let frame = frame.ok_or_else(ended)?.message;
                watch.frame(frame.header().stamp.to_nanos(), || decoded(&frame));
            }
        }
        Ok(())
    }
}

/// Lays the table, waits until the planner has planned for it, and arms the executor.
async fn begin(at: &mut Setup<Trials>, task: &Task, seed: u64) -> Result<()> {
    let endpoints = &mut at.endpoints;
    endpoints.setting.arm(false).await?;
    endpoints.setting.lay(task.name(), seed).await?;
    // The arm says so once the new table is there.
    while endpoints
        .successes
        .recv()
        .await
        .ok_or_else(ended)?
        .message
        .data
    {}
    for _ in 0..FRAMES_BEFORE {
        endpoints.frames.recv().await.ok_or_else(ended)?;
    }
    endpoints.setting.plan_anew(seed).await?;
    while endpoints.plans.try_recv().is_some() {}
    endpoints.plans.recv().await.ok_or_else(ended)?;
    while endpoints.distances.try_recv().is_some() {}
    while endpoints.outcomes.try_recv().is_some() {}
    while endpoints.subgoals.try_recv().is_some() {}
    endpoints.setting.arm(true).await
}
