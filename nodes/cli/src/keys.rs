//! `wm keys`: a test authority, certificates and access rules for a Zenoh network with TLS.
//!
//! **One router enforces.** Every session is a client of the router, so every message passes it, and its rules apply
//! whatever a session's own configuration says. Peers on one host would exchange messages directly; then only the
//! sender's and the receiver's own files could limit them, and a dishonest sender changes its file. The price is one
//! more hop for each message.
//!
//! Each file is complete: certificate and key are inside, so one file is copied to a host, and one variable names it.

#[cfg(feature = "zenoh")]
mod access;
#[cfg(feature = "zenoh")]
mod authority;
#[cfg(feature = "zenoh")]
mod configuration;
#[cfg(feature = "zenoh")]
mod folder;
#[cfg(feature = "zenoh")]
mod grant;
#[cfg(feature = "zenoh")]
mod identity;
#[cfg(feature = "zenoh")]
mod making;
#[cfg(feature = "zenoh")]
mod sessions;
#[cfg(feature = "zenoh")]
mod suite;

#[cfg(not(feature = "zenoh"))]
mod not_built;

#[cfg(not(feature = "zenoh"))]
pub(crate) use not_built::assign;
#[cfg(feature = "zenoh")]
pub(crate) use sessions::assign;

use crate::launch_argument;
use clap::Args;
use std::path::PathBuf;

/// The highest `ROS_DOMAIN_ID`.
const MAX_DOMAIN: u16 = 232;

/// Makes keys, certificates and access rules.
#[derive(Args, Debug)]
#[cfg_attr(
    not(feature = "zenoh"),
    allow(dead_code, reason = "only the help is used")
)]
#[command(
    after_help = "A NAME=GRANTS is for example /camera/driver=publish:/camera/**,subscribe:/clock. Grants: publish, \
    subscribe (topics), serve, call (services), perform, send (goals of actions), each with :NAME; read (every topic, \
    and services that only report); all. In names, * stands for one part and ** for any.\n\
    Remapping rules of the nodes go after --ros-args, unless --launch is given.\n\
    Start the router:  ZENOH_ROUTER_CONFIG_URI=DIR/router.json5 wm zenoh-router\n\
    Start a node:      ZENOH_SESSION_CONFIG_URI=DIR/wm.encoder.json5 wm encoder --middleware zenoh\n\
    Start all:         wm launch FILE --keys DIR"
)]
pub(crate) struct KeysCommand {
    /// Folder for the files; it is made, and existing files are not overwritten
    directory: PathBuf,
    /// Make certificates for the processes of this launch file, with its remapping rules
    #[arg(long, value_name = "FILE")]
    launch: Option<PathBuf>,
    /// Launch argument (repeatable)
    #[arg(long = "launch-argument", value_name = "NAME:=VALUE", value_parser = launch_argument::parse, requires = "launch")]
    launch_arguments: Vec<(String, String)>,
    /// Make certificates for these nodes only [default: each node of wm]
    #[arg(
        long,
        value_name = "NODE,NODE",
        value_delimiter = ',',
        conflicts_with = "launch"
    )]
    only: Vec<String>,
    /// Make one certificate for `wm run NODE NODE ...` (repeatable)
    #[arg(long, value_name = "NODE,NODE")]
    together: Vec<String>,
    /// Make a certificate for a node of another package, or grant more to one of wm (repeatable)
    #[arg(long, value_name = "NAME=GRANTS")]
    node: Vec<String>,
    /// Make a certificate for tools, whose nodes have any name: `ros2 topic echo`, RViz (repeatable)
    #[arg(long, value_name = "NAME=GRANTS")]
    tool: Vec<String>,
    /// Name or address of the router's host, for nodes on other hosts (repeatable) [default: this host only]
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
    /// Port of the router
    #[arg(long, default_value_t = 7447)]
    port: u16,
    /// Days until the certificates expire
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u16).range(1..=36500))]
    days: u16,
    /// ROS domain [default: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_parser = clap::value_parser!(u16).range(0..=i64::from(MAX_DOMAIN)))]
    domain: Option<u16>,
    /// Namespace of the nodes
    #[arg(long, default_value = wm_ros::NAMESPACE)]
    namespace: String,
    /// Folder of an earlier `wm keys`, whose authority signs: its certificates stay valid
    #[arg(long, value_name = "DIR")]
    authority: Option<PathBuf>,
}
