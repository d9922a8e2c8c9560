//! Audits robot data: recordings, data sets and live topics.
//!
//! Input is a stream of observations: times of messages, fingerprint and
//! [`Signature`](wm_camera::signature::Signature) of pictures, actions and state. Output is a list of [`Finding`]s: verdict,
//! measured figures, reason and remedy, as text and JSON.
//!
//! | item | checks |
//! | --- | --- |
//! | [`Clocks`] | stamps that are zero, constant, out of order, or of another clock |
//! | [`Pictures`] | repeated and frozen frames with the true rate, missing frames, sizes that change |
//! | [`Audit::of_episodes`] | lag between pictures, actions and state; changes of the state compared with actions; idle time, outliers, units, the last action |
//! | [`audit_bag`] | all checks for one bag, for `wm bag info --audit` |
//!
//! Users: `wm dataset` (`wm_dataset`) during preparation, `wm bag info --audit`, and `wm doctor` (`wm_doctor`) on live
//! messages. No DDS, no clock, no model. Memory is bounded: a few numbers per picture, about 2 MB for an hour at 30 Hz.
//!
//! Thresholds are constants next to their checks, measured on real data without a fault (Bridge V2, DROID, a Dobot CR5, a
//! Unitree G1: 32,000 frames) and with each fault; `learning/import/tests/audit_shared_data.rs` repeats this.

mod audit;
mod bag;
mod behaviour;
mod clocks;
mod correlation;
mod effect;
mod episode;
mod finding;
mod gaps;
mod lag;
mod pictures;
mod quantile;
mod recorded;
mod state;

pub use audit::{Audit, BagFindings};
pub use bag::{JUDGES_VIDEO, Topics, audit_bag, video_topics};
pub use clocks::{Clocks, Stamps, UnusableStamps};
pub use episode::{Episode, Episodes};
pub use finding::{Finding, Level};

pub use pictures::{Activity, Pictures};
pub use recorded::{ActionTrack, RecordedCamera, RecordedTopics};
pub use state::{JOINTS_TOPIC, POSE_TOPICS, StateLog, StatePath};
