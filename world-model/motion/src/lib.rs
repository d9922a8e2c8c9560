//! Actions as motion over time.
//!
//! [`actions`] says what the values of an action are: the description that a model, a bag and a robot share, and how a
//! model takes it. [`motion`] says what a robot does in an interval, whatever the rate at which its actions come.
//!
//! Pure functions of numbers: no tensors, no ROS, no clock. Nodes, training and imports use the same code.

pub mod actions;
pub mod motion;
