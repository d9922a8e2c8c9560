//! Reports of running nodes.

use crate::{Finding, Survey};
use wm_ros::logging::of_others;

const CHECK: &str = "nodes";

/// Warnings and errors on `/diagnostics`, which contain their own fixes.
pub(crate) fn check(survey: &Survey) -> Vec<Finding> {
    let reports = survey.reports.iter();
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
        let mut survey = Survey::default();
        let report = |text: &str, is_error| (text.to_owned(), is_error);
        survey.reports.insert("wm/a".into(), report("late", false));
        survey.reports.insert("wm/b".into(), report("gone\n", true));
        let found = check(&survey);
        assert_eq!(found[0].what, "wm/a: late");
        assert_eq!(
            (found[1].level, found[1].what.as_str()),
            (Level::Error, "wm/b: gone\\n")
        );
    }
}
