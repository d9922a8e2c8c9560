//! Arrival times and stamps of a topic's messages.

use std::time::Duration;
use wm_camera::recent_pictures::RecentPictures;
use wm_msgs::builtin_interfaces::Time;

/// The least share of new pictures of a camera that repeats none.
const MOSTLY_NEW: f64 = 0.8;

/// A received message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Since the start of listening, by the monotonic clock.
    pub at: Duration,
    /// By the system's clock \[ns\].
    pub received_ns: i64,
    /// Its header's stamp; `None` if the type has no header.
    pub stamp: Option<Time>,
    /// For pictures: equal if the pictures are equal, byte for byte.
    pub fingerprint: Option<u64>,
}

impl Arrival {
    /// The stamp in nanoseconds, if valid.
    fn stamp_ns(&self) -> Option<i64> {
        self.stamp
            .filter(|stamp| is_time(*stamp))
            .map(Time::to_nanos)
    }
}

/// Whether the nodes accept the stamp.
fn is_time(stamp: Time) -> bool {
    let is_zero = stamp.sec == 0 && stamp.nanosec == 0;
    stamp.sec >= 0 && stamp.nanosec < 1_000_000_000 && !is_zero
}

/// Messages in order of arrival.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Timeline(pub Vec<Arrival>);

impl Timeline {
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Messages with an invalid stamp.
    pub(crate) fn unstamped(&self) -> usize {
        let stamps = self.0.iter().filter_map(|arrival| arrival.stamp);
        stamps.filter(|stamp| !is_time(*stamp)).count()
    }

    /// Gaps between messages by their stamps if all have one, otherwise by arrival \[s\]. Zero and negative gaps are
    /// excluded.
    fn gaps_s(&self) -> Vec<f64> {
        let stamps: Option<Vec<i64>> = self.0.iter().map(Arrival::stamp_ns).collect();
        let times_s: Vec<f64> = match stamps {
            Some(stamps) => {
                let Some(first) = stamps.first() else {
                    return Vec::new();
                };
                // seconds since 1970 as a float do not resolve microseconds
                let since_s = |ns: &i64| ns.saturating_sub(*first) as f64 / 1e9;
                stamps.iter().map(since_s).collect()
            }
            None => self
                .0
                .iter()
                .map(|arrival| arrival.at.as_secs_f64())
                .collect(),
        };
        let gaps = times_s
            .array_windows()
            .map(|[before, after]| after - before);
        gaps.filter(|gap| *gap > 0.0).collect()
    }

    /// The median gap between messages \[s\]; `None` for fewer than three messages.
    pub(crate) fn period_s(&self) -> Option<f64> {
        let gaps_s = self.gaps_s();
        (gaps_s.len() >= 2).then(|| quantile(gaps_s, 0.5)).flatten()
    }

    /// The messages with a new picture; empty if messages have no pictures.
    pub(crate) fn of_new_pictures(&self) -> Self {
        let mut recent = RecentPictures::default();
        let is_new = |arrival: &&Arrival| {
            let fingerprint = arrival.fingerprint;
            fingerprint.is_some_and(|fingerprint| recent.insert(fingerprint))
        };
        Self(self.0.iter().filter(is_new).copied().collect())
    }

    /// The median gap between new pictures \[s\], longer than [`Self::period_s`] if the camera repeats pictures. `None`
    /// for fewer than three messages.
    pub(crate) fn picture_period_s(&self) -> Option<f64> {
        let period_s = self.period_s()?;
        let new = self.of_new_pictures();
        // some repeat by chance, for example where a bag loops
        if new.is_empty() || new.len() as f64 > MOSTLY_NEW * self.len() as f64 {
            return Some(period_s);
        }
        let gaps_s = new.gaps_s();
        let mean_s = gaps_s.iter().sum::<f64>() / gaps_s.len() as f64;
        Some(if gaps_s.len() >= 2 { mean_s } else { period_s })
    }

    /// The longest time without a new picture, including the end of listening \[s\]; 0 if messages have no pictures.
    pub(crate) fn longest_repeat_s(&self) -> f64 {
        let mut new = self.of_new_pictures().0.into_iter().peekable();
        let (mut since, mut longest) = (None, Duration::ZERO);
        for arrival in &self.0 {
            if new.next_if_eq(arrival).is_some() {
                since = Some(arrival.at);
            }
            let repeated = since.map_or(Duration::ZERO, |since| arrival.at.saturating_sub(since));
            longest = longest.max(repeated);
        }
        longest.as_secs_f64()
    }

    /// The longest tenth of the gaps relative to the median; `None` for fewer than ten gaps.
    pub(crate) fn jitter(&self) -> Option<f64> {
        let gaps_s = self.gaps_s();
        let long = (gaps_s.len() >= 10)
            .then(|| quantile(gaps_s, 0.9))
            .flatten()?;
        Some(long / self.period_s()?)
    }

    /// The median time from stamp to arrival \[s\]; negative if stamps are ahead of this machine's clock.
    pub(crate) fn delay_s(&self) -> Option<f64> {
        let delays = self.0.iter().filter_map(|arrival| {
            let stamp_ns = arrival.stamp_ns()?;
            Some(arrival.received_ns.saturating_sub(stamp_ns) as f64 / 1e9)
        });
        quantile(delays.collect(), 0.5)
    }

    /// Messages with an earlier stamp than their predecessor.
    pub(crate) fn backwards(&self) -> usize {
        let stamps: Vec<i64> = self.0.iter().filter_map(Arrival::stamp_ns).collect();
        let pairs = stamps.iter().zip(stamps.iter().skip(1));
        pairs.filter(|(before, after)| after < before).count()
    }

    /// How far the system's clock moved against the monotonic clock, from the first message to the last \[s\].
    pub(crate) fn clock_moved_s(&self) -> Option<f64> {
        let (first, last) = (self.0.first()?, self.0.last()?);
        let wall_s = (last.received_ns - first.received_ns) as f64 / 1e9;
        Some(wall_s - last.at.saturating_sub(first.at).as_secs_f64())
    }
}

/// The quantile `q`; `None` without values.
fn quantile(mut values: Vec<f64>, q: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    // a share of a length is an index
    let index = (values.len().saturating_sub(1) as f64 * q).round() as usize;
    values.get(index).copied()
}

/// Test messages `period_ms` apart, each stamped `delay_ms` before its arrival.
#[cfg(test)]
pub(crate) fn regular(count: u64, period_ms: u64, delay_ms: i64) -> Timeline {
    let arrival = |index: u64| {
        let received_ns = 1_800_000_000_000_000_000 + (index * period_ms * 1_000_000) as i64;
        Arrival {
            at: Duration::from_millis(index * period_ms),
            received_ns,
            stamp: Some(Time::from_nanos(received_ns - delay_ms * 1_000_000)),
            fingerprint: Some(index),
        }
    };
    Timeline((0..count).map(arrival).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: Option<f64>, expected: f64) {
        let found = found.expect("a figure");
        assert!(
            (found - expected).abs() < 1e-6,
            "{found} instead of {expected}"
        );
    }

    #[test]
    fn rate_and_delay_are_medians() {
        let mut timeline = regular(21, 200, 40);
        close(timeline.period_s(), 0.2);
        close(timeline.delay_s(), 0.04);
        close(timeline.jitter(), 1.0);
        close(timeline.clock_moved_s(), 0.0);
        // a lost message changes no median, but no frame is stamped twice
        timeline.0.remove(7);
        close(timeline.period_s(), 0.2);
        assert_eq!((timeline.backwards(), timeline.unstamped()), (0, 0));
    }

    #[test]
    fn unstamped_messages_use_arrival_times() {
        let mut timeline = regular(5, 100, 0);
        timeline.0[2].stamp = Some(Time::default());
        timeline.0[3].stamp = Some(Time {
            sec: -1,
            nanosec: 0,
        });
        assert_eq!(timeline.unstamped(), 2);
        close(timeline.period_s(), 0.1);
        assert_eq!(regular(2, 100, 0).period_s(), None);
        assert_eq!(Timeline::default().delay_s(), None);
    }

    /// Pictures that are published so many times each.
    fn repeated(times: u64, count: u64) -> Timeline {
        let mut timeline = regular(count, 100, 0);
        for arrival in &mut timeline.0 {
            arrival.fingerprint = arrival.fingerprint.map(|picture| picture / times);
        }
        timeline
    }

    #[test]
    fn repeated_pictures_do_not_count_for_the_rate() {
        for times in [1, 2, 3] {
            let timeline = repeated(times, 60);
            close(timeline.period_s(), 0.1);
            close(timeline.picture_period_s(), 0.1 * times as f64);
            close(Some(timeline.longest_repeat_s()), 0.1 * (times - 1) as f64);
        }
        // it has stopped: no rate
        let stopped = repeated(1000, 60);
        close(stopped.picture_period_s(), 0.1);
        close(Some(stopped.longest_repeat_s()), 5.9);
        let mut actions = regular(20, 100, 0);
        actions
            .0
            .iter_mut()
            .for_each(|arrival| arrival.fingerprint = None);
        close(actions.picture_period_s(), 0.1);
        close(Some(actions.longest_repeat_s()), 0.0);
    }

    #[test]
    fn backward_stamps_and_set_clocks_are_measured() {
        let mut timeline = regular(4, 100, 0);
        timeline.0.swap(1, 2);
        assert_eq!(timeline.backwards(), 1);
        let mut timeline = regular(4, 100, 0);
        timeline.0[3].received_ns -= 2_000_000_000;
        close(timeline.clock_moved_s(), -2.0);
    }

    #[test]
    fn uneven_gaps_are_measured() {
        let mut timeline = regular(40, 100, 0);
        for index in (0..39).step_by(3) {
            if let Some(stamp) = timeline.0[index].stamp.as_mut() {
                *stamp = Time::from_nanos(stamp.to_nanos() - 60_000_000);
            }
        }
        assert!(timeline.jitter().unwrap() > 1.4);
    }
}
