use std::path::PathBuf;

use clap::{Parser, Subcommand, ValueEnum};

use super::*;

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Way {
    /// By hand
    Slow,
    Fast,
}

/// Makes things.
#[derive(Debug, Parser)]
#[command(name = "maker", after_help = "Exit codes: 0 done.")]
enum Maker {
    /// Make a thing
    ///
    /// At length.
    #[command(visible_alias = "build")]
    Make {
        /// What to make it of
        #[arg(long, visible_alias = "from", required = true, num_args = 1.., value_name = "PATH")]
        data: Vec<PathBuf>,
        /// How
        #[arg(short, long, value_enum, default_value = "slow")]
        way: Way,
        /// Tell more
        #[arg(short, action = clap::ArgAction::Count)]
        verbose: u8,
        /// Only say what would be made
        #[arg(long, help_heading = "Trials")]
        dry: bool,
        #[arg(long, hide = true)]
        secret: Option<String>,
        /// Where to put it
        out: PathBuf,
    },
    /// Say things
    #[command(subcommand)]
    Say(Say),
}

#[derive(Debug, Subcommand)]
enum Say {
    /// Say what there is
    All,
}

/// The help of every command is equal, and so are definitions that help does not show.
#[test]
fn description_survives_the_transfer() {
    let own = Maker::command();
    let parsed = parse(serialize(&own).as_bytes()).unwrap();
    assert_eq!(Description::of(&parsed), Description::of(&own));
    parsed.clone().debug_assert();
    for words in [&[][..], &["make"], &["say"], &["say", "all"]] {
        let help = |command: &Command| {
            let mut command = command.clone();
            command.build();
            let mut at = &mut command;
            for word in words {
                at = at.find_subcommand_mut(word).unwrap();
            }
            at.render_long_help().to_string()
        };
        assert_eq!(help(&parsed), help(&own), "{words:?}");
    }
    assert!(parsed.find_subcommand("build").is_some());
}

#[test]
fn program_without_description_is_named() {
    let error = query(Path::new("/no/such/maker")).unwrap_err().to_string();
    assert!(error.starts_with("/no/such/maker: "), "{error}");
    // One fails; the other succeeds with other output.
    for program in ["/bin/false", "/bin/echo"] {
        let error = query(Path::new(program)).unwrap_err();
        assert!(matches!(error, Error::InvalidDescription { .. }), "{error}");
        assert!(error.to_string().starts_with(program), "{error}");
    }
}
