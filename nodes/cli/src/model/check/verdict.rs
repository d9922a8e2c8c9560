//! Whether a model is fast enough for a camera, in words.

use std::fmt;
use std::time::Duration;

/// The nodes' default `frame_period`: a camera at 5 Hz.
const FRAME_PERIOD: Duration = Duration::from_millis(200);
/// The predictor's default `horizon` in model steps.
const HORIZON: u32 = 8;

/// What one step of each node takes here, measured alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    /// A camera frame to a latent.
    pub encode: Duration,
    /// One predicted frame; none where there is no transition model.
    pub predict: Option<Duration>,
    /// A latent to a picture; none where there is no decoder.
    pub decode: Option<Duration>,
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rate = 1.0 / FRAME_PERIOD.as_secs_f64();
        let rollout = self.predict.map(|step| step * HORIZON);
        if self.encode > FRAME_PERIOD {
            write!(
                f,
                "too slow for {rate:.0} Hz: a frame takes {} to encode, so camera frames are dropped and the history \
                 has gaps",
                seconds(self.encode)
            )?;
            if let Some(rollout) = rollout {
                // The nodes work side by side: the slower sets the pace.
                let pace = seconds(rollout.max(self.encode));
                write!(f, "; at best one rollout of {HORIZON} steps in {pace}")?;
            }
            let slower = FRAME_PERIOD.as_secs_f64() / self.encode.as_secs_f64();
            return write!(
                f,
                ". Use a smaller encoder, more cores, or a bag played at rate {:.2}",
                (slower * 100.0).floor().max(1.0) / 100.0
            );
        }
        match (self.predict, rollout) {
            (Some(step), Some(rollout)) if rollout > FRAME_PERIOD => {
                write!(
                    f,
                    "too slow for a rollout of {HORIZON} steps at each frame of {rate:.0} Hz: about one in {}. Use ",
                    seconds(rollout)
                )?;
                let fits = (FRAME_PERIOD.as_secs_f64() / step.as_secs_f64()).floor();
                match fits >= 1.0 {
                    true => write!(f, "the predictor's horizon of {fits:.0} or less, ")?,
                    false => write!(f, "a smaller transition model, ")?,
                }
                f.write_str("fewer integration_steps, or more cores")
            }
            (_, rollout) => {
                write!(
                    f,
                    "fast enough for {rate:.0} Hz: {} to encode a frame",
                    seconds(self.encode)
                )?;
                match rollout {
                    Some(rollout) => {
                        write!(f, ", {} for a rollout of {HORIZON} steps", seconds(rollout))?;
                    }
                    None => f.write_str("; encoder and decoder only, nothing is predicted")?,
                }
                match self.decode {
                    Some(decode) if decode > FRAME_PERIOD => write!(
                        f,
                        "; but a picture takes {} to decode, so most are dropped",
                        seconds(decode)
                    ),
                    _ => Ok(()),
                }
            }
        }
    }
}

/// Two digits, as nobody plans by more.
fn seconds(time: Duration) -> String {
    match time.as_secs_f64() {
        long if long >= 10.0 => format!("{long:.0} s"),
        short if short < 0.1 => format!("{:.0} ms", short * 1e3),
        time => format!("{time:.1} s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(encode: u64, predict: Option<u64>, decode: Option<u64>) -> String {
        let predict = predict.map(Duration::from_millis);
        let decode = decode.map(Duration::from_millis);
        Times {
            encode: Duration::from_millis(encode),
            predict,
            decode,
        }
        .to_string()
    }

    #[test]
    fn what_is_too_slow_says_why_and_what_to_change() {
        // Web-DINO and DiT-S on two slow cores: the encoder is what drops frames.
        let slow = verdict(1100, Some(1400), Some(2500));
        assert!(
            slow.starts_with("too slow for 5 Hz: a frame takes 1.1 s"),
            "{slow}"
        );
        assert!(slow.contains("one rollout of 8 steps in 11 s"), "{slow}");
        assert!(slow.ends_with("played at rate 0.18"), "{slow}");
        let slow = verdict(20, Some(50), Some(10));
        assert!(slow.contains("about one in 0.4 s"), "{slow}");
        assert!(slow.contains("horizon of 4 or less"), "{slow}");
        let slow = verdict(20, Some(1000), None);
        assert!(slow.contains("smaller transition model"), "{slow}");
    }

    #[test]
    fn what_is_fast_enough_says_so() {
        let fast = verdict(10, Some(20), Some(10));
        assert_eq!(
            fast,
            "fast enough for 5 Hz: 10 ms to encode a frame, 0.2 s for a rollout of 8 steps"
        );
        let fast = verdict(10, None, Some(300));
        assert!(fast.contains("encoder and decoder only"), "{fast}");
        assert!(fast.contains("0.3 s to decode"), "{fast}");
    }
}
