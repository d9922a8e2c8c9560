//! The report: one self-contained HTML file.

mod axis;
mod chart;
mod comparisons;
mod figures;
mod header;
mod markup;
mod paths;
mod suite_section;
mod summary;
mod whisker;

use std::collections::BTreeSet;

use crate::findings::{FindingsError, ModelFindings, Suite, compare_with_first};

use markup::Markup;

/// A report of one or several models side by side; all are compared with the first.
///
/// The file is self-contained and without scripts; its content policy forbids both, whatever the model is called. It
/// follows the system's light or dark theme and prints well.
///
/// # Errors
/// Those of [`compare`](crate::findings::compare()) for several models.
pub fn html(title: &str, findings: &[ModelFindings]) -> Result<String, FindingsError> {
    let comparisons = compare_with_first(findings)?;
    let labels = labels(findings);
    let models: Vec<LabelledModel<'_>> = findings
        .iter()
        .zip(&labels)
        .enumerate()
        .map(|(number, (findings, label))| LabelledModel {
            findings,
            label,
            number,
        })
        .collect();
    let measured: Vec<Suite> = Suite::ALL
        .into_iter()
        .filter(|suite| findings.iter().any(|one| one.of(*suite).next().is_some()))
        .collect();

    let mut markup = Markup::default();
    markup.raw("<!doctype html>\n");
    markup.element("html", &[("lang", "en")], |markup| {
        markup.element("head", &[], |markup| head(markup, title));
        markup.element("body", &[], |markup| {
            markup.leaf(
                "a",
                &[("href", "#content"), ("class", "skip")],
                "To the figures",
            );
            header::header(markup, title, &models);
            navigation(markup, &measured, &comparisons);
            markup.element("main", &[("id", "content")], |markup| {
                if measured.is_empty() {
                    markup.leaf("p", &[("class", "card")], "Nothing was measured.");
                } else {
                    summary::summary(markup, &models, &measured);
                }
                comparisons::comparisons(markup, &comparisons, &labels);
                for suite in &measured {
                    suite_section::suite(markup, *suite, &models);
                }
            });
            footer(markup, &models);
        });
    });
    Ok(markup.finish())
}

/// A model of a report.
#[derive(Clone, Copy)]
struct LabelledModel<'a> {
    findings: &'a ModelFindings,
    /// Unique name.
    label: &'a str,
    /// Index from 0, which determines the colour.
    number: usize,
}

/// Unique labels of models: the shortest distinct endings of their paths; otherwise with the hash, and with a number if
/// even the hash is equal.
fn labels(findings: &[ModelFindings]) -> Vec<String> {
    let names = || findings.iter().map(|one| one.header.model.as_str());
    let longest = names().map(|name| name.split('/').count()).max();
    // Without findings there are no labels.
    let short = (1..=longest.unwrap_or(0))
        .map(|parts| -> Vec<&str> { names().map(|name| ending(name, parts)).collect() })
        .find(|short| {
            let different: BTreeSet<&&str> = short.iter().collect();
            different.len() == short.len() && !different.contains(&"")
        });
    if let Some(short) = short {
        return short.into_iter().map(ToOwned::to_owned).collect();
    }
    let mut labels: Vec<String> = Vec::new();
    for one in findings {
        let header = &one.header;
        let mut label = format!("{} ({})", header.model, header.short_hash());
        if labels.contains(&label) {
            label = format!("{label}, number {}", labels.len() + 1);
        }
        labels.push(label);
    }
    labels
}

/// The last `parts` of a path.
fn ending(path: &str, parts: usize) -> &str {
    let mut slashes = path.rmatch_indices('/');
    let before = parts
        .checked_sub(1)
        .and_then(|skipped| slashes.nth(skipped));
    let start = before.map_or(0, |(place, _)| place + 1);
    // `start` follows a slash: always a character boundary.
    path.get(start..).unwrap_or(path)
}

fn head(markup: &mut Markup, title: &str) {
    markup.void("meta", &[("charset", "utf-8")]);
    let policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";
    markup.void(
        "meta",
        &[
            ("http-equiv", "Content-Security-Policy"),
            ("content", policy),
        ],
    );
    markup.void(
        "meta",
        &[
            ("name", "viewport"),
            ("content", "width=device-width, initial-scale=1"),
        ],
    );
    markup.void(
        "meta",
        &[("name", "color-scheme"), ("content", "light dark")],
    );
    markup.leaf("title", &[], title);
    markup.element("style", &[], |markup| {
        markup.raw(include_str!("report.css"));
    });
}

fn navigation(
    markup: &mut Markup,
    measured: &[Suite],
    comparisons: &[crate::findings::Comparison],
) {
    markup.element("nav", &[("aria-label", "Sections")], |markup| {
        markup.element("ul", &[], |markup| {
            let mut link = |target: &str, text: &str| {
                let target = format!("#{target}");
                markup.element("li", &[], |markup| {
                    markup.leaf("a", &[("href", &target)], text);
                });
            };
            if !measured.is_empty() {
                link("glance", "at a glance");
            }
            if !comparisons.is_empty() {
                link("comparison", "comparison");
            }
            for suite in measured {
                link(suite.name(), suite.name());
            }
        });
    });
}

fn footer(markup: &mut Markup, models: &[LabelledModel<'_>]) {
    let mut versions: Vec<&str> = models
        .iter()
        .map(|model| model.findings.header.version.as_str())
        .collect();
    versions.sort_unstable();
    versions.dedup();
    markup.element("footer", &[], |markup| {
        let text = format!(
            "Written by wm {}. Equal findings give an identical file.",
            versions.join(", ")
        );
        markup.leaf("p", &[], &text);
    });
}

/// A wide element that scrolls by itself, also by keyboard.
fn scrolling(markup: &mut Markup, label: &str, inside: impl FnOnce(&mut Markup)) {
    let attributes = [
        ("class", "scrolling"),
        ("tabindex", "0"),
        ("role", "region"),
        ("aria-label", label),
    ];
    markup.element("div", &attributes, inside);
}

/// A square in a model's colour.
fn swatch(markup: &mut Markup, number: usize) {
    let class = format!("swatch c{}", number % 8);
    markup.leaf("span", &[("class", &class), ("aria-hidden", "true")], "");
}

/// The better direction, as an arrow and in words.
fn arrow(markup: &mut Markup, better: crate::findings::Better) {
    let symbol = better.arrow();
    if !symbol.is_empty() {
        let attributes = [
            ("class", "arrow"),
            ("title", better.words()),
            ("aria-hidden", "true"),
        ];
        markup.leaf("span", &attributes, symbol);
        markup.spoken(&format!(" ({})", better.words()));
    }
}

/// A value with its unit, above its interval.
fn value(
    markup: &mut Markup,
    metric: &crate::findings::Metric,
    digits: crate::findings::number::Digits,
) {
    markup.leaf("span", &[("class", "value")], &digits.show(metric.value));
    if !metric.unit.is_empty() {
        markup.text("\u{a0}");
        markup.leaf("span", &[("class", "unit")], &metric.unit);
    }
    if let Some(interval) = metric.finite_interval() {
        let text = digits.interval(interval.low, interval.high);
        markup.text(" ");
        markup.leaf("span", &[("class", "interval")], &text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_the_shortest_distinct_endings() {
        let path = "/runs/a/model";
        let endings = [1, 2, 3, 4, 5].map(|parts| ending(path, parts));
        assert_eq!(endings, ["model", "a/model", "runs/a/model", path, path]);
    }
}
