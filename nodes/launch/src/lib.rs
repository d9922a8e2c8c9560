//! `wm launch`: starts the nodes of a launch file as processes, passes their parameters, shows their logs on one
//! screen, and stops them together.
//!
//! Launch files use ROS 2's YAML launch format, so `ros2 launch` reads them too. Known actions: `arg`, `let`,
//! `set_env`, `unset_env`, `push_ros_namespace`, `group`, `include`, `node`, `executable`, each with `if` and `unless`.
//! Known substitutions: `var`, `env`, `dirname`, `filename`, `find-pkg-share`, `find-pkg-prefix`, `equals`,
//! `not-equals`, `not`, `and`, `or`. Anything else is an error that names it. A `node` of the package `wm_nodes` runs
//! this program; `AMENT_PREFIX_PATH` contains other packages. Relative paths start at the working directory, as for
//! `ros2 launch`; `$(dirname)` is the launch file's folder.
//!
//! The modules are layers, of which only the last starts processes: `substitution` and `file` read, `plan` resolves into
//! complete command lines, `missing_router` finds the Zenoh router that they lack, `supervisor` decides when to start and
//! stop, `console` formats lines, `runner` executes.
//!
//! Not here: event handlers, timers, lifecycle and composable nodes of ROS 2's launch.

mod console;
mod entity;
mod error;
mod file;
mod missing_router;
mod plan;
mod runner;
mod substitution;
mod supervisor;

pub use error::LaunchError;
pub use missing_router::missing_router;
pub use plan::{Plan, Process, Program, Surroundings, System};
pub use runner::run;

pub use file::LaunchFile;
use std::fmt::Write as _;
use std::path::Path;

/// Reads a launch file.
///
/// # Errors
/// It cannot be read, or is not a launch file.
pub fn read(path: &Path, surroundings: &dyn Surroundings) -> Result<LaunchFile, LaunchError> {
    let text = surroundings
        .read(path)
        .map_err(|source| LaunchError::Read {
            file: path.to_owned(),
            source,
        })?;
    LaunchFile::parse(path, &text)
}

/// The arguments of a launch file as `ros2 launch --show-args` prints them.
#[must_use]
pub fn describe_arguments(file: &LaunchFile) -> String {
    let arguments = file.arguments();
    if arguments.is_empty() {
        return "No arguments.\n".to_owned();
    }
    let mut text = "Arguments (pass arguments as '<name>:=<value>'):\n".to_owned();
    for argument in arguments {
        let description = argument
            .description
            .as_deref()
            .unwrap_or("no description given");
        let choices = if argument.choices.is_empty() {
            String::new()
        } else {
            format!(" Valid choices are: {}", argument.choices.join(", "))
        };
        let default = match &argument.default_text {
            Some(default) => format!("        (default: '{default}')\n"),
            None => String::new(),
        };
        // writing to a String cannot fail
        write!(
            text,
            "\n    '{}':\n        {description}{choices}\n{default}",
            argument.name
        )
        .ok();
    }
    text
}
