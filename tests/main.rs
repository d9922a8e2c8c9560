//! Tests of whole processes: the suite as a user runs it, and a real ROS 2 as its peer.

mod harness;
mod interop;
mod replay;
