//! Whether a model is fast enough for a camera, as text.

use std::fmt;
use std::time::Duration;

use wm_model_nodes::cadence::{every_nth, hertz, periods, rough};
use wm_model_nodes::encoder::{Mode, Needs};

/// The predictor's default `horizon` in model steps.
const HORIZON: u32 = 8;
/// Default `context_frames` of all nodes.
const CONTEXT_FRAMES: usize = 2;
/// The decoder's default `decode_period`.
const DECODE_PERIOD: Duration = Duration::from_millis(600);

/// Durations of one step of each node, measured alone, for a camera.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// A camera frame.
    pub encode: Duration,
    /// One predicted frame; `None` without a transition model.
    pub predict: Option<Duration>,
    /// A latent; `None` without a decoder.
    pub decode: Option<Duration>,
    /// Between camera frames.
    pub frame_period: Duration,
    /// Camera frames per model step.
    pub frame_skip: usize,
}

/// A line for each part: what the nodes will do at this rate, and remedies; then a summary.
impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let needs = self.needs();
        let mode = Mode::of(self.encode, &needs);
        // the time between frames to predict from
        let frames = mode.interval(&needs);
        self.encoder(mode, &needs, f)?;
        let rollouts = match self.predict {
            Some(step) => Some(self.predictor(step, frames, f)?),
            None => None,
        };
        match (self.decode, rollouts) {
            (Some(picture), Some(rollouts)) => decoder(picture, rollouts, f)?,
            (Some(picture), None) => writeln!(f, "decoder: {} a picture", rough(picture))?,
            (None, _) => {}
        }
        let (rate, period) = (hertz(self.frame_period), self.frame_period);
        match rollouts {
            None if self.is_fast_enough() => write!(
                f,
                "fast enough for {rate}: encoder and decoder only, no predictions"
            ),
            None => write!(
                f,
                "too slow for {rate}: encoder and decoder only, no predictions"
            ),
            Some(_) if self.is_fast_enough() => {
                write!(f, "fast enough for {rate}: a prediction from every frame")
            }
            Some(rollouts) => write!(
                f,
                "too slow for {rate}: a prediction every {}, from {}; each part was measured alone, and the nodes share \
                 this machine",
                rough(rollouts),
                every_nth(periods(rollouts, period), "frame"),
            ),
        }
    }
}

impl Times {
    fn needs(&self) -> Needs {
        Needs {
            frame_period: self.frame_period,
            frame_skip: self.frame_skip,
            context_frames: CONTEXT_FRAMES,
        }
    }

    /// Whether every frame is predicted from, or encoded if there is no transition model.
    #[must_use]
    pub fn is_fast_enough(&self) -> bool {
        let needs = self.needs();
        let frames = Mode::of(self.encode, &needs).interval(&needs);
        let between = self
            .predict
            .map_or(frames, |step| between_rollouts(step, frames));
        between <= self.frame_period
    }

    fn encoder(&self, mode: Mode, needs: &Needs, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "encoder: {} a frame: {}",
            rough(self.encode),
            mode.in_words(needs)
        )?;
        if mode > Mode::All {
            let slower = self.frame_period.as_secs_f64() / self.encode.as_secs_f64();
            write!(
                f,
                "; for more: a smaller encoder, a faster processor, or a bag played at rate {:.2}",
                (slower * 100.0).floor().max(1.0) / 100.0
            )?;
        }
        writeln!(f)
    }

    /// Returns the time between rollouts, for frames to predict from that arrive every `frames`.
    fn predictor(
        &self,
        step: Duration,
        frames: Duration,
        f: &mut fmt::Formatter<'_>,
    ) -> Result<Duration, fmt::Error> {
        let rollout = step * HORIZON;
        let nth = periods(rollout, frames);
        let what = match frames > self.frame_period {
            true => "frame that it can predict from",
            false => "frame",
        };
        write!(
            f,
            "predictor: {} for a prediction of {HORIZON} steps: {} is used",
            rough(rollout),
            every_nth(nth, what)
        )?;
        if nth > 1 {
            f.write_str("; for more: ")?;
            let fits = (frames.as_secs_f64() / step.as_secs_f64()).floor();
            match fits >= 1.0 {
                true => write!(f, "a horizon of {fits:.0} or less, ")?,
                false => write!(f, "a smaller transition model, ")?,
            }
            f.write_str("fewer integration_steps, or a faster processor")?;
        }
        writeln!(f)?;
        Ok(between_rollouts(step, frames))
    }
}

/// The time between rollouts, for frames to predict from every `frames` and `step` per predicted frame.
fn between_rollouts(step: Duration, frames: Duration) -> Duration {
    frames * periods(step * HORIZON, frames)
}

/// The decoder's line, for rollouts that begin `rollouts` apart.
fn decoder(picture: Duration, rollouts: Duration, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    // as the node does: every nth rollout, at least a period apart
    let due = rollouts * periods(DECODE_PERIOD, rollouts);
    let pictures = picture * HORIZON;
    let nth = periods(pictures, due);
    write!(
        f,
        "decoder: {} a picture: the {HORIZON} of a rollout every {}",
        rough(picture),
        rough(due * nth)
    )?;
    if nth > 1 {
        f.write_str(
            "; for more: decode fewer of its steps (parameter steps), or a faster processor",
        )?;
    }
    writeln!(f)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(encode: u64, predict: Option<u64>, decode: Option<u64>) -> String {
        let milliseconds = Duration::from_millis;
        Times {
            encode: milliseconds(encode),
            predict: predict.map(milliseconds),
            decode: decode.map(milliseconds),
            frame_period: milliseconds(200),
            frame_skip: 2,
        }
        .to_string()
    }

    fn lines(text: &str) -> Vec<&str> {
        text.lines().collect()
    }

    #[test]
    fn slow_models_are_reported_with_consequences_and_remedies() {
        // Web-DINO and DiT-S on two slow cores
        let slow = verdict(1100, Some(1400), Some(2500));
        assert_eq!(
            lines(&slow),
            [
                "encoder: 1.1 s a frame: 2 of every 12 frames are used, those of a context, 0.4 s apart; for more: a \
                 smaller encoder, a faster processor, or a bag played at rate 0.18",
                "predictor: 11 s for a prediction of 8 steps: every 5th frame that it can predict from is used; for \
                 more: a horizon of 1 or less, fewer integration_steps, or a faster processor",
                "decoder: 2.5 s a picture: the 8 of a rollout every 24 s; for more: decode fewer of its steps \
                 (parameter steps), or a faster processor",
                "too slow for 5 Hz: a prediction every 12 s, from every 60th frame; each part was measured alone, and \
                 the nodes share this machine",
            ]
        );
        let slow = verdict(20, Some(50), Some(10));
        assert!(slow.contains("every 2nd frame is used"), "{slow}");
        assert!(slow.contains("horizon of 4 or less"), "{slow}");
        assert!(slow.contains("a prediction every 0.4 s"), "{slow}");
        let slow = verdict(20, Some(1000), None);
        assert!(slow.contains("smaller transition model"), "{slow}");
    }

    #[test]
    fn fast_models_are_reported_as_fast_enough() {
        let fast = verdict(10, Some(20), Some(10));
        assert_eq!(
            lines(&fast),
            [
                "encoder: 10 ms a frame: every frame is used",
                "predictor: 0.2 s for a prediction of 8 steps: every frame is used",
                "decoder: 10 ms a picture: the 8 of a rollout every 0.6 s",
                "fast enough for 5 Hz: a prediction from every frame",
            ]
        );
        let fast = verdict(10, None, Some(300));
        assert!(fast.contains("encoder and decoder only"), "{fast}");
        assert!(fast.contains("decoder: 0.3 s a picture\n"), "{fast}");
    }
}
