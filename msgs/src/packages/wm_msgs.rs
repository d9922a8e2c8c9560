//! Package `wm_msgs`: latents, actions, predicted steps, their errors, goals, plans, and policies in the loop.

pub mod action;

use super::{
    builtin_interfaces::{Duration, Time},
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};
use serde::{Deserialize, Serialize};

/// Identity of a latent space. Two latents may be compared, or used in one model, only if both fields are equal.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatentSpace {
    /// Encoder and adapter in words, for example `tiny` or `web-dino+svae`.
    pub name: String,
    /// Lower-case hex SHA-256 over everything that defines the space: encoder, adapter, weights, normalisation.
    pub hash: String,
}

/// The latent grid of one camera frame, normalised per channel (mean 0, standard deviation 1 over the training data).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Latent {
    /// `stamp`: capture time of the frame; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// What the numbers mean.
    pub space: LatentSpace,
    /// Rows of the grid.
    pub height: u32,
    /// Columns of the grid.
    pub width: u32,
    /// Channels of a cell.
    pub channels: u32,
    /// Type of one number: [`F32`](Self::F32), [`F16`](Self::F16) or [`BF16`](Self::BF16).
    pub dtype: u8,
    /// Epoch of the frame; a reset or a clock jump starts a new epoch with a greater number.
    pub epoch: u64,
    /// Difference from the camera's previous frame, sensor noise removed: 0 (same) to 1;
    /// [`CameraState::NOT_MEASURED`] if there is none.
    pub change: f32,
    /// The camera has stopped (see [`CameraState`]): do not act on this frame.
    pub frozen: bool,
    /// `height` x `width` x `channels` little-endian numbers, row-major, channels last.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

impl Latent {
    /// IEEE 754 binary32, little endian.
    pub const F32: u8 = 0;
    /// IEEE 754 binary16, little endian.
    pub const F16: u8 = 1;
    /// bfloat16, little endian.
    pub const BF16: u8 = 2;
}

/// What the frames of a camera show about the camera itself. The encoder publishes one for each frame that it receives.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraState {
    /// Of the newest frame. `stamp`: capture time; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// Difference from the previous frame, sensor noise removed: 0 (same) to 1; [`NOT_MEASURED`](Self::NOT_MEASURED)
    /// if there is none.
    pub change: f32,
    /// How long the frames have not changed.
    pub unchanged: Duration,
    /// Frames per second, by their stamps \[Hz\]; 0 if not known yet.
    pub rate: f32,
    /// Frames per second that differ from their predecessor \[Hz\]; 0 if not known yet.
    pub distinct_rate: f32,
    /// The camera has stopped: do not act on its frames.
    pub frozen: bool,
    /// Why the camera counts as frozen; empty if it does not.
    pub reason: String,
}

impl CameraState {
    /// The [`change`](Self::change) of a frame without a predecessor.
    pub const NOT_MEASURED: f32 = -1.0;
}

/// One action of the robot, in physical units.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// `stamp`: when the action was taken; `frame_id`: the frame of the deltas (the robot's base).
    pub header: Header,
    /// Bridge V2: dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0 closed .. 1 open\].
    pub values: Vec<f32>,
}

/// The next actions, from a policy, a planner or a bag.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActionChunk {
    /// `stamp`: when the first action is (to be) taken; `frame_id`: the frame of the deltas.
    pub header: Header,
    /// Time from one action to the next.
    pub period: Duration,
    /// In order; each header's stamp is the chunk's stamp + index x `period`.
    pub actions: Vec<Action>,
    /// When the policy saw the image and computed; all zero if there is no policy.
    pub timing: Timing,
}

/// When the sender received the input of a message, and when it computed the message. A stamp of zero: not known.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Timing {
    /// Capture time of the newest image that was used.
    pub capture: Time,
    /// When that image was received (clock of the sender of the message).
    pub receive: Time,
    /// When the computation started (the same clock).
    pub start: Time,
    /// When it ended (the same clock).
    pub end: Time,
}

/// Chunks from which a policy chooses one. What each of them would do is predicted before any is executed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActionCandidates {
    /// `stamp`: capture time of the image that the policy responds to; `frame_id`: the frame of the deltas.
    pub header: Header,
    /// Name of the policy.
    pub policy: String,
    /// The candidates; an [`Assessment`] names them by their index.
    pub chunks: Vec<ActionChunk>,
}

/// What one candidate chunk would do, as the world model predicts it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CandidateAssessment {
    /// Of the candidate in [`ActionCandidates::chunks`].
    pub index: u32,
    /// Mean squared latent error to the goal after the last step; NaN if no goal is known.
    pub cost: f32,
    /// The same error after each step; empty if no goal is known.
    pub step_costs: Vec<f32>,
    /// From the success probe, 0 to 1; NaN if no probe is loaded or no instruction is known.
    pub success_probability: f32,
    /// The predicted latent after the last step; its stamp is the predicted time.
    pub latent: Latent,
}

/// What the candidates of a policy would do. A policy or a supervisor chooses or vetoes candidates by it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Assessment {
    /// `stamp`: capture time of the last observed frame; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// As in [`ActionCandidates`].
    pub policy: String,
    /// Stamp of the [`ActionCandidates`].
    pub candidates_stamp: Time,
    /// One for each candidate, in their order.
    pub candidates: Vec<CandidateAssessment>,
    /// Index of the candidate with the lowest cost; -1 if no goal is known.
    pub best: i32,
    /// Model steps that were predicted, the same for all candidates.
    pub horizon: u32,
    /// Duration of one model step.
    pub step_period: Duration,
    /// Name of the transition model.
    pub model: String,
    /// Lower-case hex SHA-256 of its weights and configuration.
    pub model_hash: String,
    /// Seed of the sampler's noise, which all candidates share.
    pub seed: u64,
    /// Capture of the observed frame, receipt of the candidates, start and end of the prediction.
    pub timing: Timing,
}

/// What the executor does with chunks and plans, and why.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExecutorStatus {
    /// `stamp`: when this was so; `frame_id`: the frame of the commands.
    pub header: Header,
    /// [`DRY_RUN`](Self::DRY_RUN), [`IDLE`](Self::IDLE), [`EXECUTING`](Self::EXECUTING), [`STOPPING`](Self::STOPPING) or
    /// [`STOPPED`](Self::STOPPED).
    pub state: u8,
    /// Why it does not move, or not as it was told; empty if it does.
    pub reason: String,
    /// Stamp of the chunk, or of the first action of the plan, being executed; zero: none.
    pub chunk_stamp: Time,
    /// Chunks and plans that were begun, in a dry run too.
    pub begun: u64,
    /// Chunks and plans that were refused, the vetoed ones included.
    pub refused: u64,
    /// Chunks that a rule about the model's predictions refused or cut short.
    pub vetoed: u64,
    /// Chunks and plans that were cut short.
    pub interrupted: u64,
}

impl ExecutorStatus {
    /// Not armed: commands are computed but not sent.
    pub const DRY_RUN: u8 = 0;
    /// Armed, and nothing to execute.
    pub const IDLE: u8 = 1;
    /// Armed, and a chunk or plan is being executed.
    pub const EXECUTING: u8 = 2;
    /// Commands decelerate to zero.
    pub const STOPPING: u8 = 3;
    /// Emergency stop: until reset and armed again.
    pub const STOPPED: u8 = 4;
}

/// One predicted step. A rollout is `horizon` messages with the same `observed_stamp`; each is sent when it is ready.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// `stamp`: the predicted time; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// Capture time of the last observed frame.
    pub observed_stamp: Time,
    /// k: how many model steps after the observation, from 1.
    pub step: u32,
    /// K: number of steps in this rollout.
    pub horizon: u32,
    /// Duration of one model step.
    pub step_period: Duration,
    /// The predicted latent; its header equals this message's.
    pub latent: Latent,
    /// The actions it was conditioned on, from the observation up to step k.
    pub actions: Vec<Action>,
    /// Epoch of the predictor's history; a reset or a clock jump starts a new epoch with a greater number.
    pub epoch: u64,
    /// Name of the transition model.
    pub model: String,
    /// Lower-case hex SHA-256 of its weights and configuration.
    pub model_hash: String,
    /// Seed of the sampler's noise.
    pub seed: u64,
    /// Euler steps of the sampler for each predicted frame.
    pub integration_steps: u32,
    /// When the predictor received the observed latent (node clock).
    pub received_stamp: Time,
    /// When this step was ready to be sent (node clock).
    pub ready_stamp: Time,
}

/// Error of a prediction, compared with the latent of the real frame at the predicted time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictionError {
    /// `stamp`: the predicted time; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// Stamp of the observation that the prediction started from.
    pub observed_stamp: Time,
    /// k: how many model steps after the observation.
    pub step: u32,
    /// Mean squared error of the predicted latent \[normalised latent units^2\].
    pub mse: f32,
    /// The same error for the persistence baseline: the last observed latent, repeated.
    pub persistence_mse: f32,
    /// `mse` / `persistence_mse`; below 1 the model beats the persistence baseline; NaN if both are 0.
    pub ratio: f32,
}

/// What the camera is to see: pictures or latents, reached one after the other, and what of them counts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// `stamp`: when the goal was set, which [`Plan::goal_stamp`] repeats; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// What the camera should see; several are reached one after the other.
    pub images: Vec<Image>,
    /// Instead of images: normalised latents of the planner's latent space.
    pub latents: Vec<Latent>,
    /// When each of them is to be reached, from when the goal was accepted; none: each when the one before it is
    /// reached.
    pub times: Vec<Duration>,
    /// `mono8`, of any size: only where it is not 0 counts; empty: the whole picture.
    pub mask: Image,
    /// The task in words, for the success probe; empty: none.
    pub instruction: String,
}

/// Actions that the planner found to bring the camera's latent close to the goal's latent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// `stamp`: capture time of the observed frame.
    pub header: Header,
    /// The planned actions, clamped to the bounds; each header's stamp says when it begins.
    pub actions: Vec<Action>,
    /// Duration of one planned action (one model step).
    pub period: Duration,
    /// The dimensions that were searched; the others hold their state, deltas are 0.
    pub searched: Vec<String>,
    /// Model steps from the observed frame to the first action; the robot's motion in between is predicted.
    pub lead_steps: u32,
    /// Epoch of the planner's history; a reset or a clock jump starts a new epoch with a greater number.
    pub epoch: u64,
    /// Cost of the planned actions: the weighted sum of the terms.
    pub cost: f32,
    /// The best cost after each iteration.
    pub iteration_costs: Vec<f32>,
    /// For example `cem`.
    pub planner: String,
    /// The planner's settings as JSON.
    pub settings: String,
    /// Seed of the planner's candidates and noise.
    pub seed: u64,
    /// Stamp of the goal that was planned for.
    pub goal_stamp: Time,
    /// The goal's picture or latent that the first action leads to, from 0.
    pub goal_index: u32,
    /// Mean squared error of the observed latent to the goal's last one; NaN for words alone.
    pub distance: f32,
    /// Planning time (wall time).
    pub time_taken: Duration,
    /// True if the deadline ended the search before its last iteration.
    pub deadline_cut: bool,
    /// How many candidates were rolled out.
    pub candidates: u32,
    /// Names of the terms of the cost.
    pub terms: Vec<String>,
    /// The plan's cost term by term, weighted; their sum is `cost`.
    pub term_costs: Vec<f32>,
    /// The plan's cost as predicted with other noise; how far these costs are apart says how far the prediction can be trusted.
    pub spread_costs: Vec<f32>,
}

/// What the camera sees, or is predicted to see, in an episode of the env.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvObservation {
    /// The episode's name.
    pub episode_id: String,
    /// Steps of the episode so far; 0: the first frame, as the world model sees it.
    pub step: u32,
    /// JPEG; its stamp is the episode's time.
    pub image: CompressedImage,
}

/// Service: begin an episode within the world model.
#[derive(Clone, Copy, Debug)]
pub struct EnvReset;

/// What a client of [`EnvReset`] sends. Set at most one of `bag`, `image` and `topic`. If none is set, the episode
/// starts where the env's parameters say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnvResetRequest {
    /// Name of the episode and of its bag; empty: the env chooses a name.
    pub episode_id: String,
    /// Bag (folder or `.mcap`) to take the first frame from, with the frames and actions just before it.
    pub bag: String,
    /// Time from the first frame of the bag to the first frame of the episode \[s\].
    pub bag_offset: f64,
    /// File of the first frame, PNG or JPEG.
    pub image: String,
    /// Camera topic whose next image, raw or compressed, is the first frame.
    pub topic: String,
    /// The policy's task; empty: the bag's instruction or, without one, the env's parameter.
    pub instruction: String,
    /// Seed of the episode's noise: the same start, calls and seed give the same images. It matters how actions are
    /// split into calls: the last step of a call assumes that its action is held, because the next one is not known
    /// yet.
    pub seed: u64,
    /// Steps after which the episode is truncated; 0: the env's parameter.
    pub max_steps: u32,
}

/// What a server of [`EnvReset`] answers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnvResetResponse {
    /// Whether the episode has begun.
    pub success: bool,
    /// If not successful, the reason.
    pub message: String,
    /// The episode's name.
    pub episode_id: String,
    /// The episode's instruction.
    pub instruction: String,
    /// Duration of one step of the env: one model step.
    pub step_period: Duration,
    /// Actions at the camera's frame rate in one step.
    pub actions_per_step: u32,
    /// Start of the episode: stamp of its first [`EnvObservation`].
    pub stamp: Time,
}

/// Service: take actions within an episode. Calls for several episodes that wait at the same time are computed as one
/// batch.
#[derive(Clone, Copy, Debug)]
pub struct EnvStep;

/// What a client of [`EnvStep`] sends.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnvStepRequest {
    /// The episode's name.
    pub episode_id: String,
    /// One action or a chunk, at the camera's frame rate; a step takes `actions_per_step` of them, and the last one is
    /// held.
    pub actions: Vec<Action>,
    /// End the episode after these actions (there may be none) and finish its bag.
    pub close: bool,
    /// With `close`, for the bag: [`UNKNOWN`](Self::UNKNOWN), [`SUCCESS`](Self::SUCCESS) or
    /// [`FAILURE`](Self::FAILURE).
    pub outcome: u8,
}

impl EnvStepRequest {
    /// It is not known whether the task was done.
    pub const UNKNOWN: u8 = 0;
    /// The task was done.
    pub const SUCCESS: u8 = 1;
    /// The task was not done.
    pub const FAILURE: u8 = 2;
}

/// What a server of [`EnvStep`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvStepResponse {
    /// Whether all actions were taken.
    pub success: bool,
    /// If not successful, the reason.
    pub message: String,
    /// Stamp of the newest [`EnvObservation`].
    pub stamp: Time,
    /// Steps of the episode so far.
    pub steps: u32,
    /// The episode has reached `max_steps`, or was closed: it takes no more actions.
    pub truncated: bool,
    /// The episode's bag; empty if none is recorded, and until it is finished.
    pub bag: String,
    /// Capture of the last observation before the call, receipt of the call, start and end of the step.
    pub timing: Timing,
}

/// Service: forget the observed history and any plan.
#[derive(Clone, Copy, Debug)]
pub struct Reset;

/// What a client of [`Reset`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetRequest {
    /// Seed of the next samples.
    pub seed: u64,
    /// True: ignore `seed` and keep the current seed.
    pub keep_seed: bool,
}

/// What a server of [`Reset`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetResponse {
    /// Whether the history is forgotten.
    pub success: bool,
    /// What was forgotten or, if not successful, the reason.
    pub message: String,
}

service!(
    Reset,
    "wm_msgs",
    include_str!("../../srv/Reset.srv"),
    ResetRequest,
    ResetResponse,
    []
);
service!(
    EnvReset,
    "wm_msgs",
    include_str!("../../srv/EnvReset.srv"),
    EnvResetRequest,
    EnvResetResponse,
    [Duration, Time]
);
service!(
    EnvStep,
    "wm_msgs",
    include_str!("../../srv/EnvStep.srv"),
    EnvStepRequest,
    EnvStepResponse,
    [Action, Time, Timing]
);
message!(
    LatentSpace,
    "wm_msgs",
    include_str!("../../msg/LatentSpace.msg"),
    []
);
message!(
    Latent,
    "wm_msgs",
    include_str!("../../msg/Latent.msg"),
    [Header, LatentSpace]
);
message!(
    Action,
    "wm_msgs",
    include_str!("../../msg/Action.msg"),
    [Header]
);
message!(
    ActionChunk,
    "wm_msgs",
    include_str!("../../msg/ActionChunk.msg"),
    [Header, Duration, Action, Timing]
);
message!(
    EnvObservation,
    "wm_msgs",
    include_str!("../../msg/EnvObservation.msg"),
    [CompressedImage]
);
message!(
    ExecutorStatus,
    "wm_msgs",
    include_str!("../../msg/ExecutorStatus.msg"),
    [Header, Time]
);
message!(
    CameraState,
    "wm_msgs",
    include_str!("../../msg/CameraState.msg"),
    [Header, Duration]
);
message!(
    Timing,
    "wm_msgs",
    include_str!("../../msg/Timing.msg"),
    [Time]
);
message!(
    ActionCandidates,
    "wm_msgs",
    include_str!("../../msg/ActionCandidates.msg"),
    [Header, ActionChunk]
);
message!(
    CandidateAssessment,
    "wm_msgs",
    include_str!("../../msg/CandidateAssessment.msg"),
    [Latent]
);
message!(
    Assessment,
    "wm_msgs",
    include_str!("../../msg/Assessment.msg"),
    [Header, Time, Duration, CandidateAssessment, Timing]
);
message!(
    Prediction,
    "wm_msgs",
    include_str!("../../msg/Prediction.msg"),
    [Header, Time, Duration, Latent, Action]
);
message!(
    PredictionError,
    "wm_msgs",
    include_str!("../../msg/PredictionError.msg"),
    [Header, Time]
);
message!(
    Goal,
    "wm_msgs",
    include_str!("../../msg/Goal.msg"),
    [Header, Image, Latent, Duration]
);
message!(
    Plan,
    "wm_msgs",
    include_str!("../../msg/Plan.msg"),
    [Header, Action, Duration, Time]
);
