//! Comparisons with the baseline.

use super::{arrow, figures::name, markup::Markup, swatch, whisker::about_zero};
use crate::findings::{
    Comparison, Difference, Suite, Verdict,
    number::{Digits, probability},
};

/// A table for each model except the first; `labels` has all models.
pub(super) fn comparisons(markup: &mut Markup, comparisons: &[Comparison], labels: &[String]) {
    let Some((baseline, others)) = labels.split_first() else {
        return;
    };
    if comparisons.is_empty() {
        return;
    }
    markup.element(
        "section",
        &[
            ("id", "comparison"),
            ("aria-labelledby", "comparison-heading"),
        ],
        |markup| {
            let heading = if let [other] = others {
                format!("Is {other} better than {baseline}?")
            } else {
                format!("Is any model better than {baseline}?")
            };
            markup.leaf("h2", &[("id", "comparison-heading")], &heading);
            let about = "Differences over the units that both models were measured on, with 95 % paired bootstrap intervals. p is \
                             from a one-sided sign-flip test that the model is better, or from the bootstrap for figures that are not \
                             means over units. A model is better or worse if the interval excludes 0 and the test in that direction \
                             gives p of at most 0.025, which needs at least six pairs. Among forty figures without a real \
                             difference, about one appears better and one worse by chance.";
            markup.leaf("p", &[("class", "about")], about);
            for (number, (comparison, label)) in comparisons.iter().zip(others).enumerate() {
                markup.element("h3", &[], |markup| {
                    swatch(markup, number + 1);
                    markup.text(&format!("{label} − {baseline}"));
                });
                tally(markup, comparison);
                table(markup, comparison, &format!("{label} − {baseline}"));
                left_out(markup, comparison);
            }
        },
    );
}

/// Number of each verdict.
fn tally(markup: &mut Markup, comparison: &Comparison) {
    markup.element("ul", &[("class", "tally")], |markup| {
        for verdict in [
            Verdict::Better,
            Verdict::Worse,
            Verdict::Differs,
            Verdict::Unclear,
            Verdict::Untested,
        ] {
            let differences = comparison.differences.values();
            let count = differences.filter(|found| found.verdict == verdict).count();
            if count > 0 {
                markup.element("li", &[], |markup| {
                    markup.leaf("strong", &[], &count.to_string());
                    markup.text(" ");
                    pill(markup, verdict);
                });
            }
        }
    });
}

fn pill(markup: &mut Markup, verdict: Verdict) {
    let class = match verdict {
        Verdict::Better => "verdict better",
        Verdict::Worse => "verdict worse",
        Verdict::Differs => "verdict differs",
        Verdict::Unclear | Verdict::Untested => "verdict",
    };
    markup.leaf("span", &[("class", class)], verdict.words());
}

fn table(markup: &mut Markup, comparison: &Comparison, label: &str) {
    super::scrolling(markup, label, |markup| {
        markup.element("table", &[("class", "figures compared")], |markup| {
            markup.leaf("caption", &[("class", "spoken")], label);
            markup.element("thead", &[], |markup| {
                markup.element("tr", &[], |markup| {
                    markup.leaf("th", &[("scope", "col")], "Figure");
                    let number = [("scope", "col"), ("class", "number")];
                    markup.leaf("th", &number, "Difference");
                    markup.leaf("th", &[("scope", "col"), ("class", "range")], "About 0");
                    markup.leaf("th", &number, "p");
                    markup.leaf("th", &number, "Pairs");
                    markup.leaf("th", &[("scope", "col")], "Verdict");
                });
            });
            markup.element("tbody", &[], |markup| {
                let mut rows: Vec<_> = comparison.differences.iter().collect();
                rows.sort_by_key(|(name, _)| place(name));
                for (name, difference) in rows {
                    row(markup, name, difference);
                }
            });
        });
    });
}

/// Position by suite, as in the rest of the report.
fn place(metric: &str) -> Option<usize> {
    let suite = metric.split('.').next();
    Suite::ALL.iter().position(|one| Some(one.name()) == suite)
}

fn row(markup: &mut Markup, metric: &str, difference: &Difference) {
    let interval = difference.interval;
    let digits = Digits::of(
        [difference.difference],
        interval.map(|interval| (interval.low, interval.high)),
    );
    let number = [("class", "number")];
    markup.element("tr", &[], |markup| {
        markup.element("th", &[("scope", "row")], |markup| {
            name(markup, metric);
            markup.text("\u{a0}");
            arrow(markup, difference.better);
        });
        markup.element("td", &number, |markup| {
            let text = digits.signed(difference.difference);
            markup.leaf("span", &[("class", "value")], &text);
            if !difference.unit.is_empty() {
                markup.text("\u{a0}");
                markup.leaf("span", &[("class", "unit")], &difference.unit);
            }
            if let Some(interval) = interval {
                let (low, high) = (digits.signed(interval.low), digits.signed(interval.high));
                markup.text(" ");
                markup.leaf(
                    "span",
                    &[("class", "interval")],
                    &format!("[{low}, {high}]"),
                );
            }
        });
        markup.element("td", &[("class", "range")], |markup| {
            about_zero(markup, difference);
        });
        let p = match difference.p {
            Some(p) if difference.p_is_exact => probability(p),
            Some(p) => format!("≈{}", probability(p)),
            None => "–".to_owned(),
        };
        markup.leaf("td", &number, &p);
        markup.leaf("td", &number, &difference.n.to_string());
        markup.element("td", &[], |markup| pill(markup, difference.verdict));
    });
}

fn left_out(markup: &mut Markup, comparison: &Comparison) {
    if comparison.absent.is_empty() {
        return;
    }
    markup.element("details", &[], |markup| {
        let count = comparison.absent.len();
        let figures = if count == 1 { "figure" } else { "figures" };
        let summary = format!("{count} {figures} not compared");
        markup.leaf("summary", &[], &summary);
        markup.element("dl", &[("class", "absent")], |markup| {
            for (metric, why) in &comparison.absent {
                markup.element("dt", &[], |markup| name(markup, metric));
                markup.leaf("dd", &[], why);
            }
        });
    });
}
