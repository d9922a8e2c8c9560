//! What is told, as text.

use std::time::Duration;

/// A pace that is measured over less says nothing.
const MEASURED: Duration = Duration::from_secs(1);

/// How far it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counted {
    pub done: u64,
    /// Of these, what was done before it began.
    pub before: u64,
    pub total: Option<u64>,
    pub elapsed: Duration,
}

impl Counted {
    /// The time that is left at the pace so far.
    pub fn left(&self) -> Option<Duration> {
        let now = self.done.saturating_sub(self.before);
        let rest = self.total?.saturating_sub(self.done);
        if now == 0 || self.elapsed < MEASURED {
            return None;
        }
        Duration::try_from_secs_f64(self.elapsed.as_secs_f64() / now as f64 * rest as f64).ok()
    }
}

/// `reading: 3 of 12 bags, loss 0.5, 40s left`.
pub(crate) fn line(what: &str, things: &str, counted: &Counted, message: &str) -> String {
    let count = |number: u64| match things {
        "bytes" => bytes(number),
        _ => number.to_string(),
    };
    let things = if things == "bytes" {
        String::new()
    } else {
        format!(" {things}")
    };
    let mut text = match (counted.total, counted.done) {
        (Some(total), done) => format!("{what}: {} of {}{things}", count(done), count(total)),
        (None, 0) => what.to_owned(),
        (None, done) => format!("{what}: {}{things}", count(done)),
    };
    if !message.is_empty() {
        text.push_str(&format!(", {message}"));
    }
    match counted.left() {
        Some(left) => text.push_str(&format!(", {} left", whole(left))),
        None if counted.total.is_none() => {
            text.push_str(&format!(", {} so far", whole(counted.elapsed)))
        }
        None => {}
    }
    text
}

fn whole(time: Duration) -> humantime::FormattedDuration {
    humantime::format_duration(Duration::from_secs(time.as_secs()))
}

fn bytes(number: u64) -> String {
    format!("{:.1} MiB", number as f64 / f64::from(1 << 20))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(done: u64, before: u64, total: Option<u64>, seconds: u64) -> Counted {
        Counted {
            done,
            before,
            total,
            elapsed: Duration::from_secs(seconds),
        }
    }

    #[test]
    fn the_rest_goes_by_the_pace_of_this_run() {
        let half = counted(6, 0, Some(12), 30);
        assert_eq!(
            line("reading", "bags", &half, ""),
            "reading: 6 of 12 bags, 30s left"
        );
        // Nine were done before; of three, one took ten seconds.
        let resumed = counted(10, 9, Some(12), 10);
        assert_eq!(
            line("a", "bags", &resumed, "loss 1"),
            "a: 10 of 12 bags, loss 1, 20s left"
        );
        assert_eq!(
            line("a", "bags", &counted(0, 0, Some(2), 9), ""),
            "a: 0 of 2 bags"
        );
    }

    #[test]
    fn what_has_no_end_tells_how_long_it_has_taken() {
        assert_eq!(
            line("cutting", "bytes", &counted(0, 0, None, 70), ""),
            "cutting, 1m 10s so far"
        );
        let some = counted(3 << 20, 0, None, 5);
        assert_eq!(
            line("cutting", "bytes", &some, ""),
            "cutting: 3.0 MiB, 5s so far"
        );
    }
}
