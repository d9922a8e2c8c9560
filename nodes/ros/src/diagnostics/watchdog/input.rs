//! An input that should arrive regularly.

use super::{Finding, Level, Publishers};
use crate::logging::of_others;
use std::time::{Duration, Instant};

/// Silent periods after which an input is missed.
const MISSED_PERIODS: u32 = 3;
/// Silent periods, and the least time, after which it counts as gone.
const GONE_PERIODS: u32 = 10;
const GONE_LEAST: Duration = Duration::from_secs(2);
/// The shortest reported silence: shorter ones are the jitter of a fast topic.
const MISSED_LEAST: Duration = Duration::from_millis(500);
/// How long the first message may take.
const FIRST: Duration = Duration::from_secs(5);
/// Weight of the newest interval in the period is one part in this.
const SMOOTHING: u32 = 8;
/// An interval counts for at most so many periods, so that a silence is not taken for a new rate.
const LONGEST_INTERVAL: u32 = 4;

/// An input that a node needs.
#[derive(Clone, Debug)]
pub struct Input {
    pub(super) name: &'static str,
    topics: Vec<String>,
    advice: &'static str,
    severity: Level,
}

impl Input {
    /// An input by any of these absolute topics. `name`: the input in the plural (`camera images`); `advice`: the
    /// remedy if nobody publishes it.
    pub fn new<S: Into<String>>(
        name: &'static str,
        topics: impl IntoIterator<Item = S>,
        advice: &'static str,
    ) -> Self {
        Self {
            name,
            topics: topics.into_iter().map(Into::into).collect(),
            advice,
            severity: Level::Error,
        }
    }

    /// Makes its absence a warning at most: the node works without it.
    #[must_use]
    pub fn dispensable(self) -> Self {
        Self {
            severity: Level::Warn,
            ..self
        }
    }
}

/// The silence of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Silence {
    /// No longer than usual.
    Short,
    /// It is late.
    Long,
    /// It has stopped, or never arrived.
    Gone,
}

#[derive(Debug)]
pub(super) struct InputWatch {
    input: Input,
    since: Instant,
    last: Option<Instant>,
    /// The interval between messages.
    period: Option<Duration>,
    /// Whether its absence is logged.
    is_said: bool,
}

impl InputWatch {
    pub(super) fn new(input: Input, now: Instant) -> Self {
        Self {
            input,
            since: now,
            last: None,
            period: None,
            is_said: false,
        }
    }

    pub(super) fn arrived(&mut self, topic: &str, now: Instant) {
        if !self.input.topics.iter().any(|own| own == topic) {
            return;
        }
        if let Some(last) = self.last {
            let interval = now.saturating_duration_since(last);
            self.period = Some(match self.period {
                None => interval,
                Some(period) => {
                    let interval = interval.min(period * LONGEST_INTERVAL);
                    (period * (SMOOTHING - 1) + interval) / SMOOTHING
                }
            });
        }
        self.last = Some(now);
    }

    pub(super) fn judge(&self, now: Instant, publishers: &dyn Publishers) -> Finding {
        let (name, topics) = (self.input.name, self.input.topics.join(" and "));
        let (level, message) = match (self.last, self.silence(now)) {
            (None, Silence::Short) => (Level::Ok, format!("waiting for the first {name}")),
            (None, Silence::Long | Silence::Gone) => {
                let waited = now.saturating_duration_since(self.since).as_secs_f64();
                let text =
                    format!("no {name} on {topics} in the {waited:.0} s since the node subscribed");
                (Level::Warn, text)
            }
            (Some(_), Silence::Short) => (Level::Ok, format!("{name} come")),
            (Some(last), silence) => {
                let text = format!(
                    "no {name} on {topics} for {:.1} s; before, one arrived every {:.2} s",
                    now.saturating_duration_since(last).as_secs_f64(),
                    self.period().as_secs_f64()
                );
                let level = match silence {
                    Silence::Gone => Level::Error,
                    Silence::Short | Silence::Long => Level::Warn,
                };
                (level, text)
            }
        };
        let message = match level {
            Level::Ok => message,
            _ => format!("{message}: {}", self.cause(publishers)),
        };
        Finding {
            subject: format!("input {name}"),
            level: level.min(self.input.severity),
            message,
        }
    }

    fn period(&self) -> Duration {
        self.period.unwrap_or(MISSED_LEAST)
    }

    fn silence(&self, now: Instant) -> Silence {
        let (silent, missed, gone) = match self.last {
            None => (now.saturating_duration_since(self.since), FIRST, FIRST),
            Some(last) => (
                now.saturating_duration_since(last),
                (self.period() * MISSED_PERIODS).max(MISSED_LEAST),
                (self.period() * GONE_PERIODS).max(GONE_LEAST),
            ),
        };
        match () {
            () if silent > gone => Silence::Gone,
            () if silent > missed => Silence::Long,
            () => Silence::Short,
        }
    }

    /// Whether to log the finding: the first time that an input from outside the suite is gone or never arrived, and
    /// its return. Short gaps are not logged.
    pub(super) fn is_news(&mut self, now: Instant, publishers: &dyn Publishers) -> bool {
        let mut topics = self.input.topics.iter();
        let is_news = match self.silence(now) {
            Silence::Gone => !self.is_said,
            Silence::Long => false,
            Silence::Short => self.is_said,
        } && topics.any(|topic| publishers.is_from_outside(topic));
        self.is_said ^= is_news;
        is_news
    }

    fn cause(&self, publishers: &dyn Publishers) -> String {
        let topics = self.input.topics.iter();
        let connected = topics.clone().map(|topic| publishers.connected(topic));
        match connected.sum::<usize>() {
            0 => {
                let elsewhere: Vec<String> =
                    topics.flat_map(|topic| publishers.elsewhere(topic)).collect();
                let advice = self.input.advice;
                match elsewhere.is_empty() {
                    true => format!("it has no publisher; {advice}"),
                    false => format!(
                        "it has no publisher, but there are {} on {}; {advice}",
                        self.input.name,
                        of_others(&elsewhere.join(", "))
                    ),
                }
            }
            1 => "its publisher is connected but silent; check whether it waits for its own input, hangs or was killed"
                .to_owned(),
            many => format!(
                "{many} publishers are connected but silent; check whether they wait for their own input, hang or were \
                 killed"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const PERIOD: Duration = Duration::from_millis(200);

    /// So many publishers of each topic, and a camera on another one.
    struct Each(usize);

    impl Publishers for Each {
        fn connected(&self, _: &str) -> usize {
            self.0
        }

        fn elsewhere(&self, topic: &str) -> BTreeSet<String> {
            (topic == "/image")
                .then(|| "/front".to_owned())
                .into_iter()
                .collect()
        }

        fn is_from_outside(&self, _: &str) -> bool {
            true
        }
    }

    /// A camera that has sent 20 images, and when it sent the last.
    fn camera(start: Instant) -> (InputWatch, Instant) {
        let input = Input::new("camera images", ["/image", "/image/compressed"], "start it");
        let mut watch = InputWatch::new(input, start);
        for index in 1..=20 {
            watch.arrived("/image", start + PERIOD * index);
            watch.arrived("/other", start + PERIOD * index);
        }
        (watch, start + PERIOD * 20)
    }

    #[test]
    fn three_periods_warn_and_ten_are_an_error() {
        let (watch, last) = camera(Instant::now());
        let level = |periods| watch.judge(last + PERIOD * periods, &Each(1)).level;
        assert_eq!(
            [3, 4, 10, 11].map(level),
            [Level::Ok, Level::Warn, Level::Warn, Level::Error]
        );
    }

    #[test]
    fn the_sentence_says_what_to_do() {
        let (watch, last) = camera(Instant::now());
        let message = |publishers: usize| {
            let now = last + Duration::from_secs(3);
            watch.judge(now, &Each(publishers / 2)).message
        };
        assert_eq!(
            message(0),
            "no camera images on /image and /image/compressed for 3.0 s; before, one arrived every 0.20 s: it has no publisher, but there are camera images on /front; start it"
        );
        assert!(message(2).contains("2 publishers are connected but silent"));
    }

    #[test]
    fn absent_input_warns_and_optional_input_never_errs() {
        let start = Instant::now();
        let watch = InputWatch::new(Input::new("latents", ["/latent"], "start it"), start);
        let judge = |seconds| watch.judge(start + Duration::from_secs(seconds), &Each(0));
        assert_eq!(judge(4).level, Level::Ok);
        assert_eq!(judge(9).level, Level::Warn);
        assert!(
            judge(9).message.contains("in the 9 s since"),
            "{:?}",
            judge(9)
        );

        let input = Input::new("actions", ["/action"], "start it").dispensable();
        let mut watch = InputWatch::new(input, start);
        watch.arrived("/action", start);
        let finding = watch.judge(start + Duration::from_secs(60), &Each(0));
        assert_eq!(finding.level, Level::Warn);
    }

    #[test]
    fn a_silence_does_not_pass_for_a_new_rate_but_a_new_rate_does() {
        let (mut watch, last) = camera(Instant::now());
        let back = last + Duration::from_secs(600);
        watch.arrived("/image", back);
        assert!(watch.period.unwrap() < PERIOD * 2, "{:?}", watch.period);
        for index in 1..=60 {
            watch.arrived("/image", back + Duration::from_secs(1) * index);
        }
        assert!(watch.period.unwrap() > Duration::from_millis(900));
    }
}
