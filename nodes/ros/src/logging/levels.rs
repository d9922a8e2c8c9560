//! The levels of log records, and the two services that report and change them while the node runs.

use crate::args::LogLevels;
use std::sync::{Mutex, PoisonError};
use tracing::level_filters::LevelFilter;
use tracing_subscriber::{Registry, filter::Targets, reload};
use wm_msgs::rcl_interfaces::{
    GetLoggerLevelsResponse, LoggerLevel, SetLoggerLevelsResponse, SetLoggerLevelsResult,
};

/// The most loggers with a level, and the most per request: requests run on the receiving thread.
const MAX_LOGGERS: usize = 256;

/// The longest name of a logger \[byte\]: rmw limits names of nodes to 255.
const MAX_NAME: usize = 255;

/// The levels of this process.
static LEVELS: Mutex<Option<Levels>> = Mutex::new(None);

struct Levels {
    levels: LogLevels,
    filter: reload::Handle<Targets, Registry>,
}

/// The module of Zenoh that logs each start of a session, with a warning if there is no router, of which this runtime
/// warns too.
const ZENOH_START: &str = "zenoh::net::runtime";
/// The module of Zenoh that logs each end of a session.
const ZENOH_END: &str = "zenoh::api::session";

/// `--log-level` as a filter. A name that begins with `wm_` or `zenoh` is a Rust module, dots for colons; any other is a
/// node's logger (`wm.encoder`) and applies to all records of its process, since a process runs one node.
pub(super) fn filter(levels: &LogLevels) -> Targets {
    let default = levels.default.unwrap_or(LevelFilter::INFO);
    let mut filter = Targets::new().with_default(default);
    if default == LevelFilter::INFO {
        filter = filter
            .with_target(ZENOH_START, LevelFilter::ERROR)
            .with_target(ZENOH_END, LevelFilter::WARN);
    }
    let filter = levels
        .loggers
        .iter()
        .fold(filter, |filter, (logger, level)| {
            if logger.starts_with("wm_") || logger.starts_with("zenoh") {
                filter.with_target(logger.replace('.', "::"), *level)
            } else {
                filter.with_default(*level)
            }
        });
    #[cfg(feature = "zenoh")]
    if filter.would_enable(super::denials::TARGET, &tracing::Level::WARN) {
        // they are warnings for the user, and only a router with access control has them
        return filter.with_target(super::denials::TARGET, LevelFilter::TRACE);
    }
    filter
}

/// The filter of these levels; the services change it.
pub(super) fn install(levels: &LogLevels) -> reload::Layer<Targets, Registry> {
    let (layer, handle) = reload::Layer::new(filter(levels));
    let mut installed = LEVELS.lock().unwrap_or_else(PoisonError::into_inner);
    if installed.is_none() {
        *installed = Some(Levels {
            levels: levels.clone(),
            filter: handle,
        });
    }
    layer
}

/// `get_logger_levels`, as rclcpp answers it: 0 for a logger whose level was not set. The empty name is the root. With
/// too many names, only the first are answered.
pub(crate) fn get(names: &[String]) -> GetLoggerLevelsResponse {
    let installed = LEVELS.lock().unwrap_or_else(PoisonError::into_inner);
    let level = |name: &String| LoggerLevel {
        name: name.clone(),
        level: installed
            .as_ref()
            .map_or(0, |installed| installed.levels.number(name)),
    };
    GetLoggerLevelsResponse {
        levels: names.iter().take(MAX_LOGGERS).map(level).collect(),
    }
}

/// `set_logger_levels`: each on its own; level 0 removes a logger's own level. The filter changes once, after all are
/// set, since each change evaluates all callsites again. A request with too many names is refused as a whole, with one
/// result.
pub(crate) fn set(wanted: &[LoggerLevel]) -> SetLoggerLevelsResponse {
    let mut installed = LEVELS.lock().unwrap_or_else(PoisonError::into_inner);
    let results = match installed.as_mut() {
        None => vec![Err("the program does its own logging".to_owned())],
        Some(Levels { levels, .. }) => levels.set_all(wanted),
    };
    if let Some(Levels {
        levels,
        filter: handle,
    }) = installed.as_ref()
    {
        // It fails only after the subscriber is dropped, when there are no records to filter.
        handle.reload(filter(levels)).ok();
    }
    let result = |outcome: Result<(), String>| SetLoggerLevelsResult {
        successful: outcome.is_ok(),
        reason: outcome.err().unwrap_or_default(),
    };
    SetLoggerLevelsResponse {
        results: results.into_iter().map(result).collect(),
    }
}

impl LogLevels {
    /// The level of a logger in the numbers of `rcl_interfaces/msg/LoggerLevel`; 0 if it has none of its own.
    fn number(&self, logger: &str) -> u32 {
        let level = match logger {
            "" => Some(self.default.unwrap_or(LevelFilter::INFO)),
            logger => {
                let own = self.loggers.iter().rfind(|(name, _)| name == logger);
                own.map(|(_, level)| *level)
            }
        };
        match level {
            None => 0,
            Some(LevelFilter::ERROR | LevelFilter::OFF) => 40,
            Some(LevelFilter::WARN) => 30,
            Some(LevelFilter::INFO) => 20,
            Some(_) => 10,
        }
    }

    fn set_all(&mut self, wanted: &[LoggerLevel]) -> Vec<Result<(), String>> {
        if wanted.len() > MAX_LOGGERS {
            return vec![Err(format!(
                "expected at most {MAX_LOGGERS} levels in one request, got {}",
                wanted.len()
            ))];
        }
        let set = |wanted: &LoggerLevel| self.set(&wanted.name, wanted.level);
        wanted.iter().map(set).collect()
    }

    fn set(&mut self, logger: &str, level: u32) -> Result<(), String> {
        if logger.len() > MAX_NAME {
            return Err(format!(
                "expected a logger's name of at most {MAX_NAME} bytes, got {}",
                logger.len()
            ));
        }
        let level = match level {
            0 => None,
            10 => Some(LevelFilter::DEBUG),
            20 => Some(LevelFilter::INFO),
            30 => Some(LevelFilter::WARN),
            // fatal keeps errors, since Rust's logs have no level above them
            40 | 50 => Some(LevelFilter::ERROR),
            other => {
                return Err(format!(
                    "logger `{logger}`: expected level 0, 10, 20, 30, 40 or 50, got {other}"
                ));
            }
        };
        if logger.is_empty() {
            self.default = level;
            return Ok(());
        }
        self.loggers.retain(|(name, _)| name != logger);
        if let Some(level) = level {
            if self.loggers.len() >= MAX_LOGGERS {
                return Err(format!(
                    "logger `{logger}`: {MAX_LOGGERS} loggers already have levels"
                ));
            }
            self.loggers.push((logger.to_owned(), level));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeArgs;
    use tracing::Level;

    #[test]
    fn levels_become_filters() {
        let levels =
            |line: &str| filter(&NodeArgs::parse(line.split_whitespace()).unwrap().log_levels);
        let all = levels("--ros-args --log-level warn");
        assert!(!all.would_enable("wm_nodes::encoder", &Level::INFO));
        let node = levels("--ros-args --log-level wm.encoder:=debug");
        assert!(node.would_enable("wm_nodes::encoder", &Level::DEBUG));
        let module = levels("--ros-args --log-level wm_ros.dds:=debug");
        assert!(module.would_enable("wm_ros::dds", &Level::DEBUG));
        assert!(!module.would_enable("wm_nodes", &Level::DEBUG));
        let start = "zenoh::net::runtime::orchestrator";
        assert!(!levels("").would_enable(start, &Level::WARN));
        let zenoh = levels("--ros-args --log-level zenoh.net.runtime:=debug");
        assert!(zenoh.would_enable(start, &Level::DEBUG));
    }

    #[cfg(feature = "zenoh")]
    #[test]
    fn denials_are_enabled_as_warnings() {
        let is_enabled = |line: &str| {
            let levels = NodeArgs::parse(line.split_whitespace()).unwrap().log_levels;
            let target = super::super::denials::TARGET;
            filter(&levels).would_enable(target, &Level::TRACE)
        };
        assert!(is_enabled("") && is_enabled("--ros-args --log-level warn"));
        assert!(!is_enabled("--ros-args --log-level error"));
    }

    #[test]
    fn levels_are_set_told_and_taken_back() {
        let mut levels = LogLevels::default();
        assert_eq!((levels.number(""), levels.number("wm.encoder")), (20, 0));
        levels.set("wm.encoder", 10).unwrap();
        levels.set("", 50).unwrap();
        assert_eq!((levels.number(""), levels.number("wm.encoder")), (40, 10));
        assert!(filter(&levels).would_enable("wm_nodes", &Level::DEBUG));
        levels.set("wm.encoder", 0).unwrap();
        assert!(!filter(&levels).would_enable("wm_nodes", &Level::WARN));
        assert!(levels.set("wm.encoder", 25).unwrap_err().contains("25"));
        let long = "x".repeat(MAX_NAME + 1);
        assert!(levels.set(&long, 10).unwrap_err().contains("256"));
    }

    #[test]
    fn a_request_for_thousands_of_levels_is_refused_whole() {
        let mut levels = LogLevels::default();
        let wanted = |count: usize| -> Vec<LoggerLevel> {
            let level = |index| LoggerLevel {
                name: format!("logger_{index}"),
                level: 10,
            };
            (0..count).map(level).collect()
        };
        let results = levels.set_all(&wanted(5000));
        assert_eq!(results.len(), 1);
        assert!(
            results[0].as_ref().unwrap_err().contains("got 5000"),
            "{results:?}"
        );
        assert!(levels.loggers.is_empty());
        assert!(
            levels
                .set_all(&wanted(MAX_LOGGERS))
                .iter()
                .all(Result::is_ok)
        );
        assert_eq!(levels.loggers.len(), MAX_LOGGERS);
    }
}
