//! When messages were logged: the stretches of time that they cover, the gaps between those, and steps back.

/// A pause between messages that is longer than this is a gap \[ns\].
pub(crate) const GAP_NS: u64 = 10_000_000_000;
/// Messages that are further from all others than this are not part of the recording \[ns\]: a stamp of zero, or a clock
/// that was not set.
const APART_NS: u64 = 86_400_000_000_000;
/// Between these times a robot's clock is set \[ns\].
const YEAR_2000_NS: u64 = 946_684_800_000_000_000;
const YEAR_2100_NS: u64 = 4_102_444_800_000_000_000;
/// Stretches that are kept; with more, the smallest gaps between them are forgotten.
const MOST_STRETCHES: usize = 4096;

/// Messages that follow each other without a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// Log times of the first and the last message \[ns\].
    pub start_ns: u64,
    pub end_ns: u64,
    pub messages: u64,
}

/// A step back of the log times, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StepBack {
    pub from_ns: u64,
    pub to_ns: u64,
}

/// The log times of messages, as they were written one after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Times {
    /// Behind the open one; in no order.
    closed: Vec<Stretch>,
    open: Option<Stretch>,
    /// 0 stands for [`GAP_NS`].
    forgotten_ns: u64,
    first_ns: Option<u64>,
    /// The latest log time since the last step.
    latest_ns: u64,
    steps: u64,
    first_step: Option<StepBack>,
}

impl Times {
    /// Takes the next message.
    pub fn push(&mut self, log_time_ns: u64) {
        self.step_to(log_time_ns, log_time_ns);
        let gap_ns = self.gap_ns();
        match &mut self.open {
            Some(open)
                if log_time_ns.saturating_add(gap_ns) >= open.start_ns
                    && log_time_ns <= open.end_ns.saturating_add(gap_ns) =>
            {
                open.start_ns = open.start_ns.min(log_time_ns);
                open.end_ns = open.end_ns.max(log_time_ns);
                open.messages += 1;
            }
            open => {
                let next = Stretch {
                    start_ns: log_time_ns,
                    end_ns: log_time_ns,
                    messages: 1,
                };
                self.closed.extend(open.replace(next));
                if self.closed.len() > MOST_STRETCHES {
                    self.forget();
                }
            }
        }
    }

    /// Takes the messages of the next file.
    pub fn append(&mut self, next: &Self) {
        if let Some(first_ns) = next.first_ns {
            self.step_to(first_ns, next.latest_ns);
        }
        self.steps += next.steps;
        self.first_step = self.first_step.or(next.first_step);
        self.closed.extend(&next.closed);
        self.closed.extend(next.open);
        self.forgotten_ns = self.forgotten_ns.max(next.forgotten_ns);
        if self.closed.len() > MOST_STRETCHES {
            self.forget();
        }
    }

    fn gap_ns(&self) -> u64 {
        self.forgotten_ns.max(GAP_NS)
    }

    /// Goes on with messages from one log time to another.
    fn step_to(&mut self, first_ns: u64, latest_ns: u64) {
        let is_first = self.first_ns.is_none();
        self.first_ns.get_or_insert(first_ns);
        if !is_first && first_ns.saturating_add(GAP_NS) < self.latest_ns {
            self.steps += 1;
            self.first_step.get_or_insert(StepBack {
                from_ns: self.latest_ns,
                to_ns: first_ns,
            });
            self.latest_ns = latest_ns;
        } else {
            self.latest_ns = self.latest_ns.max(latest_ns);
        }
    }

    /// Merges stretches until there are few again.
    fn forget(&mut self) {
        while self.closed.len() > MOST_STRETCHES / 2 {
            self.closed = merged(std::mem::take(&mut self.closed), self.gap_ns());
            if self.closed.len() > MOST_STRETCHES / 2 {
                self.forgotten_ns = self.gap_ns().saturating_mul(2);
            }
        }
    }

    /// The stretches in order, with gaps between them.
    pub fn stretches(&self) -> Vec<Stretch> {
        let all = self.closed.iter().copied().chain(self.open);
        merged(all.collect(), self.gap_ns())
    }

    /// How often the log times step back by more than a gap, and the first such step.
    pub fn steps_back(&self) -> (u64, Option<StepBack>) {
        (self.steps, self.first_step)
    }
}

/// The stretches in order, those merged that are no further from each other than this.
fn merged(mut stretches: Vec<Stretch>, gap_ns: u64) -> Vec<Stretch> {
    stretches.sort_by_key(|stretch| stretch.start_ns);
    let mut all: Vec<Stretch> = Vec::new();
    for next in stretches {
        match all.last_mut() {
            Some(last) if next.start_ns <= last.end_ns.saturating_add(gap_ns) => {
                last.end_ns = last.end_ns.max(next.end_ns);
                last.messages += next.messages;
            }
            _ => all.push(next),
        }
    }
    all
}

/// The recording itself: of the parts that are more than a day from each other, the one with the most messages. Gives the
/// part, and the messages that are not in it.
pub(crate) fn main_part(stretches: &[Stretch]) -> Option<(Stretch, u64)> {
    let total: u64 = stretches.iter().map(|stretch| stretch.messages).sum();
    let parts = merged(stretches.to_vec(), APART_NS);
    // Of two with as many, the one of a clock that was set.
    let is_set = |part: &Stretch| part.start_ns >= YEAR_2000_NS && part.end_ns <= YEAR_2100_NS;
    let main = parts
        .into_iter()
        .max_by_key(|part| (part.messages, is_set(part)))?;
    Some((main, total - main.messages))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const S: u64 = 1_000_000_000;
    const T0: u64 = 1_750_000_000 * S;

    fn of(times: &[u64]) -> Times {
        let mut all = Times::default();
        times.iter().for_each(|time| all.push(*time));
        all
    }

    #[test]
    fn late_messages_are_neither_gap_nor_step() {
        let times = of(&[T0 + 5 * S, T0, T0 + 3 * S, T0 + 9 * S]);
        let whole = Stretch {
            start_ns: T0,
            end_ns: T0 + 9 * S,
            messages: 4,
        };
        assert_eq!(times.stretches(), [whole]);
        assert_eq!(times.steps_back(), (0, None));
    }

    #[test]
    fn a_clock_that_is_set_back_is_a_step_and_a_gap() {
        let back = T0 - 7200 * S;
        let times = of(&[T0, T0 + S, back, back + S, back + 2 * S]);
        assert_eq!(times.stretches().len(), 2);
        let step = StepBack {
            from_ns: T0 + S,
            to_ns: back,
        };
        assert_eq!(times.steps_back(), (1, Some(step)));
        // The same in two files.
        let mut files = of(&[T0, T0 + S]);
        files.append(&of(&[back, back + S, back + 2 * S]));
        assert_eq!(files.stretches(), times.stretches());
        assert_eq!(files.steps_back(), times.steps_back());
    }

    #[test]
    fn the_recording_is_where_most_messages_are() {
        for outlier in [0, u64::MAX] {
            let times = of(&[outlier, T0, T0 + S, T0 + 100 * S]);
            let (main, others) = main_part(&times.stretches()).unwrap();
            assert_eq!((main.start_ns, main.end_ns, others), (T0, T0 + 100 * S, 1));
        }
        for outlier in [0, u64::MAX] {
            let (main, _) = main_part(&of(&[outlier, T0]).stretches()).unwrap();
            assert_eq!(main.start_ns, T0, "of two with one message each");
        }
        assert_eq!(main_part(&[]), None);
    }

    #[test]
    fn many_gaps_take_no_more_memory_than_some() {
        let mut times = Times::default();
        (0..100_000).for_each(|number| times.push(number * 11 * S));
        assert!(times.closed.len() <= MOST_STRETCHES);
        let messages: u64 = times.stretches().iter().map(|s| s.messages).sum();
        assert_eq!(messages, 100_000);
    }

    proptest! {
        /// The order in which messages were written changes the steps, never the stretches.
        #[test]
        fn stretches_depend_on_no_order(times in prop::collection::vec(0u64..200, 1..40), turn in 0usize..40) {
            let mut turned: Vec<u64> = times.iter().map(|s| s * S).collect();
            let straight = of(&turned).stretches();
            let turn = turn % turned.len();
            turned.rotate_left(turn);
            prop_assert_eq!(of(&turned).stretches(), straight.clone());
            for pair in straight.windows(2) {
                prop_assert!(pair[1].start_ns - pair[0].end_ns > GAP_NS);
            }
        }
    }
}
