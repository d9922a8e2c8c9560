//! The parameters of a node as flags of a command: `--start-offset SECONDS` for `start_offset`.

use crate::parameters::Parameters;
use anyhow::Result;
use clap::{
    Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches, builder::PossibleValuesParser,
    parser::ValueSource, value_parser,
};
use serde_json::{Value as Json, json};
use std::{collections::BTreeMap, marker::PhantomData};
use wm_ros::{Kind, ParameterSpec};

/// The parameters of a command's node, and how they become flags.
pub(crate) trait Flagged {
    fn specs() -> Vec<ParameterSpec>;

    /// The flag of the parameter `name`; `None` if the command has another option for it.
    fn flag(name: &str, flag: Arg) -> Option<Arg>;
}

pub(crate) struct ParameterFlags<F> {
    given: BTreeMap<&'static str, Json>,
    of: PhantomData<F>,
}

impl<F> std::fmt::Debug for ParameterFlags<F> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(&self.given).finish()
    }
}

impl<F> ParameterFlags<F> {
    pub(crate) fn has(&self, name: &str) -> bool {
        self.given.contains_key(name)
    }

    /// Adds `texts` to a list.
    pub(crate) fn extend(&mut self, name: &'static str, texts: Vec<String>) {
        if texts.is_empty() {
            return;
        }
        let list = self.given.entry(name).or_insert_with(|| json!([]));
        if let Json::Array(list) = list {
            list.extend(texts.into_iter().map(Json::String));
        }
    }

    /// The given flags as parameters; others keep their defaults.
    pub(crate) fn parameters(&self, parameters: &mut Parameters) -> Result<()> {
        for (name, value) in &self.given {
            parameters.set(name, value)?;
        }
        Ok(())
    }
}

/// The flag of a parameter, with its description.
fn flag(spec: &ParameterSpec) -> Arg {
    let descriptor = &spec.descriptor;
    let flag = Arg::new(spec.name)
        .long(spec.name.replace('_', "-"))
        .value_name(value_name(spec));
    let mut help = descriptor.description.trim_end_matches('.').to_owned();
    let flag = match spec.default.kind() {
        Kind::Bool => return flag.help(help).action(ArgAction::SetTrue),
        Kind::Integer => flag
            .value_parser(value_parser!(i64))
            .allow_negative_numbers(true),
        Kind::Double => flag
            .value_parser(value_parser!(f64))
            .allow_negative_numbers(true),
        Kind::StringArray => flag.num_args(1..).action(ArgAction::Append),
        _ if !descriptor.choices.is_empty() => flag.value_parser(PossibleValuesParser::new(
            descriptor.choices.iter().copied(),
        )),
        _ => flag,
    };
    let default = spec.default.to_string();
    if !matches!(default.as_str(), "\"\"" | "[]") {
        help = format!("{help} [default: {}]", default.trim_matches('"'));
    }
    flag.help(help)
}

/// From the unit in the description, or from the name.
fn value_name(spec: &ParameterSpec) -> &'static str {
    let (name, text) = (spec.name, &spec.descriptor.description);
    let units = [
        ("[s]", "SECONDS"),
        ("[ms]", "MILLISECONDS"),
        ("[ns", "NANOSECONDS"),
        ("[Hz]", "HZ"),
        ("[bytes]", "BYTES"),
    ];
    let names = [
        ("regex", "REGEX"),
        ("types", "TYPE"),
        ("path", "FILE"),
        ("output", "DIR"),
        ("topic", "TOPIC"),
        ("wait_for", "TOPIC"),
    ];
    let unit = units.iter().find(|(unit, _)| text.contains(unit));
    let unit = unit.filter(|_| spec.default.kind() != Kind::StringArray);
    let named = || names.iter().find(|(part, _)| name.contains(part));
    match (unit.or_else(named), spec.default.kind()) {
        (Some((_, value)), _) => value,
        (None, Kind::Integer) => "N",
        (None, Kind::Double) => "NUMBER",
        (None, _) => "NAME",
    }
}

/// The given value of a parameter.
fn given(matches: &ArgMatches, spec: &ParameterSpec) -> Option<Json> {
    let name = spec.name;
    if matches.value_source(name) != Some(ValueSource::CommandLine) {
        return None;
    }
    match spec.default.kind() {
        Kind::Bool => Some(json!(matches.get_flag(name))),
        Kind::Integer => matches.get_one::<i64>(name).map(|value| json!(value)),
        Kind::Double => matches.get_one::<f64>(name).map(|value| json!(value)),
        Kind::StringArray => {
            let texts = matches.get_many::<String>(name)?;
            Some(json!(texts.collect::<Vec<_>>()))
        }
        _ => matches.get_one::<String>(name).map(|value| json!(value)),
    }
}

impl<F: Flagged> Args for ParameterFlags<F> {
    fn augment_args(command: Command) -> Command {
        let flags = F::specs()
            .into_iter()
            .filter_map(|spec| F::flag(spec.name, flag(&spec)));
        command.args(flags)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<F: Flagged> FromArgMatches for ParameterFlags<F> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let has_flag = |spec: &ParameterSpec| F::flag(spec.name, Arg::new(spec.name)).is_some();
        let specs = F::specs().into_iter().filter(has_flag);
        let given = specs.filter_map(|spec| Some((spec.name, given(matches, &spec)?)));
        Ok(Self {
            given: given.collect(),
            of: PhantomData,
        })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
