//! Taps and channels that are summed before the next ones.

/// A part of the taps of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Taps {
    /// The first row of taps, and how many.
    pub(super) tap_row: usize,
    pub(super) tap_rows: usize,
    /// The first value in a row of taps, and how many.
    pub(super) start: usize,
    pub(super) run: usize,
}

impl Taps {
    /// Cuts `tap_rows` rows of `run` values into parts of about `most` values: whole rows of taps, or pieces of one, of
    /// whole groups of `group`.
    pub(super) fn all((tap_rows, run): (usize, usize), most: usize, group: usize) -> Vec<Self> {
        if tap_rows * run <= most {
            return vec![Self {
                tap_row: 0,
                tap_rows,
                start: 0,
                run,
            }];
        }
        let groups = run / group;
        let pieces = run.div_ceil(most).min(groups);
        let rows = (0..tap_rows).flat_map(|tap_row| {
            (0..pieces).map(move |i| {
                let (start, end) = (
                    groups * i / pieces * group,
                    groups * (i + 1) / pieces * group,
                );
                Self {
                    tap_row,
                    tap_rows: 1,
                    start,
                    run: end - start,
                }
            })
        });
        rows.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_every_tap_and_channel_once() {
        for (taps, most, group) in [
            ((3, 9), 27, 1),
            ((3, 9), 26, 1),
            ((3, 9), 4, 1),
            ((1, 5), 2, 1),
            ((3, 10), 4, 2),
            ((3, 12), 1, 4),
        ] {
            let mut seen = vec![0; taps.0 * taps.1];
            for part in Taps::all(taps, most, group) {
                assert!(part.start % group == 0 && part.run % group == 0, "{part:?}");
                for row in part.tap_row..part.tap_row + part.tap_rows {
                    for at in part.start..part.start + part.run {
                        seen[row * taps.1 + at] += 1;
                    }
                }
            }
            assert!(seen.iter().all(|count| *count == 1), "{taps:?} {most}");
        }
    }
}
