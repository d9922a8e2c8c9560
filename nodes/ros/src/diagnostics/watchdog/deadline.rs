//! A stage with a deadline.

use super::{Finding, Level};
use std::{collections::VecDeque, time::Duration};

/// Number of reports, one per second, that a judgement covers.
const REPORTS: usize = 10;
/// With fewer runs, missing most of them is no error.
const FEW: u32 = 5;

/// The deadline of a stage.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// The stage: `first predicted step`.
    pub stage: &'static str,
    /// The time limit.
    pub limit: Duration,
    /// The remedy if it takes longer.
    pub advice: &'static str,
}

#[derive(Clone, Copy, Debug, Default)]
struct Runs {
    all: u32,
    late: u32,
    slowest: Duration,
}

#[derive(Debug)]
pub(super) struct DeadlineWatch {
    deadline: Deadline,
    current: Runs,
    past: VecDeque<Runs>,
}

impl DeadlineWatch {
    pub(super) fn new(deadline: Deadline) -> Self {
        Self {
            deadline,
            current: Runs::default(),
            past: VecDeque::new(),
        }
    }

    pub(super) fn took(&mut self, deadline: Deadline, taken: Duration) {
        self.deadline = deadline;
        self.current.all = self.current.all.saturating_add(1);
        if taken > self.deadline.limit {
            self.current.late = self.current.late.saturating_add(1);
        }
        self.current.slowest = self.current.slowest.max(taken);
    }

    /// The judgement over the last reports; this one begins the next.
    pub(super) fn judge(&mut self) -> Finding {
        self.past.push_back(std::mem::take(&mut self.current));
        while self.past.len() > REPORTS {
            self.past.pop_front();
        }
        let runs = self.past.iter().fold(Runs::default(), |sum, runs| Runs {
            all: sum.all.saturating_add(runs.all),
            late: sum.late.saturating_add(runs.late),
            slowest: sum.slowest.max(runs.slowest),
        });
        let Deadline {
            stage,
            limit,
            advice,
        } = self.deadline;
        let millis = |time: Duration| time.as_secs_f64() * 1e3;
        let (level, message) = if runs.late == 0 {
            let text = format!("all {} within {:.0} ms", runs.all, millis(limit));
            (Level::Ok, text)
        } else {
            let is_most = runs.all >= FEW && runs.late > runs.all / 2;
            let level = if is_most { Level::Error } else { Level::Warn };
            let text = format!(
                "{} of {} in the last {REPORTS} s took more than {:.0} ms, the slowest {:.0} ms: {advice}",
                runs.late,
                runs.all,
                millis(limit),
                millis(runs.slowest)
            );
            (level, text)
        };
        Finding {
            subject: format!("deadline {stage}"),
            level,
            message,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEADLINE: Deadline = Deadline {
        stage: "first step",
        limit: Duration::from_millis(200),
        advice: "shorten the horizon",
    };

    fn watch() -> DeadlineWatch {
        DeadlineWatch::new(DEADLINE)
    }

    #[test]
    fn some_late_warn_most_late_are_an_error_and_it_passes() {
        let mut watch = watch();
        let took = |watch: &mut DeadlineWatch, millis| {
            watch.took(DEADLINE, Duration::from_millis(millis));
        };
        for _ in 0..9 {
            took(&mut watch, 200);
        }
        assert_eq!(
            watch.judge().level,
            Level::Ok,
            "the limit itself is in time"
        );
        took(&mut watch, 450);
        let finding = watch.judge();
        assert_eq!(finding.level, Level::Warn);
        assert_eq!(
            finding.message,
            "1 of 10 in the last 10 s took more than 200 ms, the slowest 450 ms: shorten the horizon"
        );
        for _ in 0..20 {
            took(&mut watch, 201);
        }
        assert_eq!(watch.judge().level, Level::Error);
        for _ in 0..REPORTS {
            watch.judge();
        }
        assert_eq!(watch.judge().level, Level::Ok);
    }

    #[test]
    fn the_first_late_one_is_no_error() {
        let mut watch = watch();
        watch.took(DEADLINE, Duration::from_secs(1));
        assert_eq!(watch.judge().level, Level::Warn);
    }

    #[test]
    fn deadline_may_change_between_runs() {
        let mut watch = watch();
        let limit = Duration::from_secs(2);
        for _ in 0..FEW {
            watch.took(Deadline { limit, ..DEADLINE }, Duration::from_secs(1));
        }
        let finding = watch.judge();
        assert_eq!(
            (finding.level, finding.message.as_str()),
            (Level::Ok, "all 5 within 2000 ms")
        );
    }
}
