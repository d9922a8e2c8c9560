//! Whether the predictions can be trusted, measured while they are made.

use std::{collections::VecDeque, fmt};

use wm_msgs::wm_msgs::PredictionError;

use crate::history::{CameraStep, Frame};

/// The span that is judged \[ns\]: longer than a pause in the motion, or a hand before the camera.
const SPAN_NS: i64 = 5_000_000_000;
/// Fewest frames or errors in that span for a judgement.
const LEAST: usize = 8;
/// Latents are normalised over the training data: of normally distributed values, 0.3 % lie beyond so many standard
/// deviations.
const FAR: f32 = 3.0;
/// Part of the values beyond that at which pictures are unlike the training's. The bundled model's latents have 0.3 to
/// 1.8 % on pictures of the simulated arm (21 scenes), and 0.9 to 4 % on real ones (seven episodes of Bridge V2, five of them
/// above 2 %; single frames up to 13 %).
pub const UNLIKE: f32 = 0.02;
/// Squared latent change, normalised, below which nothing moves, so that holding still cannot be beaten.
const STILL: f64 = 1e-3;

/// A reason to doubt the predictions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doubt {
    /// The camera's clock has stepped: frames and actions may be of different moments.
    CameraClock(CameraStep),
    /// The camera has stopped: its still picture is predicted well, but is outdated.
    Frozen,
    /// The pictures are unlike those of the model's training.
    UnlikeTraining {
        /// Part of the latents' values that are far from the training's.
        part: f32,
    },
    /// The persistence baseline is as close to the real frames as the predictions are.
    NoBetterThanPersistence {
        /// Squared latent error of the first step over that of the persistence baseline.
        ratio: f64,
    },
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CameraClock(step) => write!(f, "{step}"),
            Self::Frozen => f.write_str(
                "the camera has stopped: the predictions start from an outdated picture (the reason is on \
                 /wm/camera_state and on /diagnostics)",
            ),
            Self::UnlikeTraining { part } => write!(
                f,
                "the camera shows pictures unlike those that the model was trained on ({:.1} % of the latent's values \
                 lie beyond 3 standard deviations, where a normal distribution has 0.3 %): predictions and plans are \
                 not meaningful; use a model that was trained on such pictures (parameter model)",
                100.0 * part
            ),
            Self::NoBetterThanPersistence { ratio } => write!(
                f,
                "before calibration, the predictions are no better than the persistence baseline, the last frame repeated (squared latent \
                 error {ratio:.2} times as large, over the last seconds): check the model, and that the actions are \
                 those of this robot and stamped like its images"
            ),
        }
    }
}

impl Doubt {
    /// In a few words.
    pub fn in_short(&self) -> &'static str {
        match self {
            Self::CameraClock(_) => "the camera's clock has stepped",
            Self::Frozen => "the camera has stopped",
            Self::UnlikeTraining { .. } => "the pictures are unlike the training's",
            Self::NoBetterThanPersistence { .. } => "no better than the persistence baseline",
        }
    }
}

/// Part of a latent's values that are far from the training's: more than [`UNLIKE`] of them, and the picture is unlike those
/// that the model was trained on.
pub fn part_far_out(values: &[f32]) -> f32 {
    let far = values.iter().filter(|value| value.abs() > FAR).count();
    far as f32 / values.len().max(1) as f32
}

/// Figures of the predictions' quality over the last seconds.
#[derive(Clone, Debug, Default)]
pub struct Trust {
    /// Stamp, and the part of values that are far out.
    frames: VecDeque<(i64, f32)>,
    /// Stamp, error and persistence error of first steps.
    errors: VecDeque<(i64, f64, f64)>,
    /// Whether the camera had stopped by the newest frame.
    is_frozen: bool,
}

impl Trust {
    /// Records an observed latent.
    pub fn seen(&mut self, frame: &Frame) {
        self.is_frozen = frame.is_frozen;
        self.frames
            .push_back((frame.stamp_ns, part_far_out(&frame.values)));
        forget(&mut self.frames, |(stamp_ns, _)| *stamp_ns);
    }

    /// Records the error of a prediction, whose mean square is `raw` before calibration; only first steps count, at which a
    /// model is best.
    pub fn scored(&mut self, error: &PredictionError, raw: f64) {
        if error.step != 1 {
            return;
        }
        let stamp_ns = error.header.stamp.to_nanos();
        let squares = (raw, error.persistence_mse.into());
        self.errors.push_back((stamp_ns, squares.0, squares.1));
        forget(&mut self.errors, |(stamp_ns, ..)| *stamp_ns);
    }

    /// Reasons to doubt the predictions of the last seconds, causes before effects.
    pub fn doubt(&self) -> Option<Doubt> {
        if self.is_frozen {
            return Some(Doubt::Frozen);
        }
        if let Some(part) = self.far().filter(|part| *part > UNLIKE) {
            return Some(Doubt::UnlikeTraining { part });
        }
        let is_moving = self.still() / self.errors.len() as f64 > STILL;
        let ratio = self.ratio().filter(|_| is_moving)?;
        // NaN is no better either.
        let is_better = ratio < 1.0;
        (!is_better).then_some(Doubt::NoBetterThanPersistence { ratio })
    }

    /// Mean part of the values that are far out; `None` before enough frames have arrived.
    pub fn far(&self) -> Option<f32> {
        let count = self.frames.len();
        let sum: f32 = self.frames.iter().map(|(_, part)| part).sum();
        (count >= LEAST).then(|| sum / count as f32)
    }

    /// Squared error of the first steps over that of the persistence baseline; `None` before enough are scored.
    pub fn ratio(&self) -> Option<f64> {
        let error: f64 = self.errors.iter().map(|(_, error, _)| error).sum();
        (self.errors.len() >= LEAST).then(|| error / self.still())
    }

    /// Sum of the persistence errors.
    fn still(&self) -> f64 {
        self.errors.iter().map(|(.., still)| still).sum()
    }

    /// Clears the figures, because another history begins.
    pub fn clear(&mut self) {
        self.frames.clear();
        self.errors.clear();
        self.is_frozen = false;
    }
}

fn forget<T>(all: &mut VecDeque<T>, stamp_ns: impl Fn(&T) -> i64) {
    let Some(newest_ns) = all.back().map(&stamp_ns) else {
        return;
    };
    let is_old = |first: &T| stamp_ns(first) < newest_ns.saturating_sub(SPAN_NS);
    while all.front().is_some_and(&is_old) {
        all.pop_front();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Instant;

    use wm_msgs::{builtin_interfaces::Time, std_msgs::Header};
    use wm_ros::PublisherId;

    use super::*;
    use crate::history::Reception;

    const PERIOD: i64 = 200_000_000;

    fn frame(index: i64, far: usize) -> Frame {
        let mut values = vec![0.5; 100];
        values.iter_mut().take(far).for_each(|value| *value = -4.0);
        Frame {
            stamp_ns: index * PERIOD,
            frame_id: "camera".into(),
            values: values.into(),
            is_frozen: false,
            reception: Reception {
                stamp: Time::default(),
                clock_step_ns: 0,
                at: Instant::now(),
                publisher: PublisherId::default(),
            },
        }
    }

    fn error(index: i64, mse: f32, persistence_mse: f32) -> PredictionError {
        PredictionError {
            header: Header {
                stamp: Time::from_nanos(index * PERIOD),
                ..Header::default()
            },
            step: 1,
            mse,
            persistence_mse,
            ..PredictionError::default()
        }
    }

    fn score(trust: &mut Trust, error: PredictionError) {
        trust.scored(&error, error.mse.into());
    }

    #[test]
    fn figures_are_known_after_seconds_and_cleared_with_the_history() {
        let mut trust = Trust::default();
        for index in 0..7 {
            trust.seen(&frame(index, 50));
            score(&mut trust, error(index, 0.25, 0.5));
        }
        assert_eq!((trust.far(), trust.ratio()), (None, None));
        trust.seen(&frame(7, 50));
        score(&mut trust, error(7, 0.25, 0.5));
        assert_eq!((trust.far(), trust.ratio()), (Some(0.5), Some(0.5)));
        trust.clear();
        assert_eq!((trust.far(), trust.ratio()), (None, None));
    }

    #[test]
    fn pictures_unlike_the_trainings_are_reported_after_seconds() {
        let mut trust = Trust::default();
        for index in 0..7 {
            trust.seen(&frame(index, 6));
            assert_eq!(trust.doubt(), None);
        }
        trust.seen(&frame(7, 6));
        let text = trust.doubt().unwrap().to_string();
        assert!(text.contains("6.0 % of the latent"), "{text}");
        for index in 8..60 {
            trust.seen(&frame(index, 0));
        }
        assert_eq!(trust.doubt(), None, "the span is over");
        assert!(trust.frames.len() <= 26);
    }

    #[test]
    fn a_stopped_camera_is_doubted_until_it_shows_something_new() {
        let mut trust = Trust::default();
        for index in 0..200 {
            trust.seen(&Frame {
                is_frozen: true,
                ..frame(index, 0)
            });
            // Nothing moves, and it is predicted well.
            score(&mut trust, error(index, 0.0, 0.0));
            assert_eq!(trust.doubt(), Some(Doubt::Frozen));
        }
        let text = Doubt::Frozen.to_string();
        assert!(text.contains("the camera has stopped"), "{text}");
        trust.seen(&frame(200, 0));
        assert_eq!(trust.doubt(), None);
    }

    #[test]
    fn predictions_no_better_than_the_last_frame_are_reported() {
        let doubt = |mse, persistence_mse| {
            let mut trust = Trust::default();
            (0..20).for_each(|index| score(&mut trust, error(index, mse, persistence_mse)));
            trust.doubt()
        };
        assert_eq!(doubt(0.2, 0.5), None);
        assert_eq!(doubt(2e-4, 1e-4), None, "nothing moves");
        let text = doubt(0.6, 0.5).unwrap().to_string();
        assert!(text.contains("1.20 times"), "{text}");
        assert!(doubt(f32::NAN, 0.5).is_some());
        let mut later = Trust::default();
        for index in 0..20 {
            let second = PredictionError {
                step: 2,
                ..error(index, 0.6, 0.5)
            };
            score(&mut later, second);
        }
        assert_eq!(later.doubt(), None, "only the first step is judged");
    }
}
