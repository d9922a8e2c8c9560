//! When a round begins.

/// Settings of the schedule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ScheduleSettings {
    /// Duration of the recordings before the first round \[s\].
    pub first_s: f64,
    /// Duration of new recordings before each later round \[s\].
    pub more_s: f64,
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Due {
    /// A round.
    Round,
    /// More recordings are needed \[s\].
    Recordings(f64),
}

/// Counts what was recorded since the last round.
#[derive(Clone, Debug)]
pub(super) struct Schedule {
    settings: ScheduleSettings,
    /// Since the last round began \[s\].
    new_s: f64,
    had_round: bool,
    /// Both before the present round.
    before: Option<(f64, bool)>,
}

impl Schedule {
    /// With `recorded_s` seconds of recordings, and `had_round` if a round was made of some of them.
    pub(super) fn new(settings: ScheduleSettings, recorded_s: f64, had_round: bool) -> Self {
        Self {
            settings,
            new_s: if had_round { 0.0 } else { recorded_s },
            had_round,
            before: None,
        }
    }

    /// More was recorded.
    pub(super) fn recorded(&mut self, seconds: f64) {
        self.new_s += seconds;
    }

    /// Whether a round is due.
    pub(super) fn due(&self) -> Due {
        let needed = match self.had_round {
            true => self.settings.more_s,
            false => self.settings.first_s,
        };
        match self.new_s >= needed {
            true => Due::Round,
            false => Due::Recordings(needed - self.new_s),
        }
    }

    /// A round begins.
    pub(super) fn begin(&mut self) {
        self.before = Some((self.new_s, self.had_round));
        self.new_s = 0.0;
        self.had_round = true;
    }

    /// The round has failed: it is due again.
    pub(super) fn fail(&mut self) {
        if let Some((new_s, had_round)) = self.before.take() {
            self.new_s += new_s;
            self.had_round = had_round;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: ScheduleSettings = ScheduleSettings {
        first_s: 60.0,
        more_s: 30.0,
    };

    #[test]
    fn first_round_needs_more_recordings_than_later_ones() {
        let mut schedule = Schedule::new(SETTINGS, 0.0, false);
        schedule.recorded(45.0);
        assert_eq!(schedule.due(), Due::Recordings(15.0));
        schedule.recorded(15.0);
        assert_eq!(schedule.due(), Due::Round);
        schedule.begin();
        assert_eq!(schedule.due(), Due::Recordings(30.0));
        schedule.fail();
        assert_eq!(schedule.due(), Due::Round);
        schedule.begin();
        schedule.recorded(30.0);
        assert_eq!(schedule.due(), Due::Round);
    }

    #[test]
    fn recordings_before_a_restart_count() {
        assert_eq!(Schedule::new(SETTINGS, 90.0, false).due(), Due::Round);
        assert_eq!(
            Schedule::new(SETTINGS, 90.0, true).due(),
            Due::Recordings(30.0)
        );
    }
}
