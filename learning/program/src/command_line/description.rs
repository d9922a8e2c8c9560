use clap::Command;
use serde::{Deserialize, Serialize};

use crate::command_line::argument::Argument;

/// The description of a command.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Description {
    name: String,
    aliases: Vec<String>,
    about: Option<String>,
    long_about: Option<String>,
    after_help: Option<String>,
    is_hidden: bool,
    is_command_required: bool,
    arguments: Vec<Argument>,
    commands: Vec<Description>,
}

impl Description {
    pub(crate) fn of(command: &Command) -> Self {
        let text = |text: Option<&clap::builder::StyledStr>| text.map(ToString::to_string);
        Self {
            name: command.get_name().to_owned(),
            aliases: command.get_visible_aliases().map(str::to_owned).collect(),
            about: text(command.get_about()),
            long_about: text(command.get_long_about()),
            after_help: text(command.get_after_help()),
            is_hidden: command.is_hide_set(),
            is_command_required: command.is_subcommand_required_set(),
            arguments: command.get_arguments().map(Argument::of).collect(),
            commands: command.get_subcommands().map(Self::of).collect(),
        }
    }

    pub(crate) fn into_command(self) -> Command {
        let mut command = Command::new(self.name)
            .visible_aliases(self.aliases)
            .hide(self.is_hidden)
            .subcommand_required(self.is_command_required)
            .args(self.arguments.into_iter().map(Argument::into_arg))
            .subcommands(self.commands.into_iter().map(Self::into_command));
        if let Some(about) = self.about {
            command = command.about(about);
        }
        if let Some(about) = self.long_about {
            command = command.long_about(about);
        }
        if let Some(help) = self.after_help {
            command = command.after_help(help);
        }
        command
    }
}
