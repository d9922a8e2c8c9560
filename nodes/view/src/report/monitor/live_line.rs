//! The live line: recent rate, latency, error ratio, plan and drops.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// The time span of the figures.
const WINDOW: Duration = Duration::from_secs(3);

/// The most events of a kind: 3 s at 300 Hz.
const LIMIT: usize = 1000;

#[derive(Debug, Default)]
pub(super) struct LiveLine {
    frames: VecDeque<Instant>,
    predictions: VecDeque<Instant>,
    /// Of k = 1: arrival, and the time since the capture \[ms\].
    latencies: VecDeque<(Instant, f64)>,
    plan: Option<(f32, f64)>,
}

/// Longer latencies come from stamps of another clock, for example of a bag \[ms\].
const AN_HOUR_MS: f64 = 3_600_000.0;

impl LiveLine {
    pub(crate) fn frame(&mut self, now: Instant) {
        push(&mut self.frames, now);
    }

    /// A prediction of step `step`, `latency_ns` after its observation was captured.
    pub(crate) fn prediction(&mut self, step: u32, latency_ns: i64, now: Instant) {
        push(&mut self.predictions, now);
        if step == 1 {
            push(&mut self.latencies, (now, latency_ns as f64 / 1e6));
        }
    }

    /// A plan with this cost, found in `time_ns`.
    pub(crate) fn plan(&mut self, cost: f32, time_ns: i64) {
        self.plan = Some((cost, time_ns as f64 / 1e6));
    }

    /// `error_ratio`: the last one of k = 1. `drops`: the nodes' total.
    pub(crate) fn text(&mut self, now: Instant, error_ratio: Option<f32>, drops: u64) -> String {
        let is_old = |then: Instant| now.saturating_duration_since(then) > WINDOW;
        while self.frames.front().is_some_and(|then| is_old(*then)) {
            self.frames.pop_front();
        }
        while self.predictions.front().is_some_and(|then| is_old(*then)) {
            self.predictions.pop_front();
        }
        while self
            .latencies
            .front()
            .is_some_and(|(then, _)| is_old(*then))
        {
            self.latencies.pop_front();
        }
        let mut parts = vec![
            format!("camera {:.1} Hz", rate(&self.frames, now)),
            format!("predicted {:.1} Hz", rate(&self.predictions, now)),
        ];
        let mut sorted: Vec<f64> = self
            .latencies
            .iter()
            .map(|(_, milliseconds)| *milliseconds)
            .collect();
        sorted.sort_by(f64::total_cmp);
        parts.push(match (sorted.get(sorted.len() / 2), sorted.last()) {
            (_, Some(worst)) if worst.abs() > AN_HOUR_MS => {
                "k=1 - (the stamps of the images are not current)".to_owned()
            }
            (Some(median), Some(worst)) => format!("k=1 {median:.0} ms (max {worst:.0})"),
            _ => "k=1 -".to_owned(),
        });
        parts.push(match error_ratio {
            Some(ratio) => format!("error ratio {ratio:.2}"),
            None => "error ratio -".to_owned(),
        });
        if let Some((cost, milliseconds)) = self.plan {
            parts.push(format!("plan cost {cost:.3} in {milliseconds:.0} ms"));
        }
        parts.push(format!("drops {drops}"));
        parts.join(" | ")
    }
}

fn push<T>(events: &mut VecDeque<T>, event: T) {
    if events.len() == LIMIT {
        events.pop_front();
    }
    events.push_back(event);
}

/// The shortest time span of a rate: the steps of a rollout may arrive within a millisecond.
const SHORTEST: Duration = Duration::from_secs(1);

/// Events per second, since the first of them.
fn rate(events: &VecDeque<Instant>, now: Instant) -> f64 {
    let Some(first) = events.front() else {
        return 0.0;
    };
    let span = now.saturating_duration_since(*first).max(SHORTEST);
    (events.len() - 1) as f64 / span.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn burst_of_steps_gives_no_extreme_rate() {
        let (mut line, now) = (LiveLine::default(), Instant::now());
        (1..=8).for_each(|step| line.prediction(step, 0, now));
        for tick in 0..=10 {
            line.frame(now + Duration::from_millis(200) * tick);
        }
        let text = line.text(now + Duration::from_secs(2), None, 0);
        assert!(
            text.starts_with("camera 5.0 Hz | predicted 3.5 Hz"),
            "{text}"
        );
    }

    #[test]
    fn stamps_of_another_clock_give_no_latency() {
        let (mut line, now) = (LiveLine::default(), Instant::now());
        line.prediction(1, 95_321_650_161_000_000, now);
        let text = line.text(now, None, 0);
        assert!(
            text.contains("k=1 - (the stamps of the images are not current)"),
            "{text}"
        );
    }

    #[test]
    fn line_covers_only_the_last_seconds() {
        let mut line = LiveLine::default();
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        for frame in 0..11 {
            line.frame(at(200 * frame));
            line.prediction(
                1,
                40_000_000 + 1_000_000 * frame as i64,
                at(200 * frame + 40),
            );
            line.prediction(2, 60_000_000, at(200 * frame + 60));
        }
        line.plan(0.5, 90_000_000);
        let text = line.text(at(2000), Some(0.4), 3);
        assert!(text.starts_with("camera 5.0 Hz | predicted 10."), "{text}");
        assert!(
            text.contains(
                "k=1 45 ms (max 50) | error ratio 0.40 | plan cost 0.500 in 90 ms | drops 3"
            ),
            "{text}"
        );
        let text = line.text(at(9000), None, 0);
        assert!(
            text.starts_with("camera 0.0 Hz | predicted 0.0 Hz | k=1 - | error ratio -"),
            "{text}"
        );
    }
}
