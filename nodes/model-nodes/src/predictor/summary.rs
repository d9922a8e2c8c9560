//! A rollout in one line for a console: a prediction itself has thousands of numbers.

use std::{collections::BTreeMap, fmt};

use wm_motion::{actions::ActionSpace, motion::StepAction};

use wm_msgs::wm_msgs::Prediction;

use super::Doubt;

/// A shorter motion is rounding \[m or rad\].
const STILL: f64 = 1e-4;

/// A longer latency is a difference of clocks, as in a bag that is played with its own stamps \[ns\].
const LONGEST_NS: i64 = 60_000_000_000;

/// A rollout in one line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Summary {
    /// Model steps K.
    pub horizon: u32,
    /// Duration of a model step \[s\].
    pub step_s: f64,
    /// The last known ratio of each k.
    pub ratios: BTreeMap<u32, f32>,
    /// Part of the squared motion that calibrated predictions one step ahead explain; `None` if not known.
    pub explained: Option<f64>,
    /// The motion that the rollout assumes.
    pub motion: Motion,
    /// The reason not to trust the predictions.
    pub doubt: Option<Doubt>,
    /// From the capture of the observed frame until the first and the last step were ready \[s\]; `None` if the frame's clock
    /// is another one.
    pub latency_s: Option<(f64, f64)>,
}

impl Summary {
    /// Records a step that is ready.
    pub fn predicted(&mut self, prediction: &Prediction) {
        self.horizon = prediction.step;
        let ready_ns = prediction.ready_stamp.to_nanos();
        let taken_ns = ready_ns.saturating_sub(prediction.observed_stamp.to_nanos());
        let is_known = (0..=LONGEST_NS).contains(&taken_ns);
        self.latency_s = is_known.then(|| {
            let taken_s = taken_ns as f64 / 1e9;
            (
                self.latency_s.map_or(taken_s, |(first_s, _)| first_s),
                taken_s,
            )
        });
    }
}

/// The distance that the arm moves in a rollout, by unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Motion {
    lengths: BTreeMap<String, f64>,
    gripper: Option<f32>,
}

impl Motion {
    /// Of the steps of a rollout.
    pub fn of(steps: &[StepAction], space: &ActionSpace) -> Self {
        let mut motion = Self::default();
        let mut before: Option<&[f32]> = None;
        for interval in steps.iter().flat_map(|step| &step.intervals) {
            let mut squares: BTreeMap<&str, f64> = BTreeMap::new();
            for (index, (value, dimension)) in
                interval.values.iter().zip(space.dimensions()).enumerate()
            {
                if dimension.kind.is_gripper() {
                    motion.gripper = Some(*value);
                    continue;
                }
                let moved = match dimension.kind.is_delta() {
                    true => *value,
                    false => before
                        .and_then(|before| before.get(index))
                        .map_or(0.0, |before| value - before),
                };
                *squares.entry(&dimension.unit).or_default() += f64::from(moved).powi(2);
            }
            for (unit, square) in squares {
                *motion.lengths.entry(unit.to_owned()).or_default() += square.sqrt();
            }
            before = Some(&interval.values);
        }
        motion
    }
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let moves: Vec<String> = self
            .lengths
            .iter()
            .filter(|(_, length)| **length > STILL)
            .map(|(unit, length)| format!("{length:.3} {unit}"))
            .collect();
        match moves.is_empty() {
            true => f.write_str("the arm stands still")?,
            false => write!(f, "the arm moves {}", moves.join(", "))?,
        }
        match self.gripper {
            Some(opening) => write!(f, ", gripper {opening:.2}"),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (horizon, last_s) = (self.horizon, self.step_s * f64::from(self.horizon));
        write!(
            f,
            "k = 1 to {horizon}, {:.1} to {last_s:.1} s ahead | ",
            self.step_s
        )?;
        let shown = [1, horizon.div_ceil(2), horizon];
        let known = |(k, _): &(&u32, &f32)| shown.contains(*k);
        let ratios: Vec<String> = self
            .ratios
            .iter()
            .filter(known)
            .map(|(k, ratio)| format!("{ratio:.2} (k = {k})"))
            .collect();
        match ratios.is_empty() {
            true => f.write_str("error ratio not known yet")?,
            false => write!(f, "error ratio {}", ratios.join(", "))?,
        }
        if let Some(explained) = self.explained {
            write!(
                f,
                ", explains {:.0} % of the motion",
                100.0 * explained.max(0.0)
            )?;
        }
        write!(f, " | {} | ", self.motion)?;
        match &self.doubt {
            Some(doubt) => write!(f, "trust: bad, {}", doubt.in_short())?,
            None if self.ratios.contains_key(&1) => f.write_str("trust: good")?,
            None => f.write_str("trust: not known yet")?,
        }
        match self.latency_s {
            Some((first_s, last_s)) => write!(
                f,
                " | ready {:.0} ms (k = 1) to {:.0} ms (k = {horizon}) after the picture",
                1e3 * first_s,
                1e3 * last_s
            ),
            None => f.write_str(" | latency not known: the picture's clock is another one"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_motion::actions::ActionEncoding;

    fn step(values: [f32; 7]) -> StepAction {
        let encoding = ActionEncoding::default();
        let mut motion = wm_motion::motion::Motion::new(
            wm_motion::motion::MotionSettings::of_period(200_000_000),
        );
        motion.take(0, values.to_vec().into());
        let step_ns = 200_000_000 * encoding.frame_skip() as i64;
        motion.step(&encoding, 0, step_ns).unwrap()
    }

    fn summary() -> Summary {
        let steps = [step([0.03, 0.04, 0.0, 0.0, 0.0, 0.1, 1.0])];
        Summary {
            horizon: 8,
            step_s: 0.4,
            ratios: [(1, 0.314), (3, 0.4), (4, 0.5), (8, 0.81)].into(),
            explained: Some(0.69),
            motion: Motion::of(&steps, &ActionSpace::bridge()),
            doubt: None,
            latency_s: Some((0.048, 0.0954)),
        }
    }

    #[test]
    fn a_rollout_is_one_line_of_words_and_numbers() {
        assert_eq!(
            summary().to_string(),
            "k = 1 to 8, 0.4 to 3.2 s ahead | error ratio 0.31 (k = 1), 0.50 (k = 4), 0.81 (k = 8), explains 69 % of the motion | \
             the arm moves 0.100 m, \
             0.200 rad, gripper 1.00 | trust: good | ready 48 ms (k = 1) to 95 ms (k = 8) after the picture"
        );
    }

    #[test]
    fn unknown_figures_are_named() {
        let unknown = Summary {
            ratios: BTreeMap::new(),
            explained: None,
            motion: Motion::of(&[step([0.0; 7])], &ActionSpace::bridge()),
            latency_s: None,
            ..summary()
        };
        let text = unknown.to_string();
        for part in [
            "error ratio not known yet",
            "the arm stands still, gripper 0.00",
            "trust: not known yet",
            "latency not known",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let frozen = Summary {
            doubt: Some(Doubt::Frozen),
            ..summary()
        };
        assert!(
            frozen
                .to_string()
                .contains("trust: bad, the camera has stopped |")
        );
        assert!(!frozen.to_string().contains('\n'));
    }
}
