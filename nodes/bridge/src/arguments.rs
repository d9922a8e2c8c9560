//! The command line.

use crate::settings::{Options, Section, Settings, SettingsError};
use anyhow::{Context as _, Result};
use clap::Parser;
use serde_json::Value;
use wm_ros::zenoh::NetworkArguments;
use wm_ros::{ArgsError, NodeArgs};

/// Carry topics and services between DDS and a Zenoh network, as zenoh-bridge-ros2dds does
#[derive(Debug, Parser)]
#[command(name = "wm bridge", version)]
#[command(
    after_help = "Takes ROS arguments too: --interface eth0 --ros-args -r __ns:=/x --log-level LEVEL; the domain is \
    ROS_DOMAIN_ID.\nExit codes: 0 done, 1 failed, 2 wrong usage."
)]
struct Cli {
    #[command(flatten)]
    network: NetworkArguments,
    /// Namespace of this side's names on Zenoh: with /robot1, /wm/plan is robot1/wm/plan there [default: /]
    #[arg(short, long, value_name = "NAMESPACE")]
    namespace: Option<String>,
    /// Carry only topics and services whose whole name matches (repeatable) [default: all]
    #[arg(short, long, value_name = "REGEX")]
    allow: Vec<String>,
    /// Do not carry topics and services whose whole name matches (repeatable)
    #[arg(short, long, value_name = "REGEX")]
    deny: Vec<String>,
    /// Send matching topics at most at this rate (repeatable); latched topics are not rate-limited
    #[arg(long, value_name = "REGEX=HZ")]
    max_frequency: Vec<String>,
    /// Send matching topics with this Zenoh priority, 1 (real time) to 7 (background) (repeatable) [default: 5]
    #[arg(long, value_name = "REGEX=PRIORITY[:express]")]
    priority: Vec<String>,
    /// Timeout for an answer from the other side [s, default: 5]
    #[arg(long, value_name = "SECONDS")]
    queries_timeout: Option<f32>,
}

pub(crate) struct Arguments {
    pub config: zenoh::Config,
    pub settings: Settings,
    pub node: NodeArgs,
}

/// Parses the command line. Prints help or an error on wrong usage, and ends the process.
///
/// # Errors
/// The ROS arguments or the configuration file are invalid.
pub(crate) fn parse() -> Result<Arguments> {
    let node = NodeArgs::parse(std::env::args().skip(1))?;
    let words = std::iter::once("wm bridge").chain(node.rest().iter().map(String::as_str));
    let cli = Cli::parse_from(words);
    let config = cli.network.resolve()?;
    let section = section(&config)?;
    let options = Options {
        namespace: cli.namespace,
        allow: cli.allow,
        deny: cli.deny,
        max_frequencies: cli.max_frequency,
        priorities: cli.priority,
        queries_timeout: cli.queries_timeout,
    };
    Ok(Arguments {
        config,
        settings: Settings::new(section, options)?,
        node,
    })
}

/// The bridge's section of the configuration file.
fn section(config: &zenoh::Config) -> Result<Section> {
    match serde_json::to_value(config)?.pointer("/plugins/ros2dds") {
        None | Some(Value::Null) => Ok(Section::default()),
        Some(section) => serde_json::from_value(section.clone())
            .context("plugins/ros2dds in the configuration file"),
    }
}

/// Whether the user's input is at fault.
pub(crate) fn is_usage(error: &anyhow::Error) -> bool {
    error.is::<ArgsError>()
        || error.is::<SettingsError>()
        || error.downcast_ref().is_some_and(wm_ros::Error::is_usage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn configuration_section_is_found_and_errors_name_it() {
        let config = |text: &str| zenoh::Config::from_json5(text).unwrap();
        let sound = config(r#"{ plugins: { ros2dds: { namespace: "/robot1" } } }"#);
        let settings = Settings::new(section(&sound).unwrap(), Options::default()).unwrap();
        assert_eq!(settings.namespace, "/robot1".parse().unwrap());
        assert!(section(&config("{}")).is_ok());
        let wrong = config("{ plugins: { ros2dds: { topics: [] } } }");
        let error = format!("{:#}", section(&wrong).unwrap_err());
        assert!(
            error.contains("plugins/ros2dds") && error.contains("topics"),
            "{error}"
        );
    }
}
