//! Actions as motion over time.
//!
//! [`actions`] describes the values of an action: the description that a model, a bag and a robot share, and how a
//! model takes them. [`motion`] computes what a robot does in an interval, whatever the rate of its actions.
//!
//! Pure functions of numbers: no tensors, no ROS, no clock. Nodes, training and imports use the same code.

pub mod actions;
pub mod motion;
