use std::ops::Range;

/// Speed of a process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Batches that it computes at once.
    pub threads: usize,
    /// Time to compute that many \[s\].
    pub round: f64,
    /// Time for all transfers of a step \[s\].
    pub transfer: f64,
}

/// Measured times of some batches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Number of batches.
    pub batches: usize,
    /// Time to compute them \[s\].
    pub computation: f64,
    /// Time for all transfers \[s\].
    pub transfer: f64,
}

impl Pace {
    /// The pace of a first measurement.
    pub fn first(threads: usize, measured: Measurement) -> Self {
        let rounds = measured.batches.div_ceil(threads.max(1)).max(1);
        Self {
            threads,
            round: measured.computation / rounds as f64,
            transfer: measured.transfer,
        }
    }

    /// Takes a further measurement into account.
    pub fn and(self, measured: Measurement) -> Self {
        let newest = Self::first(self.threads, measured);
        Self {
            // Half of the weight on the newest: a machine that becomes busy loses its share after few steps.
            round: 0.5 * (self.round + newest.round),
            transfer: 0.5 * (self.transfer + newest.transfer),
            ..self
        }
    }

    /// Expected time for `batches` batches \[s\].
    pub fn time(self, batches: usize) -> f64 {
        let rounds = batches.div_ceil(self.threads.max(1));
        self.transfer + rounds as f64 * self.round
    }
}

/// Splits `count` batches among processes, so that the last one ends early. Greater shares come first, so that few sums
/// are sent; shares may be empty.
pub fn shares(count: usize, paces: &[Pace]) -> Vec<Range<usize>> {
    let mut sizes = vec![0; paces.len()];
    for _ in 0..count {
        let next = sizes.iter_mut().zip(paces);
        let next = next.min_by(|(a, pace_a), (b, pace_b)| {
            pace_a.time(**a + 1).total_cmp(&pace_b.time(**b + 1))
        });
        if let Some((size, _)) = next {
            *size += 1;
        }
    }
    let mut by_size: Vec<(usize, usize)> = sizes.into_iter().enumerate().collect();
    by_size.sort_by_key(|(_, size)| std::cmp::Reverse(*size));
    let mut ranges = vec![0..0; paces.len()];
    let mut start = 0;
    for (process, size) in by_size {
        if let Some(range) = ranges.get_mut(process) {
            *range = start..start + size;
        }
        start += size;
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(threads: usize, round: f64) -> Pace {
        let transfer = 0.0;
        Pace {
            threads,
            round,
            transfer,
        }
    }

    #[test]
    fn fast_processes_get_more_and_slow_ones_nothing() {
        let equal = [pace(1, 1.0), pace(1, 1.0)];
        assert_eq!(shares(4, &equal), [0..2, 2..4]);
        assert_eq!(shares(4, &[pace(1, 1.0), pace(3, 1.1)]), [3..4, 0..3]);
        assert_eq!(shares(4, &[pace(2, 1.0), pace(1, 9.0)]), [0..4, 4..4]);
        assert_eq!(shares(3, &[pace(1, 1.0)]).pop(), Some(0..3));
        // Noise of a third does not move equal shares.
        assert_eq!(shares(4, &[pace(1, 1.0), pace(1, 1.3)]), [0..2, 2..4]);
        // Transfers count once, for any number of batches.
        let far = Pace {
            transfer: 2.5,
            ..pace(1, 1.0)
        };
        assert_eq!(shares(4, &[pace(1, 1.0), far]), [0..3, 3..4]);
        assert_eq!(shares(12, &[pace(1, 1.0), far]), [0..7, 7..12]);
    }

    #[test]
    fn measurements_are_per_round() {
        let measured = Measurement {
            batches: 3,
            computation: 4.0,
            transfer: 1.0,
        };
        let expected = Pace {
            transfer: 0.5,
            ..pace(2, 1.5)
        };
        assert_eq!(pace(2, 1.0).and(measured), expected);
        assert_eq!(Pace::first(2, measured).time(4), 5.0);
    }
}
