//! `wm completions`.

use crate::{
    external::{self, Described},
    output::print,
};
use anyhow::Result;
use clap::{Args, ValueEnum};
use clap_complete::{Shell, generate};

/// Shells with completion scripts.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum ShellName {
    Bash,
    Zsh,
    Fish,
}

/// Prints a completion script.
#[derive(Args, Debug)]
#[command(after_help = "To install it:\n  \
    wm completions bash > ~/.local/share/bash-completion/completions/wm\n  \
    wm completions zsh > ~/.zfunc/_wm          # with fpath+=~/.zfunc before compinit in ~/.zshrc\n  \
    wm completions fish > ~/.config/fish/completions/wm.fish")]
pub(crate) struct CompletionsCommand {
    /// The shell
    #[arg(value_enum)]
    shell: ShellName,
}

impl CompletionsCommand {
    pub(crate) fn run(self, wm: clap::Command) -> Result<()> {
        let Described { command, left_out } = external::described(wm)?;
        for left in left_out {
            eprintln!("wm: without its commands: {left}; run this again then");
        }
        print(self.script(command))
    }

    fn script(&self, mut command: clap::Command) -> String {
        let shell = match self.shell {
            ShellName::Bash => Shell::Bash,
            ShellName::Zsh => Shell::Zsh,
            ShellName::Fish => Shell::Fish,
        };
        let mut script = Vec::new();
        generate(shell, &mut command, "wm", &mut script);
        String::from_utf8_lossy(&script).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::process::{Command, Stdio};

    fn script(shell: ShellName) -> String {
        CompletionsCommand { shell }.script(crate::cli::definition())
    }

    /// The completions of bash for `wm WORDS` with the cursor at its end.
    fn offered(words: &[&str]) -> Vec<String> {
        let line = words.iter().map(|word| format!("'{word}'"));
        let line = line.collect::<Vec<_>>().join(" ");
        let test = format!(
            "{}\nCOMP_WORDS=(wm {line}); COMP_CWORD={}; _wm wm \"${{COMP_WORDS[COMP_CWORD]}}\" \
             \"${{COMP_WORDS[COMP_CWORD-1]}}\"; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
            script(ShellName::Bash),
            words.len()
        );
        let mut bash = Command::new("bash")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        bash.stdin
            .take()
            .unwrap()
            .write_all(test.as_bytes())
            .unwrap();
        let output = bash.wait_with_output().unwrap();
        assert!(output.status.success());
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().map(str::to_owned).collect()
    }

    #[test]
    fn bash_completes_commands_nodes_and_flags() {
        assert_eq!(offered(&["doc"]), ["doctor"]);
        assert_eq!(offered(&["enco"]), ["encoder"]);
        assert_eq!(offered(&["bag", "rec"]), ["record", "recover"]);
        assert!(offered(&["doctor", "--"]).contains(&"--camera".to_owned()));
        assert!(offered(&["completions", ""]).contains(&"fish".to_owned()));
    }

    #[test]
    fn every_shell_has_every_node() {
        for shell in [ShellName::Bash, ShellName::Zsh, ShellName::Fish] {
            let script = script(shell);
            for node in crate::node::definitions() {
                assert!(script.contains(node.name), "{shell:?}: {}", node.name);
            }
        }
    }
}
