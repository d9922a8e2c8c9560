//! Times and rates in words.

use std::time::Duration;

/// A time with two digits: `70 ms`, `1.5 s`, `11 s`.
pub fn rough(time: Duration) -> String {
    match time.as_secs_f64() {
        long if long >= 9.95 => format!("{long:.0} s"),
        short if short < 0.0995 => format!("{:.0} ms", short * 1e3),
        time => format!("{time:.1} s"),
    }
}

/// The rate of one input per `period`: `5 Hz`, `0.25 Hz`.
pub fn hertz(period: Duration) -> String {
    let rate = 1.0 / period.as_secs_f64().max(1e-9);
    let rounded = match rate {
        fast if fast >= 9.95 => format!("{fast:.0}"),
        rate if rate >= 0.995 => format!("{rate:.1}"),
        slow => format!("{slow:.2}"),
    };
    let rounded = match rounded.contains('.') {
        true => rounded.trim_end_matches('0').trim_end_matches('.'),
        false => &rounded,
    };
    format!("{rounded} Hz")
}

/// `every frame`, `every 2nd frame`, `every 8th frame`.
pub fn every_nth(nth: u32, what: &str) -> String {
    let suffix = match (nth % 100, nth % 10) {
        (11..=13, _) => "th",
        (_, 1) => "st",
        (_, 2) => "nd",
        (_, 3) => "rd",
        _ => "th",
    };
    match nth {
        0 | 1 => format!("every {what}"),
        nth => format!("every {nth}{suffix} {what}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_rates_and_ordinals_read_well() {
        let seconds = Duration::from_secs_f64;
        let times = [0.0704, 0.0999, 1.52, 9.97].map(|time| rough(seconds(time)));
        assert_eq!(times, ["70 ms", "0.1 s", "1.5 s", "10 s"]);
        let rates = [1.0 / 30.0, 0.2, 0.4, 1.0, 4.0].map(|period| hertz(seconds(period)));
        assert_eq!(rates, ["30 Hz", "5 Hz", "2.5 Hz", "1 Hz", "0.25 Hz"]);
        let nth = [1, 2, 3, 8, 11, 12, 21, 101].map(|nth| every_nth(nth, "frame"));
        assert_eq!(
            nth,
            [
                "every frame",
                "every 2nd frame",
                "every 3rd frame",
                "every 8th frame",
                "every 11th frame",
                "every 12th frame",
                "every 21st frame",
                "every 101st frame",
            ]
        );
    }
}
