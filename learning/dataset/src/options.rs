use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::{Deserialize, Deserializer, Serialize};
use wm_audit::Stamps;
use wm_model::Fit;
use wm_motion::actions::ActionSpace;

use super::{DatasetError, Size};

/// Default action topic.
const ACTION: &str = "/wm/action";
/// Longest time between two frames of an episode, in periods of the model's rate: a missing frame is a gap, as in the
/// nodes, but stamps may jitter.
const GAP_PERIODS: f64 = 1.75;
/// Default share of validation episodes.
const VALIDATION: f64 = 0.1;

/// Topic whose change starts a new episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cut {
    /// A change of `/task/instruction`.
    Instruction,
}

/// The time that dates a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StampSource {
    /// The stamp in its header.
    #[default]
    Header,
    /// The time of recording.
    Log,
    /// The time of publishing, as recorded.
    Publish,
}

impl StampSource {
    /// Time of a message \[ns\].
    pub(super) fn of(self, stamps: Stamps) -> i64 {
        match self {
            Self::Header => stamps.header_ns,
            Self::Log => stamps.log_ns,
            Self::Publish => stamps.publish_ns,
        }
    }

    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Greatest shift of actions \[frames\].
const MOST_SHIFT: i64 = 1000;

/// How recordings become episodes: options of the command line, or of a YAML file with the same names.
///
/// An option that is not given is `None` or empty; its description has the default.
#[derive(Args, Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
pub struct DataOptions {
    /// YAML file with these options, without leading dashes. The command line wins
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub config: Option<PathBuf>,
    /// Topic of a camera, raw or compressed (repeatable: pictures of several cameras are placed side by side) [default:
    /// /camera/image_raw, or the only camera]
    #[arg(long = "camera", value_name = "TOPIC")]
    #[serde(rename = "camera", deserialize_with = "one_or_more")]
    pub cameras: Vec<String>,
    /// Topic of the actions: wm_msgs/Action, or sensor_msgs/JointState with the joints of the action space [default:
    /// /wm/action]
    #[arg(long, value_name = "TOPIC", visible_alias = "action")]
    pub action_topic: Option<String>,
    /// Action space: a JSON or YAML file with name, rate in Hz and 1 to 32 dimensions, like "space" in model.json, or
    /// the action_space.json of a prepared folder [default: that of the bags]
    #[arg(long, value_name = "FILE")]
    pub action_space: Option<PathBuf>,
    /// Time that dates frames and actions: the stamp in the header, or the time of recording or publishing, for drivers
    /// without stamps [default: header]
    #[arg(long, value_enum, value_name = "TIME")]
    pub stamps: Option<StampSource>,
    /// Move each action N frames later (earlier if negative); N is the lag of the pictures in the audit [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub shift_actions: Option<i64>,
    /// Begin a new episode when this changes (repeatable)
    #[arg(long, value_enum)]
    #[serde(deserialize_with = "one_or_more")]
    pub cut: Vec<Cut>,
    /// Begin a new episode after each message of this topic, of any type (repeatable)
    #[arg(long, value_name = "TOPIC")]
    #[serde(deserialize_with = "one_or_more")]
    pub cut_topic: Vec<String>,
    /// Begin a new episode after this many seconds
    #[arg(long, value_name = "SECONDS")]
    pub cut_seconds: Option<f64>,
    /// Begin a new episode if the camera has no frame for more than this many periods of the action space's rate
    /// [default: 1.75]
    #[arg(long, value_name = "PERIODS")]
    pub gap_periods: Option<f64>,
    /// Exclude episodes of fewer seconds [default: 0]
    #[arg(long, value_name = "SECONDS")]
    pub min_seconds: Option<f64>,
    /// Bags or prepared folders with the validation episodes (repeatable); all others are for training. Bags in the
    /// training folders may be named too
    #[arg(long, value_name = "PATH")]
    #[serde(deserialize_with = "one_or_more")]
    pub held_out: Vec<PathBuf>,
    /// Share of the validation episodes, from 0 to 1 [default: 0.1]
    #[arg(long, value_name = "SHARE")]
    pub validation: Option<f64>,
    /// Seed of the choice of validation episodes [default: 0]
    #[arg(long, value_name = "SEED")]
    pub validation_seed: Option<u64>,
    /// Height and width of a camera's prepared pictures. Training ignores it: the model specifies its own.
    #[arg(skip)]
    pub size: Option<Size>,
    /// How pictures of another aspect fit the size. Training ignores it, as the size.
    #[arg(skip)]
    pub fit: Option<Fit>,
    /// Whether the cache has a folder for each bag instead of one for all, so that trainings on other selections of bags find
    /// it again.
    #[arg(skip)]
    #[serde(skip)]
    pub by_bag: bool,
}

/// A list, or a single value as a list of one.
fn one_or_more<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum OneOrMore<T> {
        More(Vec<T>),
        One(T),
    }
    Ok(match OneOrMore::deserialize(deserializer)? {
        OneOrMore::More(values) => values,
        OneOrMore::One(value) => vec![value],
    })
}

/// Options that determine the contents of a prepared folder, with defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Requested camera topics; empty for the default.
    pub cameras: Vec<String>,
    /// Topic of the actions.
    pub action_topic: String,
    /// Space of the actions, if not that of the bags.
    pub action_space: Option<ActionSpace>,
    /// The time that dates messages.
    #[serde(default, skip_serializing_if = "StampSource::is_default")]
    pub stamps: StampSource,
    /// Frames by which actions move later.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shift_actions: i64,
    /// Topics whose change starts an episode.
    pub cut: Vec<Cut>,
    /// Topics whose messages start an episode.
    pub cut_topics: Vec<String>,
    /// Longest episode \[s\].
    pub cut_seconds: Option<f64>,
    /// Longest time between frames \[periods\].
    pub gap_periods: f64,
    /// Shortest episode \[s\].
    pub min_seconds: f64,
}

fn is_zero(number: &i64) -> bool {
    *number == 0
}

/// Choice of the validation episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitRule {
    /// Their share, 0 to 1.
    pub validation: f64,
    /// Seed of the choice.
    pub seed: u64,
}

impl Default for SplitRule {
    fn default() -> Self {
        Self {
            validation: VALIDATION,
            seed: 0,
        }
    }
}

impl DataOptions {
    /// Adds the options of the `--config` file where these have none. Relative paths in it start at its folder.
    ///
    /// # Errors
    /// If the file cannot be read, or has an unknown option.
    pub fn with_config(&self) -> Result<Self, DatasetError> {
        let Some(path) = &self.config else {
            return Ok(self.clone());
        };
        let text = std::fs::read_to_string(path).map_err(DatasetError::io(path))?;
        // An empty file has no options.
        let file: Option<Self> =
            serde_yaml_ng::from_str(&text).map_err(|error| DatasetError::file(path, error))?;
        let mut file = file.unwrap_or_default();
        let folder = path.parent().unwrap_or(Path::new(""));
        for path in file.held_out.iter_mut().chain(&mut file.action_space) {
            *path = folder.join(&*path);
        }
        fn or<T: Clone>(own: &[T], file: Vec<T>) -> Vec<T> {
            if own.is_empty() { file } else { own.to_vec() }
        }
        Ok(Self {
            config: None,
            cameras: or(&self.cameras, file.cameras),
            action_topic: self.action_topic.clone().or(file.action_topic),
            action_space: self.action_space.clone().or(file.action_space),
            stamps: self.stamps.or(file.stamps),
            shift_actions: self.shift_actions.or(file.shift_actions),
            cut: or(&self.cut, file.cut),
            cut_topic: or(&self.cut_topic, file.cut_topic),
            cut_seconds: self.cut_seconds.or(file.cut_seconds),
            gap_periods: self.gap_periods.or(file.gap_periods),
            min_seconds: self.min_seconds.or(file.min_seconds),
            held_out: or(&self.held_out, file.held_out),
            validation: self.validation.or(file.validation),
            validation_seed: self.validation_seed.or(file.validation_seed),
            size: self.size.or(file.size),
            fit: self.fit.or(file.fit),
            by_bag: self.by_bag,
        })
    }

    /// Checked settings; call it after [`Self::with_config`].
    pub(super) fn settings(&self) -> Result<Settings, DatasetError> {
        let positive = |option, value: f64, least: f64| {
            if value.is_finite() && value >= least {
                return Ok(value);
            }
            let what = format!("expected a number of at least {least}, got {value}");
            Err(DatasetError::Option { option, what })
        };
        for (index, camera) in self.cameras.iter().enumerate() {
            if self.cameras.iter().skip(index + 1).any(|c| c == camera) {
                let what = format!("{camera} is given twice");
                return Err(DatasetError::Option {
                    option: "--camera",
                    what,
                });
            }
        }
        let cut_seconds = self
            .cut_seconds
            .map(|value| positive("--cut-seconds", value, 1e-3));
        Ok(Settings {
            cameras: self.cameras.clone(),
            action_topic: self.action_topic.clone().unwrap_or_else(|| ACTION.into()),
            action_space: self.space()?,
            stamps: self.stamps.unwrap_or_default(),
            shift_actions: self.shift()?,
            cut: self.cut.clone(),
            cut_topics: self.cut_topic.clone(),
            cut_seconds: cut_seconds.transpose()?,
            gap_periods: positive(
                "--gap-periods",
                self.gap_periods.unwrap_or(GAP_PERIODS),
                1.0,
            )?,
            min_seconds: positive("--min-seconds", self.min_seconds.unwrap_or(0.0), 0.0)?,
        })
    }

    fn shift(&self) -> Result<i64, DatasetError> {
        let shift = self.shift_actions.unwrap_or(0);
        if shift.abs() <= MOST_SHIFT {
            return Ok(shift);
        }
        Err(DatasetError::Option {
            option: "--shift-actions",
            what: format!("expected -{MOST_SHIFT} to {MOST_SHIFT} frames, got {shift}"),
        })
    }

    /// The action space of `--action-space`, in YAML, which includes JSON.
    pub(super) fn space(&self) -> Result<Option<ActionSpace>, DatasetError> {
        let Some(path) = &self.action_space else {
            return Ok(None);
        };
        let text = std::fs::read_to_string(path).map_err(DatasetError::io(path))?;
        let space =
            serde_yaml_ng::from_str(&text).map_err(|error| DatasetError::file(path, error))?;
        Ok(Some(space))
    }

    pub(super) fn split_rule(&self) -> Result<SplitRule, DatasetError> {
        let default = SplitRule::default();
        let validation = self.validation.unwrap_or(default.validation);
        if !(0.0..=1.0).contains(&validation) {
            return Err(DatasetError::Option {
                option: "--validation",
                what: format!("expected 0 to 1, got {validation}"),
            });
        }
        Ok(SplitRule {
            validation,
            seed: self.validation_seed.unwrap_or(default.seed),
        })
    }

    /// The first bag option, which has no effect on prepared data.
    pub(super) fn of_preparation(&self) -> Option<&'static str> {
        let given = [
            (!self.cameras.is_empty(), "--camera"),
            (self.action_topic.is_some(), "--action-topic"),
            (self.stamps.is_some(), "--stamps"),
            (self.shift_actions.is_some(), "--shift-actions"),
            (!self.cut.is_empty(), "--cut"),
            (!self.cut_topic.is_empty(), "--cut-topic"),
            (self.cut_seconds.is_some(), "--cut-seconds"),
            (self.gap_periods.is_some(), "--gap-periods"),
            (self.min_seconds.is_some(), "--min-seconds"),
        ];
        let mut given = given.into_iter().filter(|(is_given, _)| *is_given);
        given.next().map(|(_, option)| option)
    }
}
