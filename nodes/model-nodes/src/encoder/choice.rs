//! The choice of frames, for an encoder that is slower than the camera.

use std::time::{Duration, Instant};

use wm_motion::motion::Pace;

use crate::cadence::{Arrivals, OPEN, Recent, every_nth, hertz, rough};

/// Advice for a higher rate.
const FASTER: &str = "for more: a smaller encoder, or a faster processor";
/// The longest of the last runs times this must fit before more frames are taken.
const MARGIN: f64 = 1.1;
/// A machine that starts loads other models too: a time measured then counts only if it takes this many periods.
const BELIEVED_PERIODS: u32 = 2;
/// A stamp this far behind the newest means that time jumped, or that the newest was wrong \[ns\].
const JUMP_NS: i64 = 1_000_000_000;

/// The frames that predicting nodes need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// From one camera frame to the next, as the model counts them.
    pub frame_period: Duration,
    /// Camera frames of a model step.
    pub frame_skip: usize,
    /// Frames that a prediction starts from, one model step apart.
    pub context_frames: usize,
}

impl Needs {
    /// One model step.
    pub fn step(&self) -> Duration {
        // A skip is a handful of frames.
        self.frame_period * self.frame_skip.max(1) as u32
    }

    fn context(&self) -> u32 {
        // The parameter's range is 1 to 64.
        self.context_frames.max(1) as u32
    }
}

/// Which frames are encoded. Each mode takes less time than the one before, and each yields complete contexts: a prediction
/// starts from frames one model step apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mode {
    /// Every camera frame.
    All,
    /// One in so many frame periods, a divisor of those of a model step.
    Every(usize),
    /// All frames of one context, once in so many model steps.
    Contexts(usize),
}

impl Mode {
    /// The first mode in which encoding keeps up, if it takes `taken` per frame and frames arrive `gap` apart. `pace`
    /// is real time per time of the stamps; a bag may be played slower or faster.
    fn fitting(taken: Duration, gap: Duration, pace: f64, needs: &Needs) -> Self {
        if taken <= gap {
            return Self::All;
        }
        let skip = needs.frame_skip.max(1);
        let spaced = |frames: usize| {
            // A skip is a handful of frames.
            let period = (needs.frame_period * frames as u32).mul_f64(pace);
            period.max(gap)
        };
        let divisors = (1..=skip).filter(|frames| skip.is_multiple_of(*frames));
        for frames in divisors {
            if taken <= spaced(frames) {
                return Self::Every(frames);
            }
        }
        let steps = (taken * needs.context()).as_secs_f64() / spaced(skip).as_secs_f64();
        // Less what rounding adds. A cast saturates.
        let steps = (steps - 1e-6).ceil() as usize;
        Self::Contexts(steps.max(needs.context_frames.max(1) + 1))
    }

    /// The mode for a camera at the model's rate.
    pub fn of(taken: Duration, needs: &Needs) -> Self {
        Self::fitting(taken, needs.frame_period, 1.0, needs)
    }

    /// From one whole context to the next, for a camera at the model's rate.
    pub fn interval(self, needs: &Needs) -> Duration {
        // Counts of frames and steps are small.
        match self {
            Self::All => needs.frame_period,
            Self::Every(frames) => needs.frame_period * frames as u32,
            Self::Contexts(steps) => needs.step() * steps as u32,
        }
    }

    /// Which camera frames are encoded, in words.
    pub fn in_words(self, needs: &Needs) -> String {
        match self {
            Self::All => "every frame is used".to_owned(),
            Self::Every(1) => format!("a frame every {} is used", rough(needs.frame_period)),
            Self::Every(frames) => format!("{} is used", every_nth(frames as u32, "frame")),
            Self::Contexts(steps) => {
                let frames = steps * needs.frame_skip.max(1);
                match needs.context_frames {
                    0 | 1 => format!("{} is used", every_nth(frames as u32, "frame")),
                    context => format!(
                        "{context} of every {frames} frames are used, those of a context, {} apart",
                        rough(needs.step())
                    ),
                }
            }
        }
    }
}

/// What happens to a camera frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It is encoded.
    Encode,
    /// It is skipped.
    Skip,
    /// It was due, but earlier frames still wait.
    Late,
}

/// Picks the camera frames that are encoded. It has no clock: every call brings the time.
#[derive(Clone, Debug)]
pub struct Choice {
    needs: Needs,
    mode: Mode,
    told: Mode,
    estimate: Option<Duration>,
    cameras: Arrivals,
    taken: Recent,
    /// Which frames are on the grid of the mode.
    pace: Pace,
    newest_ns: Option<i64>,
    /// The last frame on the grid, and its fate.
    last: Option<(i64, Fate)>,
    /// Frames on the grid since the first one of the last context; `None` before the first context.
    since: Option<usize>,
}

impl Choice {
    /// For an encoder that took `estimate` per frame in a trial.
    pub fn new(needs: Needs, estimate: Option<Duration>) -> Self {
        let believed = estimate.filter(|taken| *taken > needs.frame_period * BELIEVED_PERIODS);
        let mode = believed.map_or(Mode::All, |taken| Mode::of(taken, &needs));
        let mut choice = Self {
            needs,
            mode,
            told: mode,
            estimate,
            cameras: Arrivals::default(),
            taken: Recent::default(),
            pace: Pace::new(1, 1),
            newest_ns: None,
            last: None,
            since: None,
        };
        choice.restart();
        choice
    }

    /// Whether the time of encoding is still to be measured by the first frames.
    pub fn is_open(&self) -> bool {
        let tried = self.estimate.map(|taken| Mode::of(taken, &self.needs));
        self.taken.median().is_none() && tried != Some(self.mode)
    }

    /// Which frames are encoded at present.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Frames that may wait to be encoded: the newest one, or a context.
    pub fn room(&self) -> usize {
        match self.mode {
            Mode::All | Mode::Every(_) => 1,
            Mode::Contexts(_) => self.needs.context_frames.max(1),
        }
    }

    /// Decides on the frame of `stamp_ns` that arrives at `now`, while `waiting` frames wait to be encoded.
    pub fn arrived(&mut self, stamp_ns: i64, now: Instant, waiting: usize) -> Fate {
        // The same frame by another transport, since the first could not be used.
        if let Some((_, fate)) = self.last.filter(|(last_ns, _)| *last_ns == stamp_ns) {
            return fate;
        }
        if self
            .newest_ns
            .is_some_and(|newest_ns| stamp_ns < newest_ns.saturating_sub(JUMP_NS))
        {
            self.restart();
        }
        self.cameras.push(now, stamp_ns);
        self.newest_ns = Some(stamp_ns);
        if self.mode == Mode::All {
            return Fate::Encode;
        }
        let gap_ns = self.cameras.stamp_gap_ns();
        self.pace
            .set_gap(gap_ns.unwrap_or_else(|| nanos(self.needs.frame_period)));
        if !self.pace.is_due(stamp_ns) {
            return Fate::Skip;
        }
        let fate = match self.mode {
            Mode::All | Mode::Every(_) => Fate::Encode,
            Mode::Contexts(steps) => self.of_context(stamp_ns, steps, waiting),
        };
        self.last = Some((stamp_ns, fate));
        fate
    }

    /// Decides on a frame on the grid of model steps, if contexts begin `steps` of them apart.
    fn of_context(&mut self, stamp_ns: i64, steps: usize, waiting: usize) -> Fate {
        let context = self.needs.context_frames.max(1);
        let step_ns = nanos(self.needs.step());
        let follows =
            |(last_ns, _): (i64, Fate)| stamp_ns.saturating_sub(last_ns) < step_ns / 2 * 3;
        let since = self.since.map(|since| since.saturating_add(1));
        match since {
            // A context whose frame the camera has lost begins anew.
            Some(since) if since < context && self.last.is_some_and(follows) => {
                self.since = Some(since);
                return Fate::Encode;
            }
            Some(since) if (context..steps).contains(&since) => {
                self.since = Some(since);
                return Fate::Skip;
            }
            _ => {}
        }
        if waiting > 0 {
            // It would be late after the others; the next one is newer.
            self.since = since;
            return Fate::Late;
        }
        self.since = Some(0);
        Fate::Encode
    }

    /// Encoding a frame took this long.
    pub fn took(&mut self, taken: Duration) {
        self.taken.push(taken);
        let needs = self.needs;
        let gap = self.cameras.gap().unwrap_or(needs.frame_period);
        let stamps = self.cameras.stamp_gap_ns().filter(|gap_ns| *gap_ns > 0);
        let pace = stamps.map_or(1.0, |gap_ns| gap.as_secs_f64() / (gap_ns as f64 / 1e9));
        let fitting = |taken| Mode::fitting(taken, gap, pace, &needs);
        let slower = self.taken.median().map(fitting);
        let longest = self.taken.longest();
        // Too few for a measurement, but one is enough to show that the estimate was too long.
        let likely = longest.or(self.taken.at_most(self.estimate));
        let faster = likely.map(|taken| fitting(taken.mul_f64(MARGIN)));
        let change = slower.filter(|mode| *mode > self.mode);
        if let Some(mode) = change.or(faster.filter(|mode| *mode < self.mode)) {
            self.mode = mode;
            self.restart();
        }
    }

    /// The time per frame, if the mode has changed since the last call.
    pub fn change(&mut self) -> Option<Duration> {
        if self.mode == self.told {
            return None;
        }
        self.told = self.mode;
        let taken = self.taken.median();
        taken.or(self.taken.at_most(self.estimate))
    }

    /// Starts anew with the next frame, which is of another time or another camera.
    pub fn restart(&mut self) {
        let period = match self.mode {
            Mode::All => self.needs.frame_period,
            Mode::Every(_) => self.mode.interval(&self.needs),
            Mode::Contexts(_) => self.needs.step(),
        };
        self.pace = Pace::new(nanos(period), nanos(self.needs.frame_period));
        (self.newest_ns, self.last, self.since) = (None, None, None);
    }
}

/// The parameter's range keeps periods within a minute.
fn nanos(period: Duration) -> i64 {
    // 64 bits of nanoseconds hold 292 years.
    i64::try_from(period.as_nanos()).unwrap_or(i64::MAX)
}

/// Logs which frames are encoded.
pub(super) fn log_selection(choice: &Choice, taken: Duration, needs: &Needs) {
    let mode = choice.mode();
    let (taken, rate, words) = (
        rough(taken),
        hertz(needs.frame_period),
        mode.in_words(needs),
    );
    let text = format!("encoding a frame takes about {taken} here; at {rate}");
    match mode {
        _ if choice.is_open() => tracing::info!("{text}, {OPEN}"),
        Mode::All => tracing::info!("{text}, {words}"),
        Mode::Every(_) | Mode::Contexts(_) => tracing::warn!("{text}, {words}; {FASTER}"),
    }
}

#[cfg(test)]
mod tests;
