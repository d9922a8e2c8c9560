//! Figures of a suite, models side by side.

use std::collections::BTreeSet;

use super::{LabelledModel, arrow, markup::Markup, swatch, value, whisker::whiskers};
use crate::findings::{Better, Metric, Suite, number::Digits};

/// A figure of all models.
pub(super) struct Row<'a> {
    pub(super) name: &'a str,
    /// In the order of the models; `None` if missing.
    pub(super) metrics: Vec<Option<&'a Metric>>,
}

impl Row<'_> {
    /// Whether any model has an interval.
    pub(super) fn is_sure(&self) -> bool {
        let mut metrics = self.metrics.iter().flatten();
        metrics.any(|metric| metric.finite_interval().is_some())
    }

    /// Common precision of all its numbers.
    pub(super) fn digits(&self) -> Digits {
        let metrics = || self.metrics.iter().flatten();
        let intervals = metrics().filter_map(|metric| metric.finite_interval());
        Digits::of(
            metrics().map(|metric| metric.value),
            intervals.map(|interval| (interval.low, interval.high)),
        )
    }

    /// The best value, if values differ when printed.
    fn best(&self) -> Option<f64> {
        let mut values: Vec<f64> = self.metrics.iter().flatten().map(|m| m.value).collect();
        values.sort_unstable_by(f64::total_cmp);
        let (least, most) = (*values.first()?, *values.last()?);
        let digits = self.digits();
        if digits.show(least) == digits.show(most) {
            return None;
        }
        let better = self.metrics.iter().flatten().next()?.better;
        match better {
            Better::Higher => Some(most),
            Better::Lower => Some(least),
            Better::Neither => None,
        }
    }
}

/// All figures of a suite, by name.
pub(super) fn rows<'a>(models: &[LabelledModel<'a>], suite: Suite) -> Vec<Row<'a>> {
    let of = |model: &LabelledModel<'a>| {
        let findings: &'a _ = model.findings;
        findings.of(suite).flat_map(|section| &section.metrics)
    };
    let names: BTreeSet<&str> = models
        .iter()
        .flat_map(of)
        .filter(|(_, metric)| metric.value.is_finite())
        .map(|(name, _)| name.as_str())
        .collect();
    names
        .into_iter()
        .map(|name| Row {
            name,
            metrics: models
                .iter()
                .map(|model| {
                    let found = of(model).find(|(own, _)| own.as_str() == name);
                    found
                        .map(|(_, metric)| metric)
                        .filter(|m| m.value.is_finite())
                })
                .collect(),
        })
        .collect()
}

/// The table of a suite.
pub(super) fn figures(markup: &mut Markup, suite: Suite, models: &[LabelledModel<'_>]) {
    let rows = rows(models, suite);
    if rows.is_empty() {
        return;
    }
    let label = format!("Figures of {suite}");
    markup.leaf("h3", &[], "Figures");
    super::scrolling(markup, &label, |markup| {
        let class = if models.len() > 1 {
            "figures several"
        } else {
            "figures"
        };
        markup.element("table", &[("class", class)], |markup| {
            markup.leaf("caption", &[("class", "spoken")], &label);
            head(markup, models);
            markup.element("tbody", &[], |markup| {
                for shown in &rows {
                    row(markup, shown, true);
                }
            });
        });
    });
}

/// The heads of the columns.
pub(super) fn head(markup: &mut Markup, models: &[LabelledModel<'_>]) {
    markup.element("thead", &[], |markup| {
        markup.element("tr", &[], |markup| {
            markup.leaf("th", &[("scope", "col")], "Figure");
            for model in models {
                let attributes = [("scope", "col"), ("class", "number")];
                markup.element("th", &attributes, |markup| {
                    if models.len() > 1 {
                        swatch(markup, model.number);
                        markup.text(model.label);
                    } else {
                        markup.text("Value");
                    }
                });
            }
            if models.len() > 1 {
                markup.leaf("th", &[("scope", "col"), ("class", "range")], "Range");
            }
            markup.leaf("th", &[("scope", "col"), ("class", "number")], "n");
        });
    });
}

/// A row, with the meaning of the figure if `explained`.
pub(super) fn row(markup: &mut Markup, row: &Row<'_>, explained: bool) {
    let Some(first) = row.metrics.iter().flatten().next() else {
        return;
    };
    let (digits, best) = (row.digits(), row.best());
    markup.element("tr", &[], |markup| {
        markup.element("th", &[("scope", "row")], |markup| {
            name(markup, row.name);
            markup.text("\u{a0}");
            arrow(markup, first.better);
            if explained && !first.about.is_empty() {
                markup.leaf("p", &[("class", "says")], &first.about);
            }
        });
        for metric in &row.metrics {
            let Some(metric) = metric else {
                markup.element("td", &[("class", "number none")], |markup| {
                    markup.leaf("span", &[("aria-hidden", "true")], "–");
                    markup.spoken("not measured");
                });
                continue;
            };
            let is_best = row.metrics.len() > 1 && best == Some(metric.value);
            let class = if is_best { "number best" } else { "number" };
            markup.element("td", &[("class", class)], |markup| {
                value(markup, metric, digits);
                if is_best {
                    markup.spoken(" (best)");
                }
            });
        }
        if row.metrics.len() > 1 {
            markup.element("td", &[("class", "range")], |markup| {
                whiskers(markup, &row.metrics);
            });
        }
        let mut counts: Vec<String> = row
            .metrics
            .iter()
            .flatten()
            .map(|m| m.n.to_string())
            .collect();
        counts.dedup();
        markup.leaf("td", &[("class", "number n")], &counts.join(" / "));
    });
}

/// A name that may wrap after dots and underscores.
pub(super) fn name(markup: &mut Markup, name: &str) {
    markup.element("code", &[("class", "metric")], |markup| {
        let (suite, own) = name
            .split_once('.')
            .map_or(("", name), |(suite, own)| (suite, own));
        if !suite.is_empty() {
            markup.leaf("span", &[("class", "prefix")], &format!("{suite}."));
            markup.void("wbr", &[]);
        }
        for part in own.split_inclusive('_') {
            markup.text(part);
            if part.ends_with('_') {
                markup.void("wbr", &[]);
            }
        }
    });
}
