//! Log times of messages: continuous stretches, gaps and backward steps.

/// A longer pause between messages is a gap \[ns\].
pub(crate) const GAP_NS: u64 = 10_000_000_000;
/// Messages further than this from all others have an invalid stamp and are not part of the recording \[ns\].
const APART_NS: u64 = 86_400_000_000_000;
/// A clock outside these times is not set \[ns\].
const YEAR_2000_NS: u64 = 946_684_800_000_000_000;
const YEAR_2100_NS: u64 = 4_102_444_800_000_000_000;
/// Limit of stretches; beyond it, those with the smallest gaps between them are merged.
const MOST_STRETCHES: usize = 4096;

/// Messages without a gap between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// Log times of the earliest and the latest message \[ns\].
    pub start_ns: u64,
    pub end_ns: u64,
    pub messages: u64,
}

/// A backward step of the log times, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StepBack {
    pub from_ns: u64,
    pub to_ns: u64,
}

/// The log times of messages, in the order of writing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Times {
    /// Finished stretches, unsorted.
    closed: Vec<Stretch>,
    open: Option<Stretch>,
    /// The largest gap that was merged; 0 if none \[ns\].
    forgotten_ns: u64,
    first_ns: Option<u64>,
    /// The latest log time since the last backward step.
    latest_ns: u64,
    steps: u64,
    first_step: Option<StepBack>,
}

impl Times {
    /// Adds the next message.
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
                    self.merge_closed();
                }
            }
        }
    }

    /// Adds the messages of the next file.
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
            self.merge_closed();
        }
    }

    fn gap_ns(&self) -> u64 {
        self.forgotten_ns.max(GAP_NS)
    }

    /// Continues with messages between these log times.
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

    /// Merges stretches until half the limit remains.
    fn merge_closed(&mut self) {
        while self.closed.len() > MOST_STRETCHES / 2 {
            self.closed = merge(std::mem::take(&mut self.closed), self.gap_ns());
            if self.closed.len() > MOST_STRETCHES / 2 {
                self.forgotten_ns = self.gap_ns().saturating_mul(2);
            }
        }
    }

    /// The stretches, sorted.
    pub fn stretches(&self) -> Vec<Stretch> {
        let all = self.closed.iter().copied().chain(self.open);
        merge(all.collect(), self.gap_ns())
    }

    /// The number of backward steps larger than a gap, and the first of them.
    pub fn steps_back(&self) -> (u64, Option<StepBack>) {
        (self.steps, self.first_step)
    }
}

/// Sorts stretches, and merges those with at most this gap between them.
fn merge(mut stretches: Vec<Stretch>, gap_ns: u64) -> Vec<Stretch> {
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

/// The recording itself: the part with the most messages among parts more than a day apart. Returns the part and the
/// number of messages outside it.
pub(crate) fn find_main_part(stretches: &[Stretch]) -> Option<(Stretch, u64)> {
    let total: u64 = stretches.iter().map(|stretch| stretch.messages).sum();
    let parts = merge(stretches.to_vec(), APART_NS);
    // On a tie, the part with a set clock wins.
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
    fn late_message_is_neither_gap_nor_step() {
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
    fn backward_clock_step_is_a_step_and_a_gap() {
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
    fn recording_is_the_part_with_most_messages() {
        for outlier in [0, u64::MAX] {
            let times = of(&[outlier, T0, T0 + S, T0 + 100 * S]);
            let (main, others) = find_main_part(&times.stretches()).unwrap();
            assert_eq!((main.start_ns, main.end_ns, others), (T0, T0 + 100 * S, 1));
        }
        for outlier in [0, u64::MAX] {
            let (main, _) = find_main_part(&of(&[outlier, T0]).stretches()).unwrap();
            assert_eq!(main.start_ns, T0, "of two with one message each");
        }
        assert_eq!(find_main_part(&[]), None);
    }

    #[test]
    fn many_gaps_take_bounded_memory() {
        let mut times = Times::default();
        (0..100_000).for_each(|number| times.push(number * 11 * S));
        assert!(times.closed.len() <= MOST_STRETCHES);
        let messages: u64 = times.stretches().iter().map(|s| s.messages).sum();
        assert_eq!(messages, 100_000);
    }

    proptest! {
        /// The order of writing changes the steps, never the stretches.
        #[test]
        fn stretches_do_not_depend_on_order(times in prop::collection::vec(0u64..200, 1..40), turn in 0usize..40) {
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
