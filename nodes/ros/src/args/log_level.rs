//! `--log-level`.

use tracing::level_filters::LevelFilter;

/// The levels of log records: one for all loggers, and levels of single loggers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogLevels {
    pub(crate) default: Option<LevelFilter>,
    /// Logger names as ROS writes them (`wm.encoder`), or Rust module paths with dots.
    pub(crate) loggers: Vec<(String, LevelFilter)>,
}

impl LogLevels {
    /// Adds `level` or `logger:=level`.
    pub(crate) fn add(&mut self, text: &str) -> Result<(), String> {
        match text.split_once(":=") {
            Some((logger, level)) if !logger.is_empty() => {
                self.loggers.push((logger.to_owned(), parse(level)?));
            }
            Some(_) => return Err("a logger's name before :=".to_owned()),
            None => self.default = Some(parse(text)?),
        }
        Ok(())
    }
}

/// The levels of ROS; `fatal` keeps errors, since Rust's logs have no level above them.
fn parse(level: &str) -> Result<LevelFilter, String> {
    match level.to_ascii_lowercase().as_str() {
        "debug" => Ok(LevelFilter::DEBUG),
        "info" => Ok(LevelFilter::INFO),
        "warn" | "warning" => Ok(LevelFilter::WARN),
        "error" | "fatal" => Ok(LevelFilter::ERROR),
        _ => Err(format!("debug, info, warn, error or fatal; got `{level}`")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_level_for_all_and_one_for_a_logger() {
        let mut levels = LogLevels::default();
        levels.add("WARN").unwrap();
        levels.add("wm.encoder:=debug").unwrap();
        assert_eq!(levels.default, Some(LevelFilter::WARN));
        assert_eq!(
            levels.loggers,
            [("wm.encoder".to_owned(), LevelFilter::DEBUG)]
        );
        assert!(levels.add(":=debug").is_err());
    }
}
