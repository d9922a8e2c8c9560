//! The headline figures.

use std::collections::BTreeMap;

use super::{
    LabelledModel, arrow,
    figures::{Row, head, row, rows},
    markup::Markup,
    value,
};
use crate::findings::{Suite, headlines::headlines};

/// Headlines of each suite: cards for one model, a table for several.
pub(super) fn summary(markup: &mut Markup, models: &[LabelledModel<'_>], measured: &[Suite]) {
    markup.element(
        "section",
        &[("id", "glance"), ("aria-labelledby", "glance-heading")],
        |markup| {
            markup.leaf("h2", &[("id", "glance-heading")], "At a glance");
            let about = "↑ higher is better, ↓ lower is better. Brackets: 95 % bootstrap intervals over n units.";
            markup.leaf("p", &[("class", "about")], about);
            if models.len() == 1 {
                cards(markup, models, measured);
            } else {
                table(markup, models, measured);
            }
        },
    );
}

fn chosen<'a>(models: &[LabelledModel<'a>], suite: Suite) -> Vec<Row<'a>> {
    let rows = rows(models, suite);
    let names = rows.iter().map(|row| (row.name, row.is_sure()));
    let names = headlines(suite, names);
    let mut by_name: BTreeMap<&str, Row<'_>> =
        rows.into_iter().map(|row| (row.name, row)).collect();
    let names = names.into_iter();
    names.filter_map(|name| by_name.remove(name)).collect()
}

fn cards(markup: &mut Markup, models: &[LabelledModel<'_>], measured: &[Suite]) {
    markup.element("div", &[("class", "suites")], |markup| {
        for suite in measured {
            let rows = chosen(models, *suite);
            markup.element("div", &[("class", "suite")], |markup| {
                markup.element("h3", &[], |markup| {
                    let target = format!("#{suite}");
                    markup.leaf("a", &[("href", &target)], suite.name());
                });
                if rows.is_empty() {
                    markup.leaf("p", &[("class", "none")], "no figure");
                }
                markup.element("dl", &[("class", "cards")], |markup| {
                    for row in rows {
                        for metric in row.metrics.iter().flatten() {
                            markup.element("div", &[("class", "card")], |markup| {
                                markup.element("dt", &[], |markup| {
                                    markup.text(&words(row.name));
                                    markup.text("\u{a0}");
                                    arrow(markup, metric.better);
                                });
                                markup.element("dd", &[], |markup| {
                                    value(markup, metric, row.digits());
                                    markup.text(" ");
                                    let n = format!("n = {}", metric.n);
                                    markup.leaf("span", &[("class", "n")], &n);
                                });
                            });
                        }
                    }
                });
            });
        }
    });
}

fn table(markup: &mut Markup, models: &[LabelledModel<'_>], measured: &[Suite]) {
    super::scrolling(markup, "Figures at a glance", |markup| {
        markup.element("table", &[("class", "figures several")], |markup| {
            markup.leaf("caption", &[("class", "spoken")], "Figures at a glance");
            head(markup, models);
            let columns = (models.len() + 3).to_string();
            for suite in measured {
                markup.element("tbody", &[], |markup| {
                    markup.element("tr", &[("class", "group")], |markup| {
                        let attributes = [("scope", "rowgroup"), ("colspan", columns.as_str())];
                        markup.element("th", &attributes, |markup| {
                            let target = format!("#{suite}");
                            markup.leaf("a", &[("href", &target)], suite.name());
                        });
                    });
                    for shown in chosen(models, *suite) {
                        row(markup, &shown, false);
                    }
                });
            }
        });
    });
}

/// The name without its suite, as words.
fn words(name: &str) -> String {
    let own = name.split_once('.').map_or(name, |(_, own)| own);
    own.replace('_', " ")
}
