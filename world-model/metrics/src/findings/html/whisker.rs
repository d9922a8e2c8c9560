//! Small drawings of intervals.

use super::{axis::drawable, markup::Markup};
use crate::findings::{Difference, Metric};

const WIDTH: f64 = 150.0;
const MARGIN: f64 = 6.0;
/// Height of a model's line.
const LINE: f64 = 11.0;

/// Values and intervals of all models on a common scale; `None` for a model without the figure.
pub(super) fn whiskers(markup: &mut Markup, metrics: &[Option<&Metric>]) {
    let ends = |metric: &Metric| {
        let interval = metric.finite_interval();
        interval.map_or((metric.value, metric.value), |interval| {
            (
                interval.low.min(metric.value),
                interval.high.max(metric.value),
            )
        })
    };
    let all = metrics.iter().flatten().map(|metric| ends(metric));
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), ends| {
        (low.min(ends.0), high.max(ends.1))
    });
    if high <= low || !drawable(low) || !drawable(high) {
        return;
    }
    let place = |value: f64| MARGIN + (value - low) / (high - low) * (WIDTH - 2.0 * MARGIN);
    // A handful of models.
    let height = LINE * metrics.len() as f64 + 2.0;
    let view = format!("0 0 {WIDTH} {height}");
    let attributes = [
        ("viewBox", view.as_str()),
        ("class", "whiskers"),
        ("aria-hidden", "true"),
    ];
    markup.element("svg", &attributes, |markup| {
        let mut y = 1.0 + LINE / 2.0;
        for (number, metric) in metrics.iter().enumerate() {
            if let Some(metric) = metric {
                let (low, high) = ends(metric);
                let class = format!("c{}", number % 8);
                markup.element("g", &[("class", &class)], |markup| {
                    whisker(markup, place(low), place(high), place(metric.value), y);
                });
            }
            y += LINE;
        }
    });
}

/// A difference with its interval around 0.
pub(super) fn about_zero(markup: &mut Markup, difference: &Difference) {
    let found = difference.difference;
    let interval = difference.interval;
    let (low, high) = interval.map_or((found, found), |interval| (interval.low, interval.high));
    let reach = low.abs().max(high.abs()).max(found.abs());
    if reach == 0.0 || !drawable(reach) {
        return;
    }
    let place = |value: f64| WIDTH / 2.0 + value / reach * (WIDTH / 2.0 - MARGIN);
    let view = format!("0 0 {WIDTH} 18");
    let attributes = [
        ("viewBox", view.as_str()),
        ("class", "whiskers"),
        ("aria-hidden", "true"),
    ];
    markup.element("svg", &attributes, |markup| {
        let zero = format!("M{} 1V17", WIDTH / 2.0);
        markup.void("path", &[("class", "axis"), ("d", &zero)]);
        markup.element("g", &[("class", "difference")], |markup| {
            whisker(markup, place(low), place(high), place(found), 9.0);
        });
    });
}

fn whisker(markup: &mut Markup, low: f64, high: f64, value: f64, y: f64) {
    if high > low {
        let path = format!("M{low:.1} {y}H{high:.1}");
        markup.void("path", &[("class", "whisker"), ("d", &path)]);
    }
    let dot = format!(
        "M{:.1} {y}a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0 -6.4 0Z",
        value - 3.2
    );
    markup.void("path", &[("class", "dot"), ("d", &dot)]);
}
