//! One participant here and others in processes, clocks and networks of their own: peers that stop, strangers on the
//! network, newcomers, real ROS 2 clients, a clock that is set back.

mod announcement;
mod answers;
mod clock;
mod harness;
mod hosts;
mod laggards;
mod network;
mod newcomers;
mod strangers;
