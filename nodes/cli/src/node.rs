//! The nodes as commands.

use crate::output::print;
use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Command, FromArgMatches, Subcommand, error::ErrorKind};
use std::process::ExitCode;
use wm_ros::{Component, NodeArgs, NodeDefinition};

pub(crate) type Definition = NodeDefinition<anyhow::Error>;

/// All nodes, in the order of the help.
pub(crate) fn definitions() -> impl Iterator<Item = &'static Definition> {
    wm_model_nodes::NODES
        .iter()
        .chain(wm_robot_nodes::NODES)
        .chain(wm_view::NODES)
}

/// The nodes without a command of their own with flags.
fn plain() -> impl Iterator<Item = &'static Definition> {
    definitions().filter(|definition| definition.name != wm_view::NODE.name)
}

pub(crate) fn definition(name: &str) -> Option<&'static Definition> {
    definitions().find(|definition| definition.name == name)
}

pub(crate) fn is_node(name: &str) -> bool {
    definition(name).is_some()
}

/// Several nodes in one process.
pub(crate) const TOGETHER: &str = "run";
const LIST: &str = "nodes";

const ARGUMENTS: &str = "arguments";
const PRINT_PARAMS: &str = "print-params";
const TOPICS: &str = "topics";

/// Runs nodes, or lists them.
#[derive(Clone)]
pub(crate) enum NodeCommand {
    /// Runs one node, with the arguments before `--ros-args`.
    One(&'static Definition, Vec<String>),
    /// Runs several in one process.
    Together(Vec<String>),
    /// Prints a node's parameter file.
    PrintParams(&'static Definition),
    /// Lists the nodes, or their topics and services.
    List {
        /// As a Markdown table.
        topics: bool,
    },
}

impl std::fmt::Debug for NodeCommand {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::One(node, arguments) => write!(f, "{} {}", node.name, arguments.join(" ")),
            Self::Together(arguments) => write!(f, "{TOGETHER} {}", arguments.join(" ")),
            Self::PrintParams(node) => write!(f, "{} --{PRINT_PARAMS}", node.name),
            Self::List { topics } => write!(f, "{LIST} {topics}"),
        }
    }
}

/// The arguments before `--ros-args`.
fn arguments(help: &'static str) -> Arg {
    Arg::new(ARGUMENTS)
        .help(help)
        .num_args(0..)
        .trailing_var_arg(true)
        .allow_hyphen_values(true)
}

fn command(definition: &Definition) -> Command {
    let print_params = Arg::new(PRINT_PARAMS)
        .long(PRINT_PARAMS)
        .help("Print an annotated parameter file with the defaults, and exit")
        .action(ArgAction::SetTrue);
    Command::new(definition.name)
        .about(format!("{} (node)", definition.about.trim_end_matches('.')))
        .arg(print_params)
        .arg(arguments(
            "Arguments of the node: --interface NAME, --middleware dds|zenoh; parameters go after --ros-args",
        ))
        .after_help(definition.help())
}

/// The nodes that can share a process.
fn composable() -> String {
    let nodes = definitions().filter(|definition| !definition.runs_alone);
    nodes
        .map(|definition| definition.name)
        .collect::<Vec<_>>()
        .join(", ")
}

impl Subcommand for NodeCommand {
    fn augment_subcommands(mut parent: Command) -> Command {
        for definition in plain() {
            parent = parent.subcommand(command(definition));
        }
        let together = Command::new(TOGETHER)
            .about("Run several nodes in one process, which exchange messages in memory")
            .arg(arguments("Names of the nodes, --interface and --middleware").required(true))
            .after_help(format!("Nodes: {}", composable()));
        let topics = Arg::new(TOPICS)
            .long(TOPICS)
            .help("List topics and services of the nodes, with types and QoS, as a Markdown table")
            .action(ArgAction::SetTrue);
        let list = Command::new(LIST).about("List the nodes").arg(topics);
        parent.subcommand(together).subcommand(list)
    }

    fn augment_subcommands_for_update(parent: Command) -> Command {
        Self::augment_subcommands(parent)
    }

    fn has_subcommand(name: &str) -> bool {
        name == TOGETHER || name == LIST || plain().any(|definition| definition.name == name)
    }
}

impl FromArgMatches for NodeCommand {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let missing = || clap::Error::new(ErrorKind::MissingSubcommand);
        let (name, own) = matches.subcommand().ok_or_else(missing)?;
        let words = || {
            let words = own.get_many::<String>(ARGUMENTS).into_iter().flatten();
            words.cloned().collect()
        };
        match name {
            TOGETHER => Ok(Self::Together(words())),
            LIST => Ok(Self::List {
                topics: own.get_flag(TOPICS),
            }),
            name => {
                let node = definition(name).ok_or_else(missing)?;
                Ok(match own.get_flag(PRINT_PARAMS) {
                    true => Self::PrintParams(node),
                    false => Self::One(node, words()),
                })
            }
        }
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The node of this name, for a process with others; ends the process if there is none.
fn component(name: &str) -> Component<anyhow::Error> {
    definition(name)
        .and_then(Definition::component)
        .unwrap_or_else(|| {
            let message = format!(
                "`{name}` cannot run in one process with others; these can: {}\n",
                composable()
            );
            clap::Error::raw(ErrorKind::InvalidValue, message).exit()
        })
}

fn run_together(args: &NodeArgs) -> Result<()> {
    let components = args.rest().iter().map(|name| component(name)).collect();
    wm_ros::run_together(wm_ros::NAMESPACE, args, components)
}

fn list() -> String {
    // the program has nodes
    let width = definitions().map(|node| node.name.len()).max().unwrap_or(0);
    let line = |node: &Definition| format!("{:width$} {}\n", node.name, node.about);
    definitions().map(line).collect()
}

fn table() -> String {
    let head = "| node | | name | type | QoS | |\n|---|---|---|---|---|---|\n";
    let rows = definitions().map(Definition::table_rows);
    std::iter::once(head.to_owned()).chain(rows).collect()
}

impl NodeCommand {
    /// Whether `--ros-args` may follow.
    pub(crate) fn takes_ros_args(&self) -> bool {
        matches!(self, Self::One(..) | Self::Together(_))
    }

    /// Runs the node until a signal or its end.
    pub(crate) fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let args = |own: Vec<String>| NodeArgs::parse(own.into_iter().chain(ros_args));
        match self {
            Self::One(node, own) => return (node.run)(&args(own)?),
            Self::Together(own) => run_together(&args(own)?)?,
            Self::PrintParams(node) => print(node.params_file())?,
            Self::List { topics: true } => print(table())?,
            Self::List { topics: false } => print(list())?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_ros::Direction;

    /// The committed files must match the nodes.
    #[test]
    fn committed_parameter_files_match_the_nodes() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch-configs/config");
        for node in definitions() {
            let path = format!("{folder}/{}.yaml", node.name);
            let committed = std::fs::read_to_string(&path).unwrap_or_default();
            assert_eq!(
                committed,
                node.params_file(),
                "{path}: write it anew with `wm {} --print-params`",
                node.name
            );
        }
    }

    #[test]
    fn every_node_has_a_description() {
        for node in definitions() {
            let help = node.help();
            for spec in (node.parameters)() {
                let text = spec.descriptor.description;
                assert!(
                    text.starts_with(|first: char| first.is_uppercase()) && text.ends_with('.'),
                    "{}: {text}",
                    node.name
                );
                assert!(help.contains(&format!("\n  {}  ", spec.name)), "{help}");
            }
            for spec in (node.endpoints)() {
                let is_topic =
                    matches!(spec.direction, Direction::Subscribed | Direction::Published);
                assert_eq!(spec.qos.is_some(), is_topic);
                assert!(
                    help.contains(&format!("  {}  {}", spec.name, spec.type_name)),
                    "{help}"
                );
            }
            assert!(node.about.ends_with('.'), "{}", node.about);
        }
    }
}
