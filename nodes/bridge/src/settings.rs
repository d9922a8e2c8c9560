//! The bridge's settings: the options of the command line, and the section `plugins: { ros2dds: { ... } }` of a Zenoh
//! configuration file. The keys are those of the ros2dds bridge, so one file configures both programs.

use crate::key::{Namespace, NamespaceError};
use regex::Regex;
use serde::Deserialize;
use std::{
    collections::BTreeSet,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};
use wm_ros::Role;
use zenoh::qos::Priority;

/// The real bridge's default.
const QUERIES_TIMEOUT_S: f32 = 5.0;
/// Samples kept for late subscribers, as a multiple of the publisher's depth, since several publishers may share a
/// topic.
const CACHE_MULTIPLIER: usize = 10;

/// The section as written.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Section {
    namespace: Option<String>,
    allow: Option<Interfaces>,
    deny: Option<Interfaces>,
    pub_max_frequencies: Vec<String>,
    pub_priorities: Vec<String>,
    queries_timeout: Option<QueriesTimeout>,
    reliable_routes_blocking: Option<bool>,
    transient_local_cache_multiplier: Option<usize>,
    /// The library of the real bridge's plugin; ignored.
    #[serde(rename = "__path__")]
    _path: Option<serde::de::IgnoredAny>,
    #[serde(rename = "__required__")]
    _required: Option<serde::de::IgnoredAny>,
}

/// Regular expressions of names, by the role of this side's nodes.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Interfaces {
    publishers: Names,
    subscribers: Names,
    service_servers: Names,
    service_clients: Names,
    /// actions are not carried
    #[serde(rename = "action_servers")]
    _action_servers: Names,
    #[serde(rename = "action_clients")]
    _action_clients: Names,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Names {
    One(String),
    Several(Vec<String>),
}

impl Default for Names {
    fn default() -> Self {
        Self::Several(Vec::new())
    }
}

#[derive(Debug, Deserialize)]
struct QueriesTimeout {
    default: Option<f32>,
}

/// The options of the command line, which add to the section or replace its values.
#[derive(Debug, Default)]
pub(crate) struct Options {
    pub namespace: Option<String>,
    pub allow: Vec<String>,
    pub deny: Vec<String>,
    pub max_frequencies: Vec<String>,
    pub priorities: Vec<String>,
    /// In seconds.
    pub queries_timeout: Option<f32>,
}

#[derive(Debug, thiserror::Error)]
pub(crate) enum SettingsError {
    /// The section is malformed.
    #[error("plugins/ros2dds: {0}")]
    Section(#[from] serde_json::Error),
    #[error(transparent)]
    Namespace(#[from] NamespaceError),
    /// Invalid regular expression.
    #[error("`{pattern}`: {source}")]
    Pattern {
        pattern: String,
        source: Box<regex::Error>,
    },
    /// Invalid `REGEX=VALUE`.
    #[error("`{rule}`: expected {expected}")]
    Rule {
        rule: String,
        expected: &'static str,
    },
    #[error("queries_timeout is {0}: expected seconds, above 0 and at most 3600")]
    Timeout(f32),
}

/// An expression for whole names, and whether a name has matched.
#[derive(Debug)]
struct Pattern {
    text: String,
    whole: Regex,
    has_matched: AtomicBool,
}

impl Pattern {
    fn is_match(&self, name: &str) -> bool {
        let is_match = self.whole.is_match(name);
        self.has_matched.fetch_or(is_match, Ordering::Relaxed);
        is_match
    }
}

/// The carried names of one role.
#[derive(Debug, Default)]
struct Filter {
    /// `None`: every name.
    allow: Option<Vec<Pattern>>,
    deny: Vec<Pattern>,
}

impl Filter {
    fn admits(&self, name: &str) -> bool {
        // match every pattern, even after a decision: a name may be the only match of a pattern
        let any = |patterns: &[Pattern]| {
            let matches = patterns.iter().filter(|pattern| pattern.is_match(name));
            matches.count() > 0
        };
        let (allowed, denied) = (self.allow.as_deref().is_none_or(any), any(&self.deny));
        allowed && !denied
    }

    fn patterns(&self) -> impl Iterator<Item = &Pattern> {
        self.allow.iter().flatten().chain(&self.deny)
    }
}

/// Priority of a topic's samples, and whether each is sent at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Precedence {
    /// Zenoh's priority.
    pub priority: Priority,
    /// Whether samples are sent without batching.
    pub is_express: bool,
}

#[derive(Debug)]
pub(crate) struct Settings {
    /// The prefix of this side's names.
    pub namespace: Namespace,
    /// Whether the topic of a reliable publisher waits for a slow network (so that its own queue overflows) instead of
    /// losing samples in the network.
    pub reliable_routes_blocking: bool,
    /// See [`CACHE_MULTIPLIER`].
    pub cache_multiplier: usize,
    /// The timeout for responses and for a latched topic's history.
    pub queries_timeout: Duration,
    publishers: Filter,
    subscribers: Filter,
    servers: Filter,
    clients: Filter,
    periods: Vec<(Regex, Duration)>,
    precedences: Vec<(Regex, Precedence)>,
}

impl Settings {
    /// Combines the section and the options.
    ///
    /// # Errors
    /// Names the malformed setting.
    pub(crate) fn new(section: Section, options: Options) -> Result<Self, SettingsError> {
        let namespace = options.namespace.or(section.namespace);
        let timeout = options
            .queries_timeout
            .or(section.queries_timeout.and_then(|timeout| timeout.default))
            .unwrap_or(QUERIES_TIMEOUT_S);
        if !(timeout > 0.0 && timeout <= 3600.0) {
            return Err(SettingsError::Timeout(timeout));
        }
        let filter = |of: fn(&Interfaces) -> &Names| {
            let mut filter = Filter::default();
            if section.allow.is_some() || !options.allow.is_empty() {
                let allowed = section.allow.as_ref().map(of);
                filter.allow = Some(patterns(allowed, &options.allow)?);
            }
            filter.deny = patterns(section.deny.as_ref().map(of), &options.deny)?;
            Ok::<_, SettingsError>(filter)
        };
        let frequencies = options.max_frequencies.iter();
        let priorities = options.priorities.iter();
        Ok(Self {
            namespace: namespace.as_deref().unwrap_or("/").parse()?,
            reliable_routes_blocking: section.reliable_routes_blocking.unwrap_or(true),
            cache_multiplier: section
                .transient_local_cache_multiplier
                .unwrap_or(CACHE_MULTIPLIER),
            queries_timeout: Duration::from_secs_f32(timeout),
            publishers: filter(|names| &names.publishers)?,
            subscribers: filter(|names| &names.subscribers)?,
            servers: filter(|names| &names.service_servers)?,
            clients: filter(|names| &names.service_clients)?,
            // the first match counts: options come before the file
            periods: frequencies
                .chain(&section.pub_max_frequencies)
                .map(|rule| period(rule))
                .collect::<Result<_, _>>()?,
            precedences: priorities
                .chain(&section.pub_priorities)
                .map(|rule| precedence(rule))
                .collect::<Result<_, _>>()?,
        })
    }

    /// Whether the topic or service is carried for nodes of this side in this role. Actions are not.
    pub(crate) fn admits(&self, role: Role, name: &str) -> bool {
        let filter = match role {
            Role::Publisher => &self.publishers,
            Role::Subscription => &self.subscribers,
            Role::Server => &self.servers,
            Role::Client => &self.clients,
        };
        !name.contains("/_action/") && filter.admits(name)
    }

    /// The patterns of `allow` and `deny` without a match in any role: most often mistakes.
    pub(crate) fn unmatched(&self) -> BTreeSet<&str> {
        let filters = [
            &self.publishers,
            &self.subscribers,
            &self.servers,
            &self.clients,
        ];
        let patterns = || filters.into_iter().flat_map(Filter::patterns);
        let of = |has_matched: bool| {
            let is_so = move |p: &&Pattern| p.has_matched.load(Ordering::Relaxed) == has_matched;
            patterns()
                .filter(is_so)
                .map(|pattern| pattern.text.as_str())
        };
        let matched: BTreeSet<&str> = of(true).collect();
        of(false).filter(|text| !matched.contains(text)).collect()
    }

    /// The shortest time between outgoing samples of a topic.
    pub(crate) fn period(&self, name: &str) -> Option<Duration> {
        first_match(&self.periods, name)
    }

    pub(crate) fn precedence(&self, name: &str) -> Precedence {
        first_match(&self.precedences, name).unwrap_or_default()
    }
}

fn first_match<T: Copy>(rules: &[(Regex, T)], name: &str) -> Option<T> {
    let rule = rules.iter().find(|(pattern, _)| pattern.is_match(name));
    rule.map(|(_, value)| *value)
}

/// The expressions of a file and of the command line, each for a whole name.
fn patterns(names: Option<&Names>, more: &[String]) -> Result<Vec<Pattern>, SettingsError> {
    let of_file = match names {
        None => &[],
        Some(Names::One(name)) => std::slice::from_ref(name),
        Some(Names::Several(names)) => names.as_slice(),
    };
    let whole = |name: &String| {
        Ok(Pattern {
            text: name.clone(),
            whole: pattern(&format!("^(?:{name})$"))?,
            has_matched: AtomicBool::new(false),
        })
    };
    of_file.iter().chain(more).map(whole).collect()
}

fn pattern(pattern: &str) -> Result<Regex, SettingsError> {
    Regex::new(pattern).map_err(|source| SettingsError::Pattern {
        pattern: pattern.to_owned(),
        source: Box::new(source),
    })
}

/// `REGEX=HZ`; the expression may match a part of the name, as in the real bridge.
fn period(rule: &str) -> Result<(Regex, Duration), SettingsError> {
    let refused = || SettingsError::Rule {
        rule: rule.to_owned(),
        expected: "REGEX=HZ, from 0.001 to 1000000 Hz",
    };
    let (names, frequency) = rule.rsplit_once('=').ok_or_else(refused)?;
    let frequency: f64 = frequency.trim().parse().map_err(|_| refused())?;
    if !(0.001..=1e6).contains(&frequency) {
        return Err(refused());
    }
    Ok((pattern(names)?, Duration::from_secs_f64(1.0 / frequency)))
}

/// `REGEX=NUMBER[:express]`.
fn precedence(rule: &str) -> Result<(Regex, Precedence), SettingsError> {
    let refused = || SettingsError::Rule {
        rule: rule.to_owned(),
        expected: "REGEX=NUMBER[:express], from 1 (real time) to 7 (background); 5 is the default",
    };
    let (names, value) = rule.rsplit_once('=').ok_or_else(refused)?;
    let (number, is_express) = match value.strip_suffix(":express") {
        Some(number) => (number, true),
        None => (value, false),
    };
    let number: u8 = number.trim().parse().map_err(|_| refused())?;
    let priority = Priority::try_from(number).map_err(|_| refused())?;
    Ok((
        pattern(names)?,
        Precedence {
            priority,
            is_express,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(section: &str, options: Options) -> Result<Settings, SettingsError> {
        Settings::new(serde_json::from_str(section)?, options)
    }

    fn words(words: &[&str]) -> Vec<String> {
        words.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn everything_but_actions_is_carried_by_default() {
        let settings = settings("{}", Options::default()).unwrap();
        assert!(settings.admits(Role::Publisher, "/wm/latent"));
        assert!(settings.admits(Role::Client, "/wm/planner/reset"));
        assert!(!settings.admits(Role::Publisher, "/fibonacci/_action/feedback"));
        assert_eq!(settings.period("/wm/latent"), None);
        assert_eq!(settings.precedence("/wm/latent"), Precedence::default());
    }

    #[test]
    fn lists_in_the_file_apply_to_role_and_whole_names() {
        let section =
            r#"{"allow": {"publishers": ["/wm/.*", "/tf"], "service_servers": ".*reset"}}"#;
        let settings = settings(section, Options::default()).unwrap();
        assert!(settings.admits(Role::Publisher, "/wm/latent"));
        assert!(!settings.admits(Role::Publisher, "/tf_static"));
        assert!(!settings.admits(Role::Subscription, "/wm/latent"));
        assert!(settings.admits(Role::Server, "/wm/planner/reset"));
        assert!(!settings.admits(Role::Client, "/wm/planner/reset"));
    }

    /// Many names contain `image`, but none equals it.
    #[test]
    fn pattern_without_a_whole_match_is_reported() {
        let options = Options {
            deny: words(&["image", ".*/image.*", "/camera/.*"]),
            ..Options::default()
        };
        let settings = settings(
            r#"{"allow": {"publishers": ["/camera/.*", "/tf"]}}"#,
            options,
        );
        let settings = settings.unwrap();
        assert_eq!(settings.unmatched().len(), 4);
        settings.admits(Role::Publisher, "/camera/image_raw");
        let unmatched: Vec<&str> = settings.unmatched().into_iter().collect();
        assert_eq!(unmatched, ["/tf", "image"]);
    }

    #[test]
    fn command_line_applies_to_all_roles_and_deny_wins() {
        let options = Options {
            allow: words(&["/wm/.*", "/tf|/clock"]),
            deny: words(&[".*/image.*"]),
            ..Options::default()
        };
        let settings = settings("{}", options).unwrap();
        for role in [
            Role::Publisher,
            Role::Subscription,
            Role::Server,
            Role::Client,
        ] {
            assert!(settings.admits(role, "/wm/latent"));
            assert!(settings.admits(role, "/clock"));
            assert!(!settings.admits(role, "/clock2"));
            assert!(!settings.admits(role, "/wm/predicted/image/compressed"));
            assert!(!settings.admits(role, "/rosout"));
        }
    }

    #[test]
    fn first_matching_rule_sets_rate_and_priority() {
        let section = r#"{"pub_max_frequencies": ["/image=1", ".*=10"], "pub_priorities": ["/wm/plan=2:express"],
            "queries_timeout": {"default": 2.5}, "__path__": "/lib"}"#;
        let options = Options {
            max_frequencies: words(&["/wm/predicted=5"]),
            ..Options::default()
        };
        let settings = settings(section, options).unwrap();
        let millis = |name| settings.period(name).map(|period| period.as_millis());
        assert_eq!(millis("/wm/predicted/image"), Some(200));
        assert_eq!(millis("/camera/image_raw"), Some(1000));
        assert_eq!(millis("/tf"), Some(100));
        let express = Precedence {
            priority: Priority::InteractiveHigh,
            is_express: true,
        };
        assert_eq!(settings.precedence("/wm/plan"), express);
        assert_eq!(settings.queries_timeout, Duration::from_millis(2500));
    }

    #[test]
    fn invalid_settings_are_refused_by_name() {
        let reason = |section: &str| {
            settings(section, Options::default())
                .unwrap_err()
                .to_string()
        };
        assert!(reason(r#"{"allow": {"topics": ["/a"]}}"#).contains("topics"));
        assert!(reason(r#"{"allow": {"publishers": ["("]}}"#).contains("(?:()"));
        assert!(reason(r#"{"pub_max_frequencies": ["/a=0"]}"#).contains("/a=0"));
        assert!(reason(r#"{"pub_priorities": ["/a=9"]}"#).contains("/a=9"));
        assert!(reason(r#"{"pub_priorities": ["/a"]}"#).contains("/a"));
        assert!(reason(r#"{"queries_timeout": {"default": 0}}"#).contains("seconds"));
        assert!(reason(r#"{"namespace": "robot"}"#).contains("robot"));
    }
}
