//! `wm-bridge`: carries topics and services between a DDS domain and a Zenoh network, in the format of
//! zenoh-bridge-ros2dds, so that the other end may be that program.
//!
//! - A topic with publishers on this side is published on Zenoh while it has subscribers there. A topic with
//!   subscriptions on this side is subscribed to on Zenoh. Payloads are unchanged CDR bytes.
//! - A service of this side is a queryable on Zenoh. A service that another bridge announces is served here.
//! - Latched topics are kept for late subscribers on both sides.
//! - The bridge does not send back what it received. Of two bridges between the same domain and the same Zenoh network,
//!   one is the standby.
//!
//! Not carried: actions, and samples that are not little-endian CDR.

mod announcement;
mod arguments;
mod bridge;
mod key;
mod limiter;
mod others;
mod plan;
mod request_header;
mod routes;
mod settings;

use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = arguments::parse();
    match arguments.and_then(bridge::run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            wm_ros::logging::last_words(format_args!("wm-bridge: {error:#}"));
            ExitCode::from(if arguments::is_usage(&error) { 2 } else { 1 })
        }
    }
}
