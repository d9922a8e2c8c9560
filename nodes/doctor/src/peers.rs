//! What nodes that run already say of themselves.

use crate::{Finding, Heard};
use wm_ros::logging::of_others;

/// This check.
const CHECK: &str = "nodes";

/// Warnings and errors on `/diagnostics`, which say themselves what to do.
pub(crate) fn check(heard: &Heard) -> Vec<Finding> {
    let reports = heard.reports.iter();
    reports
        .map(|(name, (message, is_error))| {
            let what = format!("{}: {}", of_others(name), of_others(message));
            match is_error {
                true => Finding::error(CHECK, what),
                false => Finding::warning(CHECK, what),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;

    #[test]
    fn reports_keep_their_levels() {
        let mut heard = Heard::default();
        let report = |text: &str, is_error| (text.to_owned(), is_error);
        heard.reports.insert("wm/a".into(), report("late", false));
        heard.reports.insert("wm/b".into(), report("gone\n", true));
        let found = check(&heard);
        assert_eq!(found[0].what, "wm/a: late");
        assert_eq!(
            (found[1].level, found[1].what.as_str()),
            (Level::Error, "wm/b: gone\\n")
        );
    }
}
