//! The active env: its calls, its episode by topics, and its next job.

use std::{
    collections::{BTreeSet, VecDeque},
    time::Duration,
};

use anyhow::{Context as _, Result};
use tokio::time::Instant;
use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::String as Text,
    wm_msgs::{
        EnvObservation, EnvReset, EnvResetRequest, EnvResetResponse, EnvStep, EnvStepResponse,
    },
};
use wm_ros::{Call, Clock, Diagnostics, Qos};

use super::{
    super::{Attached, EnvError, Move, Moved, Observation, Start, parameters::Parameters},
    EnvNode,
    answers::{response, shortened},
    jobs::{Job, JobResult, Resetter, RunningJob, Stepper, as_move},
    policy::{action_topics, has_policy, missing, publish},
};
use crate::{
    history::{HistoryError, seconds},
    work::Work,
};
use wm_camera::camera_frame::CameraFrame;
use wm_ros::complaints::Complaints;
use wm_wire::transport::{ImageSubscription, Transports};

/// An observation without an answer is published again after this time: it may be lost, or the policy may have restarted.
const RESEND: Duration = Duration::from_secs(1);
/// How long a policy may take before the env warns.
const PATIENCE: Duration = Duration::from_secs(5);
/// How often the graph is checked for a policy.
const LOOK: Duration = Duration::from_millis(100);

/// Most calls of one kind that wait.
const MOST_WAITING: usize = 64;
/// The first call waits for further calls for this long, so that they are computed together. Far shorter than a step.
const GATHER: Duration = Duration::from_millis(5);

/// A reset that waits for the image that it starts from.
pub(super) struct PendingReset {
    pub(super) images: ImageSubscription,
    pub(super) topic: String,
    pub(super) request: EnvResetRequest,
    pub(super) resetter: Resetter,
    pub(super) until: Instant,
}

/// The episode that is played through topics.
pub(super) struct TopicEpisode {
    pub(super) attached: Attached,
    pub(super) observation: Observation,
    /// Earliest time of the next step.
    pub(super) due: Instant,
    pub(super) published: Instant,
    /// When this observation was published first.
    pub(super) shown: Instant,
    /// Whether the task was done, from `/task/success`; it ends the episode.
    pub(super) outcome: Option<bool>,
    pub(super) is_over: bool,
}

pub(super) struct EnvServer {
    pub(super) work: Work<Job, JobResult>,
    pub(super) running: RunningJob,
    pub(super) waiting_resets: VecDeque<(EnvResetRequest, Resetter)>,
    pub(super) waiting_steps: VecDeque<(Call<EnvStep>, Time)>,
    /// When the waiting calls are computed.
    pub(super) gather_until: Instant,
    pub(super) pending_reset: Option<PendingReset>,
    pub(super) topic_episode: Option<TopicEpisode>,
    /// Number of episodes by topics so far.
    pub(super) begun: u64,
    pub(super) clock: Clock,
    pub(super) complaints: Complaints,
    pub(super) diagnostics: Diagnostics,
}

impl EnvServer {
    /// Starts the next job if the thread is idle; returns whether all episodes of the env have ended.
    pub(super) fn start_next(&mut self, node: &EnvNode) -> Result<bool> {
        let now = Instant::now();
        if self
            .pending_reset
            .as_ref()
            .is_some_and(|pending_reset| pending_reset.until <= now)
            && let Some(pending_reset) = self.pending_reset.take()
        {
            let error = EnvError::Silent {
                topic: pending_reset.topic,
                seconds: node.parameters.start_timeout.as_secs_f64(),
            };
            self.refuse_reset(pending_reset.resetter, &error)?;
        }
        let is_by_topics = node.parameters.episodes > 0;
        if is_by_topics && self.topic_episode.is_none() && !self.is_resetting_topics() {
            if self.begun == node.parameters.episodes {
                return Ok(true);
            }
            if has_policy(node) {
                let mut request = node.parameters.reset();
                request.seed = request.seed.wrapping_add(self.begun);
                self.begun += 1;
                self.waiting_resets.push_back((request, Resetter::Topics));
                self.complaints
                    .working("an episode is played through topics");
            } else {
                let (kind, text) = missing(node);
                self.complaints.waiting(kind, true, &text);
            }
        }
        self.remind(now, node)?;
        if !matches!(self.running, RunningJob::Nothing) {
            return Ok(false);
        }
        if let Some((request, resetter)) = self.waiting_resets.pop_front() {
            self.reset(request, resetter, node)?;
            return Ok(false);
        }
        self.step(now, node);
        Ok(false)
    }

    fn is_resetting_topics(&self) -> bool {
        let is_topics = |resetter: &Resetter| matches!(resetter, Resetter::Topics);
        let is_running =
            matches!(&self.running, RunningJob::Reset(resetter) if is_topics(resetter));
        is_running
            || self
                .waiting_resets
                .iter()
                .any(|(_, resetter)| is_topics(resetter))
            || self
                .pending_reset
                .as_ref()
                .is_some_and(|pending_reset| is_topics(&pending_reset.resetter))
    }

    /// When the next step is due without input.
    pub(super) fn wake(&self, parameters: &Parameters) -> Instant {
        let now = Instant::now();
        let mut wake = now + RESEND;
        if let Some(pending_reset) = &self.pending_reset {
            wake = wake.min(pending_reset.until);
        }
        if matches!(self.running, RunningJob::Nothing) && !self.waiting_steps.is_empty() {
            wake = wake.min(self.gather_until);
        }
        match &self.topic_episode {
            // A step that is due waits for the policy, not for the time.
            Some(episode) if episode.due > now => wake.min(episode.due),
            Some(_) => wake,
            None if self.begun < parameters.episodes => wake.min(now + LOOK),
            None => wake,
        }
    }

    /// Queues a call; refuses it at once if too many wait.
    pub(super) fn take_reset(&mut self, call: Call<EnvReset>) -> Result<()> {
        let request = call.request.clone();
        let resetter = Resetter::Service(Box::new(call));
        let waiting = self.waiting_resets.len();
        if waiting >= MOST_WAITING {
            return self.refuse_reset(resetter, &EnvError::Busy(waiting));
        }
        self.waiting_resets.push_back((request, resetter));
        Ok(())
    }

    /// Queues a call; refuses it at once if too many wait. Each episode may have two waiting steps.
    pub(super) fn take_step(&mut self, call: Call<EnvStep>, most_episodes: usize) {
        let waiting = self.waiting_steps.len();
        if waiting >= MOST_WAITING.max(2 * most_episodes) {
            let error = EnvError::Busy(waiting);
            self.complaints.left_out("step", &error);
            let now = self.clock.now();
            self.answer(call.respond(&response(Err(error), (now, now, now))));
            return;
        }
        if self.waiting_steps.is_empty() {
            self.gather_until = Instant::now() + GATHER;
        }
        self.waiting_steps.push_back((call, self.clock.now()));
    }

    /// Begins a reset, or waits for the image that it starts from.
    fn reset(
        &mut self,
        request: EnvResetRequest,
        resetter: Resetter,
        node: &EnvNode,
    ) -> Result<()> {
        match node.parameters.start(&request, &node.resources.start_root) {
            Err(error) => self.refuse_reset(resetter, &error),
            Ok(Start::Topic(topic)) => {
                if self.pending_reset.is_some() {
                    let error = EnvError::Silent {
                        topic,
                        seconds: 0.0,
                    };
                    return self.refuse_reset(resetter, &error);
                }
                match ImageSubscription::new(
                    &node.node,
                    &topic,
                    Transports::BOTH,
                    Qos::sensor_data(),
                ) {
                    Ok(images) => {
                        self.pending_reset = Some(PendingReset {
                            images,
                            topic,
                            request,
                            resetter,
                            until: Instant::now() + node.parameters.start_timeout,
                        });
                        Ok(())
                    }
                    Err(error) => self.refuse_reset(resetter, &error),
                }
            }
            Ok(start) => {
                self.begin(request, start, resetter);
                Ok(())
            }
        }
    }

    fn begin(&mut self, request: EnvResetRequest, start: Start, resetter: Resetter) {
        let begin = self.clock.now();
        self.running = RunningJob::Reset(resetter);
        self.submit(Job::Reset {
            request,
            start,
            begin,
        });
    }

    pub(super) fn image(&mut self, frame: CameraFrame) {
        if let Some(PendingReset {
            request, resetter, ..
        }) = self.pending_reset.take()
        {
            // While another job runs, the reset returns to the queue, and will wait for a newer image.
            if matches!(self.running, RunningJob::Nothing) {
                self.begin(request, Start::Frame(Box::new(frame)), resetter);
            } else {
                self.waiting_resets.push_front((request, resetter));
            }
        }
    }

    fn refuse_reset(&mut self, resetter: Resetter, error: &dyn std::fmt::Display) -> Result<()> {
        match resetter {
            Resetter::Service(call) => {
                self.complaints.left_out("reset", error);
                let response = EnvResetResponse {
                    message: shortened(error),
                    ..EnvResetResponse::default()
                };
                self.answer(call.respond(&response));
                Ok(())
            }
            // Without a client, no further episode can begin.
            Resetter::Topics => anyhow::bail!("cannot begin the episode: {error}"),
        }
    }

    /// Starts the waiting moves, one for each episode, as one batch.
    fn step(&mut self, now: Instant, node: &EnvNode) {
        let mut moves = Vec::new();
        let mut steppers = Vec::new();
        let episode = self
            .topic_episode
            .as_ref()
            .filter(|episode| episode.is_over || episode.due <= now);
        if let Some(episode) = episode {
            let next = if episode.is_over {
                Some(Vec::new())
            } else {
                episode.attached.next(node.parameters.hold)
            };
            if let Some(actions) = next {
                moves.push(Move {
                    episode_id: episode.attached.episode_id().to_owned(),
                    actions,
                    close: episode.is_over,
                    outcome: episode.outcome,
                });
                steppers.push(Stepper::Topics);
            }
        }
        if !moves.is_empty() || self.gather_until <= now {
            self.gather(&mut moves, &mut steppers, node);
        }
        if !moves.is_empty() {
            self.running = RunningJob::Steps(steppers);
            self.submit(Job::Step(moves));
        }
    }

    /// Adds the first waiting call of each episode.
    fn gather(&mut self, moves: &mut Vec<Move>, steppers: &mut Vec<Stepper>, node: &EnvNode) {
        let own = self
            .topic_episode
            .as_ref()
            .map(|episode| episode.attached.episode_id().to_owned());
        let mut taken = BTreeSet::new();
        let mut later = VecDeque::new();
        for (call, received) in std::mem::take(&mut self.waiting_steps) {
            let id = &call.request.episode_id;
            if own.as_ref() == Some(id) {
                let response = EnvStepResponse {
                    message: format!("episode \"{id}\" is played through topics"),
                    ..EnvStepResponse::default()
                };
                self.answer(call.respond(&response));
            } else if moves.len() >= node.parameters.max_episodes || !taken.insert(id.clone()) {
                later.push_back((call, received));
            } else {
                moves.push(as_move(&call.request));
                steppers.push(Stepper::Service { call, received });
            }
        }
        self.waiting_steps = later;
    }

    fn submit(&mut self, job: Job) {
        // The thread is idle, as `running` shows, so the queue drops nothing.
        if self.work.submit(job).is_some() {
            tracing::error!("a job of the env was dropped");
        }
    }

    pub(super) fn finish_job(&mut self, result: JobResult, node: &EnvNode) -> Result<()> {
        let running = std::mem::replace(&mut self.running, RunningJob::Nothing);
        match (result, running) {
            (JobResult::Reset(begun), RunningJob::Reset(resetter)) => match begun {
                Ok(begun) => self.announce(*begun, resetter, node),
                Err(error) => {
                    let error = match &resetter {
                        Resetter::Service(call) if names_file(&call.request) => {
                            error.without_file()
                        }
                        _ => error,
                    };
                    self.refuse_reset(resetter, &error)
                }
            },
            (JobResult::Step { moved, start, end }, RunningJob::Steps(steppers)) => {
                let taken_ns = end.to_nanos().saturating_sub(start.to_nanos());
                // Zero if the clock was set back meanwhile.
                let taken = Duration::from_nanos(u64::try_from(taken_ns).unwrap_or(0));
                self.diagnostics.latency("step").record(taken);
                self.diagnostics.set_value("batch", steppers.len());
                for (stepper, moved) in steppers.into_iter().zip(moved) {
                    match stepper {
                        Stepper::Service { call, received } => {
                            match &moved {
                                Ok(moved) => show(&call.request.episode_id, moved, node)?,
                                Err(error) => self.complaints.left_out("step", error),
                            }
                            let response = response(moved, (received, start, end));
                            self.answer(call.respond(&response));
                        }
                        Stepper::Topics => self.stepped(moved, node)?,
                    }
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn announce(
        &mut self,
        (response, observation): (EnvResetResponse, Observation),
        resetter: Resetter,
        node: &EnvNode,
    ) -> Result<()> {
        tracing::info!(
            "episode {} begins: \"{}\"",
            response.episode_id,
            response.instruction
        );
        match resetter {
            Resetter::Service(call) => {
                node.endpoints.observations.publish(&EnvObservation {
                    episode_id: response.episode_id.clone(),
                    step: 0,
                    image: observation.jpeg,
                })?;
                self.answer(call.respond(&response));
                Ok(())
            }
            Resetter::Topics => {
                node.endpoints.instructions.publish(&Text {
                    data: response.instruction,
                })?;
                publish(&observation, node)?;
                let (now, stamp) = (Instant::now(), observation.jpeg.header.stamp);
                let merging = node.parameters.merging.0;
                self.topic_episode = Some(TopicEpisode {
                    attached: Attached::new(
                        response.episode_id,
                        node.resources.encoding.clone(),
                        node.resources.timing,
                        merging,
                        stamp,
                    ),
                    observation,
                    // Pictures are not published before their time: other nodes refuse stamps ahead of the clock.
                    due: now + node.parameters.period(),
                    published: now,
                    shown: now,
                    outcome: None,
                    is_over: false,
                });
                Ok(())
            }
        }
    }

    /// Publishes an unanswered observation again, and warns.
    fn remind(&mut self, now: Instant, node: &EnvNode) -> Result<()> {
        if let Some(episode) = &mut self.topic_episode
            && !episode.is_over
            && now.duration_since(episode.published) >= RESEND
            && matches!(self.running, RunningJob::Nothing)
        {
            episode.published = now;
            let observation = episode.observation.clone();
            let is_long = now.duration_since(episode.shown) >= PATIENCE;
            publish(&observation, node)?;
            if is_long {
                let stamp = seconds(observation.jpeg.header.stamp);
                let topics = action_topics(node);
                self.complaints.waiting(
                    "actions",
                    false,
                    &format!("no actions on {topics} for the image of {stamp}"),
                );
            }
        }
        Ok(())
    }

    /// Handles a step or the end of the episode.
    fn stepped(&mut self, moved: Result<Moved, EnvError>, node: &EnvNode) -> Result<()> {
        let moved = moved.context("the episode played through topics")?;
        let Some(mut episode) = self.topic_episode.take() else {
            return Ok(());
        };
        if episode.is_over && moved.observations.is_empty() {
            let name = episode.attached.episode_id();
            match &moved.bag {
                Some(bag) => tracing::info!(
                    "episode {name} ends after {} steps: {}",
                    moved.steps,
                    bag.display()
                ),
                None => tracing::info!("episode {name} ends after {} steps", moved.steps),
            }
            return Ok(());
        }
        for observation in moved.observations {
            episode.attached.observed(observation.jpeg.header.stamp);
            publish(&observation, node)?;
            episode.observation = observation;
        }
        let now = Instant::now();
        self.complaints
            .working("an episode is played through topics");
        episode.published = now;
        episode.shown = now;
        episode.due = (episode.due + node.parameters.period()).max(now);
        episode.is_over |= moved.truncated;
        self.topic_episode = Some(episode);
        Ok(())
    }

    /// Reports the result for an action or a chunk with this stamp; `None`: no episode is played through topics.
    pub(super) fn note(&mut self, taken: Option<Result<bool, HistoryError>>, stamp: Time) {
        let shown = self.topic_episode.as_ref();
        let shown = shown.map(|episode| seconds(episode.observation.jpeg.header.stamp));
        match taken {
            Some(Ok(true)) => {}
            Some(Ok(false)) => self.complaints.left_out(
                "untimely_action",
                &format_args!(
                    "the action of {} does not answer the current image: stamp it with the stamp of the image that it \
                     answers; the newest image is that of {}",
                    seconds(stamp),
                    shown.as_deref().unwrap_or("none")
                ),
            ),
            Some(Err(error)) => self.complaints.left_out("malformed_action", &error),
            None => self.complaints.left_out(
                "no_episode",
                &"an action arrived while no episode is played through topics",
            ),
        }
    }

    fn answer(&mut self, answered: Result<(), wm_ros::Error>) {
        if let Err(error) = answered {
            self.complaints.left_out("answer", &error);
        }
    }
}

/// Whether the caller, not a parameter, names the file of the start.
fn names_file(request: &EnvResetRequest) -> bool {
    !request.bag.is_empty() || !request.image.is_empty()
}

/// Publishes the observations of an episode by service, before the answer is sent.
fn show(episode_id: &str, moved: &Moved, node: &EnvNode) -> Result<()> {
    // At most MAX_CHUNK steps.
    let first = moved.steps.saturating_sub(moved.observations.len() as u32);
    for (step, observation) in (first + 1..).zip(&moved.observations) {
        node.endpoints.observations.publish(&EnvObservation {
            episode_id: episode_id.to_owned(),
            step,
            image: observation.jpeg.clone(),
        })?;
    }
    Ok(())
}
