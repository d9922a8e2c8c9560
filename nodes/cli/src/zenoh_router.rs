//! `wm zenoh-router`: the Zenoh router of a host, as rmw_zenohd is. The feature `zenoh` builds it in.

#[cfg(feature = "zenoh")]
mod configuration;
#[cfg(feature = "zenoh")]
mod occupant;
#[cfg(feature = "zenoh")]
mod serving;

use anyhow::Result;
use clap::Args;
use std::process::ExitCode;

/// Runs a router.
#[derive(Args, Debug, Default)]
#[command(
    after_help = "Programs with the middleware rmw_zenoh_cpp, the nodes of wm included, find each other through the router of their\n\
    host. Run one per host, in place of `ros2 run rmw_zenoh_cpp rmw_zenohd`; `wm launch` starts one if none runs.\n\n\
    Its settings are those of rmw_zenohd, except that it accepts programs of this host only.\n\
    Hosts reach each other by their routers: --listen tcp/[::]:7447 on one host, --connect tcp/HOST:7447 on the others.\n\
    Programs that reach an open router can send actions: use TLS and access control on networks that you do not trust.\n\n\
    ZENOH_ROUTER_CONFIG_URI: path of a configuration file (JSON5) in place of these settings.\n\
    ZENOH_CONFIG_OVERRIDE: single settings, 'key=value;key=value' with JSON5 values. Options take precedence.\n\n\
    Exit codes: 0 ended by SIGINT or SIGTERM, 1 failed, 2 wrong usage."
)]
#[cfg_attr(
    not(feature = "zenoh"),
    allow(
        dead_code,
        reason = "help and completions have the options in any case"
    )
)]
pub(crate) struct ZenohRouterCommand {
    /// Connect to another host's router, for example tcp/robot.local:7447 (repeatable)
    #[arg(short = 'e', long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Let programs connect here, for example tcp/0.0.0.0:7447 for every network (repeatable) [default: tcp/127.0.0.1:7447]
    #[arg(short, long, value_name = "ENDPOINT")]
    listen: Vec<String>,
    /// Log level: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
}

impl ZenohRouterCommand {
    /// Runs the router until SIGINT or SIGTERM.
    #[cfg(feature = "zenoh")]
    pub(crate) fn run(self) -> Result<ExitCode> {
        let level = self.log_level.iter();
        let words = level.flat_map(|level| ["--ros-args", "--log-level", level]);
        wm_ros::logging::init(&wm_ros::NodeArgs::parse(words)?);
        serving::serve(configuration::resolve(&self)?)
    }

    #[cfg(not(feature = "zenoh"))]
    pub(crate) fn run(self) -> Result<ExitCode> {
        anyhow::bail!(
            "this wm is built without Zenoh; in the repository of wm,\n    cargo build --release -p wm_cli --features zenoh"
        )
    }
}
