//! Actions as motion over time.
//!
//! | type | purpose |
//! |---|---|
//! | [`actions::ActionSpace`] | names, units and kinds of an action's values, as a model, a bag and a robot share them |
//! | [`motion::Motion`] | executed actions and announced chunks -> the motion in an interval, at any action rate |
//! | [`actions::ActionEncoding`] | the motion of one model step <-> the vector that conditions the transition model |
//! | [`motion::Pace`] | the frames of a fast camera that are one model interval apart |
//! | [`joints::JointActions`] | states of joints -> actions |
//! | [`actions::ActionSurvey`] | the ranges of recorded actions, checked against their kinds and units |
//!
//! ```
//! use wm_motion::{actions::{ActionEncoding, ActionSpace}, motion::{Motion, MotionSettings}};
//!
//! let space = ActionSpace::bridge();
//! let mut motion = Motion::new(MotionSettings::of_period(33_333_333));
//! for tick in 0..13_i64 {
//!     // 1 mm along x, thirty times a second, with an open gripper.
//!     motion.take(tick * 33_333_333, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].into());
//! }
//! let interval = motion.between(&space, 0, 200_000_000).expect("actions start at 0");
//! assert!((interval.values[0] - 0.006).abs() < 1e-6);
//!
//! // A model step of two intervals of 0.2 s; 35 model units are one metre.
//! let step = motion.step(&ActionEncoding::default(), 0, 400_000_000)?;
//! assert!((step.model.values[0] - 0.006 * 35.0).abs() < 1e-4);
//! # Ok::<(), wm_motion::actions::ActionError>(())
//! ```
//!
//! Pure functions of numbers, without tensors, ROS or a clock. Stamps are nanoseconds of the clock that stamped frames
//! and actions.

pub mod actions;
pub mod joints;
pub mod motion;
