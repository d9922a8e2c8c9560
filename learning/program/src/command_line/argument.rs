use clap::{
    Arg, ArgAction, ValueHint,
    builder::{PossibleValue, PossibleValuesParser, StyledStr, ValueRange},
};
use serde::{Deserialize, Serialize};

/// The description of an argument.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Argument {
    id: String,
    short: Option<char>,
    long: Option<String>,
    aliases: Vec<String>,
    help: Option<String>,
    long_help: Option<String>,
    heading: Option<String>,
    is_hidden: bool,
    is_required: bool,
    is_last: bool,
    values: ArgumentValues,
}

/// The values of an argument, and whether it may be repeated.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
enum ArgumentValues {
    Nothing {
        is_repeatable: bool,
    },
    Values {
        is_repeatable: bool,
        names: Vec<String>,
        /// Smallest and largest number; `None`: clap's default, one.
        count: Option<(usize, usize)>,
        /// The allowed values; empty for any.
        possible: Vec<Value>,
        defaults: Vec<String>,
        /// A [`ValueHint`] by its name.
        hint: String,
    },
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Value {
    name: String,
    help: Option<String>,
    is_hidden: bool,
}

impl Argument {
    pub(crate) fn of(arg: &Arg) -> Self {
        let text = |text: Option<&StyledStr>| text.map(ToString::to_string);
        Self {
            id: arg.get_id().to_string(),
            short: arg.get_short(),
            long: arg.get_long().map(str::to_owned),
            aliases: arg
                .get_visible_aliases()
                .into_iter()
                .flatten()
                .map(str::to_owned)
                .collect(),
            help: text(arg.get_help()),
            long_help: text(arg.get_long_help()),
            heading: arg.get_help_heading().map(str::to_owned),
            is_hidden: arg.is_hide_set(),
            is_required: arg.is_required_set(),
            is_last: arg.is_last_set(),
            values: ArgumentValues::of(arg),
        }
    }

    pub(crate) fn into_arg(self) -> Arg {
        let arg = Arg::new(self.id)
            .visible_aliases(self.aliases)
            .hide(self.is_hidden)
            .required(self.is_required)
            .last(self.is_last);
        let arg = self.values.add_to(arg);
        let arg = match self.heading {
            Some(heading) => arg.help_heading(heading),
            None => arg,
        };
        let arg = match self.short {
            Some(short) => arg.short(short),
            None => arg,
        };
        let arg = match self.long {
            Some(long) => arg.long(long),
            None => arg,
        };
        let arg = match self.help {
            Some(help) => arg.help(help),
            None => arg,
        };
        match self.long_help {
            Some(help) => arg.long_help(help),
            None => arg,
        }
    }
}

impl ArgumentValues {
    fn of(arg: &Arg) -> Self {
        let is_repeatable = matches!(arg.get_action(), ArgAction::Append | ArgAction::Count);
        if !arg.get_action().takes_values() {
            return Self::Nothing { is_repeatable };
        }
        let strings = |values: &[clap::builder::OsStr]| {
            let values = values.iter();
            values
                .map(|value| value.to_string_lossy().into_owned())
                .collect()
        };
        let names = arg.get_value_names().unwrap_or_default();
        let possible = arg.get_possible_values().into_iter();
        Self::Values {
            is_repeatable,
            names: names.iter().map(ToString::to_string).collect(),
            count: arg
                .get_num_args()
                .map(|range| (range.min_values(), range.max_values())),
            possible: possible
                .map(|value| Value {
                    name: value.get_name().to_owned(),
                    help: value.get_help().map(ToString::to_string),
                    is_hidden: value.is_hide_set(),
                })
                .collect(),
            defaults: strings(arg.get_default_values()),
            hint: format!("{:?}", arg.get_value_hint()),
        }
    }

    fn add_to(self, arg: Arg) -> Arg {
        let (is_repeatable, names, count, possible, defaults, hint) = match self {
            Self::Nothing { is_repeatable } => {
                return arg.action(match is_repeatable {
                    true => ArgAction::Count,
                    false => ArgAction::SetTrue,
                });
            }
            Self::Values {
                is_repeatable,
                names,
                count,
                possible,
                defaults,
                hint,
            } => (is_repeatable, names, count, possible, defaults, hint),
        };
        let mut arg = arg.default_values(defaults).action(match is_repeatable {
            true => ArgAction::Append,
            false => ArgAction::Set,
        });
        if !names.is_empty() {
            arg = arg.value_names(names);
        }
        if let Some((fewest, most)) = count {
            arg = arg.num_args(ValueRange::new(fewest..=most));
        }
        if !possible.is_empty() {
            let possible = possible.into_iter().map(Value::into_possible);
            arg = arg.value_parser(PossibleValuesParser::new(possible));
        }
        // Another version of clap may have more hints.
        match hint.parse::<ValueHint>() {
            Ok(hint) => arg.value_hint(hint),
            Err(_) => arg,
        }
    }
}

impl Value {
    fn into_possible(self) -> PossibleValue {
        let value = PossibleValue::new(self.name).hide(self.is_hidden);
        match self.help {
            Some(help) => value.help(help),
            None => value,
        }
    }
}
