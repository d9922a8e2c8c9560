//! An audit of robot data: of recordings, of the bags of a data set, and of live topics.
//!
//! A pure audit over a stream of observations: the times of each message, the pictures as a fingerprint and a
//! [`Signature`](wm_camera::signature::Signature), the actions and the state. It gives [`Finding`]s: a verdict with the
//! figures that were measured, why it matters, and what to do; as text and as JSON.
//!
//! | module | what |
//! | --- | --- |
//! | [`Clocks`] | stamps that are zero, constant, out of order, or of another clock |
//! | [`Pictures`] | repeated and frozen frames with the true rate, missing frames, sizes that change |
//! | [`Audit::of_episodes`] | lag between pictures, actions and state; actions against the change of the state; idle time, outliers, units, the last action |
//! | [`audit_bag`] | all of it for one bag, for `wm bag info --audit` |
//!
//! Who uses it: `wm dataset` (`wm_dataset`) while it prepares bags, `wm bag info --audit`, and `wm doctor` (`wm_doctor`) on
//! live messages. No DDS, no clock, no model; memory is bounded: of a picture some numbers are kept, of an hour at 30 Hz
//! about 2 MB.
//!
//! Thresholds are constants beside their checks. Each was measured on real data without a fault (Bridge V2, DROID, a Dobot
//! CR5, a Unitree G1: 32,000 frames) and on each fault; `learning/import/tests/audit_shared_data.rs` repeats that.

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
pub use gaps::Gaps;
pub use pictures::{Activity, Pictures};
pub use recorded::{ActionTrack, Recorded, RecordedCamera};
pub use state::{JOINTS_TOPIC, POSE_TOPICS, StateLog, StatePath};
