//! Package `wm_msgs`: latents, actions, predicted steps, their errors, and plans.

use super::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
};
use serde::{Deserialize, Serialize};

/// Identity of a latent space. Two latents may be compared, or fed to one model, only where both fields agree.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatentSpace {
    /// Encoder and adapter in words, for example `tiny` or `web-dino+svae`.
    pub name: String,
    /// Lower-case hex SHA-256 over what defines the space: encoder, adapter, weights, normalisation.
    pub hash: String,
}

/// The latent grid of one camera frame, normalised per channel (mean 0, standard deviation 1 over the training data).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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

/// One action of the robot, in physical units.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// `stamp`: when the action was taken; `frame_id`: the frame of the deltas (the robot's base).
    pub header: Header,
    /// Bridge V2: dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0 closed .. 1 open\].
    pub values: Vec<f32>,
}

/// The actions that are to come, from a policy, a planner or a bag.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActionChunk {
    /// `stamp`: when the first action is (to be) taken; `frame_id`: the frame of the deltas.
    pub header: Header,
    /// Time from one action to the next.
    pub period: Duration,
    /// In order; each header's stamp is the chunk's stamp + index x `period`.
    pub actions: Vec<Action>,
}

/// One predicted step. A rollout is `horizon` messages of the same `observed_stamp`, sent as each is ready.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// `stamp`: the time that is predicted; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// Capture time of the last observed frame.
    pub observed_stamp: Time,
    /// k: how many model steps after the observation, from 1.
    pub step: u32,
    /// K: steps of this rollout.
    pub horizon: u32,
    /// Time of one model step.
    pub step_period: Duration,
    /// The predicted latent; its header equals this message's.
    pub latent: Latent,
    /// What it was conditioned on, from the observation up to step k.
    pub actions: Vec<Action>,
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

/// How a prediction compares with what the encoder saw when the predicted moment came.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictionError {
    /// `stamp`: the predicted moment; `frame_id`: the camera's optical frame.
    pub header: Header,
    /// The observation that the prediction started from.
    pub observed_stamp: Time,
    /// k: how many model steps after the observation.
    pub step: u32,
    /// Mean squared error of the predicted latent \[normalised latent units^2\].
    pub mse: f32,
    /// The same error of the last observed latent, held still.
    pub persistence_mse: f32,
    /// `mse` / `persistence_mse`; below 1 the model beats standing still; NaN where both are 0.
    pub ratio: f32,
}

/// Actions that the planner found to bring the camera's latent to the goal's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// `stamp`: capture time of the frame that the plan starts from.
    pub header: Header,
    /// The planned actions, clamped to the bounds; stamp + index x `period`.
    pub actions: Vec<Action>,
    /// Time of one planned action (one model step).
    pub period: Duration,
    /// Mean squared latent error to the goal of the planned actions.
    pub cost: f32,
    /// The best cost after each iteration.
    pub iteration_costs: Vec<f32>,
    /// For example `cem`.
    pub planner: String,
    /// The planner's settings as JSON.
    pub settings: String,
    /// Seed of its candidates and of its noise.
    pub seed: u64,
    /// Stamp of the goal image that was planned for.
    pub goal_stamp: Time,
    /// Planning time (wall time).
    pub time_taken: Duration,
    /// True where the deadline ended the search before its last iteration.
    pub deadline_cut: bool,
}

/// Service: forget the observed history and any plan.
#[derive(Clone, Copy, Debug)]
pub struct Reset;

/// What a client of [`Reset`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetRequest {
    /// Seed of the coming samples.
    pub seed: u64,
    /// True: ignore `seed` and go on with the present one.
    pub keep_seed: bool,
}

/// What a server of [`Reset`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetResponse {
    /// Whether the history is forgotten.
    pub success: bool,
    /// What was forgotten, or why not.
    pub message: String,
}

impl crate::Service for Reset {
    const PACKAGE: &'static str = "wm_msgs";
    const NAME: &'static str = "Reset";
    type Request = ResetRequest;
    type Response = ResetResponse;
}

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
    [Header, Duration, Action]
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
    Plan,
    "wm_msgs",
    include_str!("../../msg/Plan.msg"),
    [Header, Action, Duration, Time]
);
