//! Times of an episode's frames.

use crate::lerobot::topics::frame_ns;

/// Tolerance of a row's `timestamp` against `frame_index / fps`, in s: LeRobot's `tolerance_s`.
const TOLERANCE_S: f64 = 1e-4;
/// Relative tolerance of the median frame period against `1 / fps`.
const RATE_SHARE: f64 = 0.2;

/// Times of frames since the first.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Timing {
    /// By frame \[ns\].
    pub stamps_ns: Vec<u64>,
    /// Differences of the frame periods from `1 / fps` \[s\]; empty if the time stamps follow the rate.
    pub jitter_s: Vec<f64>,
}

impl Timing {
    /// Frames at a constant rate.
    pub fn nominal(frames: usize, fps: f64) -> Self {
        Self {
            stamps_ns: (0..frames as u64)
                .map(|frame| frame_ns(frame, fps))
                .collect(),
            jitter_s: Vec::new(),
        }
    }

    /// From the `timestamp` of each row \[s\]: exactly at the rate, to the nanosecond, or as recorded.
    ///
    /// # Errors
    /// Time stamps do not increase, or have another rate.
    pub fn of(times_s: &[f64], fps: f64) -> Result<Self, String> {
        let begin_s = times_s.first().copied().unwrap_or(0.0);
        let is_nominal = (0u64..).zip(times_s).all(|(frame, time_s)| {
            let expected_s = frame as f64 / fps;
            // The tolerance includes the rounding of single precision.
            let rounding_s = time_s.abs() * f64::from(f32::EPSILON);
            (time_s - begin_s - expected_s).abs() <= TOLERANCE_S + rounding_s
        });
        // In single precision, a time of day is rounded to a minute.
        if is_nominal && begin_s.abs() < 1e5 {
            return Ok(Self::nominal(times_s.len(), fps));
        }
        let pairs = times_s.iter().zip(times_s.iter().skip(1));
        let mut gaps = Vec::with_capacity(times_s.len());
        for (row, (before, after)) in (1..).zip(pairs) {
            if after <= before {
                return Err(format!(
                    "row {row}: expected a time after {before} s, got {after} s; to stamp frames by the rate alone, pass \
                     --stamps rate"
                ));
            }
            gaps.push(after - before);
        }
        let mut sorted = gaps.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        // A single frame has no period: the declared rate counts.
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(fps.recip());
        if (median * fps - 1.0).abs() > RATE_SHARE {
            return Err(format!(
                "expected {:.4} s from row to row, at {fps} per second, got {median:.4} s; to stamp frames by the rate alone, \
                 pass --stamps rate",
                fps.recip()
            ));
        }
        // Exact: times of a recording are far below 2^53 ns.
        let since = |time_s: &f64| ((time_s - begin_s) * 1e9).round() as u64;
        Ok(Self {
            stamps_ns: times_s.iter().map(since).collect(),
            jitter_s: gaps.iter().map(|gap| (gap - fps.recip()).abs()).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nominal_times_are_exact_and_real_ones_are_kept() {
        let single = |times: &[f64]| {
            times
                .iter()
                .map(|t| f64::from(*t as f32))
                .collect::<Vec<_>>()
        };
        let nominal: Vec<f64> = (0..3000).map(|frame| f64::from(frame) / 30.0).collect();
        let timing = Timing::of(&single(&nominal), 30.0).unwrap();
        assert_eq!(timing, Timing::nominal(3000, 30.0));
        // An episode with a later start, as in a recording of several.
        let later: Vec<f64> = nominal.iter().map(|time| time + 12.5).collect();
        assert_eq!(Timing::of(&single(&later), 30.0).unwrap(), timing);
        let real = Timing::of(&[0.1, 0.131, 0.166, 0.352], 30.0).unwrap();
        assert_eq!(real.stamps_ns, [0, 31_000_000, 66_000_000, 252_000_000]);
        assert_eq!(real.jitter_s.len(), 3);
        assert!((real.jitter_s[2] - (0.186 - 1.0 / 30.0)).abs() < 1e-9);
    }

    #[test]
    fn unusable_times_are_rejected_by_row() {
        let error = |times: &[f64], fps| Timing::of(times, fps).unwrap_err();
        assert!(error(&[0.0, 0.03, 0.03], 30.0).contains("row 2: expected a time after 0.03 s"));
        assert!(error(&[0.0, 0.03, 0.01], 30.0).contains("row 2"));
        // A time of day in single precision.
        let day: Vec<f64> = (0..9)
            .map(|k| f64::from((1.75e9 + f64::from(k) / 30.0) as f32))
            .collect();
        assert!(error(&day, 30.0).contains("row 1"));
        assert!(error(&[0.0, 0.2, 0.4], 7.0).contains("expected 0.1429 s from row to row"));
    }
}
