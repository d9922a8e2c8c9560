//! `wm-bridge`: carries topics and services between the nodes of a DDS domain and a Zenoh network, in the format of
//! zenoh-bridge-ros2dds, so that either end may be that program.
//!
//! - A topic that nodes of this side publish is published on Zenoh while it has subscribers there. A topic that they
//!   subscribe to is subscribed to on Zenoh. Payloads are the unchanged CDR bytes.
//! - A service of this side is a queryable on Zenoh. A service that another bridge announces is served here.
//! - Latched topics are kept, on both sides, for late joiners.
//! - The bridge does not carry back what it brought in. Of two bridges that connect the same domain to the same Zenoh
//!   network, one is the standby.
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
