//! A suite's section: its question, figures and other content.

use std::collections::BTreeMap;

use super::{
    LabelledModel,
    chart::{Line, chart},
    figures::{figures, name},
    markup::Markup,
    paths::{Extent, paths},
    swatch,
};
use crate::findings::{Curve, Section, Series, Suite, TextTable, Trajectories};

/// Colour of lines that belong to no model.
const COMMON: usize = 7;

/// Most columns of a table beside another table.
const NARROW: usize = 6;

/// A part of a suite with its model.
type Of<'a, T> = (LabelledModel<'a>, &'a T);

pub(super) fn suite(markup: &mut Markup, suite: Suite, models: &[LabelledModel<'_>]) {
    let heading = format!("{suite}-heading");
    let attributes = [("id", suite.name()), ("aria-labelledby", heading.as_str())];
    markup.element("section", &attributes, |markup| {
        markup.leaf("p", &[("class", "eyebrow")], suite.name());
        markup.leaf("h2", &[("id", &heading)], suite.question());
        figures(markup, suite, models);
        curves(
            markup,
            &all(models, suite, |section| &section.curves),
            models.len(),
        );
        trajectories(
            markup,
            &all(models, suite, |section| &section.trajectories),
            models.len(),
        );
        tables(
            markup,
            &all(models, suite, |section| &section.tables),
            models.len(),
        );
        let shown = all(models, suite, |section| &section.pictures);
        if !shown.is_empty() {
            markup.leaf("h3", &[], "Pictures");
            markup.element("div", &[("class", "pictures")], |markup| {
                for (model, picture) in shown {
                    markup.element("figure", &[], |markup| {
                        let data = format!("data:image/png;base64,{}", picture.png);
                        markup.void("img", &[("src", &data), ("alt", &picture.caption)]);
                        markup.element("figcaption", &[], |markup| {
                            if models.len() > 1 {
                                labelled(markup, model);
                            }
                            markup.text(&picture.caption);
                        });
                    });
                }
            });
        }
        let notes = all(models, suite, |section| &section.notes);
        let notes = shared(notes.into_iter().map(|(model, note)| (model, note.clone())));
        if !notes.is_empty() {
            markup.leaf("h3", &[], "Notes");
            markup.element("ul", &[("class", "notes")], |markup| {
                for (note, of) in notes {
                    markup.element("li", &[], |markup| {
                        owners(markup, &of, models.len());
                        markup.text(&note);
                    });
                }
            });
        }
        absent(markup, suite, models);
    });
}

/// Parts of all models, in order.
fn all<'a, T>(
    models: &[LabelledModel<'a>],
    suite: Suite,
    part: impl Fn(&'a Section) -> &'a Vec<T>,
) -> Vec<Of<'a, T>> {
    let mut all = Vec::new();
    for model in models {
        let findings: &'a _ = model.findings;
        for section in findings.of(suite) {
            all.extend(part(section).iter().map(|one| (*model, one)));
        }
    }
    all
}

/// Groups equal parts of several models, in order of appearance.
fn shared<'a, T: PartialEq>(
    all: impl Iterator<Item = (LabelledModel<'a>, T)>,
) -> Vec<(T, Vec<LabelledModel<'a>>)> {
    let mut shared: Vec<(T, Vec<LabelledModel<'a>>)> = Vec::new();
    for (model, one) in all {
        match shared.iter_mut().find(|(other, _)| *other == one) {
            Some((_, of)) => of.push(model),
            None => shared.push((one, vec![model])),
        }
    }
    shared
}

/// The models of a part, unless it belongs to all.
fn owners(markup: &mut Markup, of: &[LabelledModel<'_>], models: usize) {
    if of.len() < models {
        for model in of {
            labelled(markup, *model);
        }
    }
}

fn labelled(markup: &mut Markup, model: LabelledModel<'_>) {
    markup.element("span", &[("class", "model")], |markup| {
        swatch(markup, model.number);
        markup.text(model.label);
    });
    markup.text(" ");
}

/// Draws curves of the same title in one chart.
fn curves(markup: &mut Markup, all: &[Of<'_, Curve>], models: usize) {
    let mut charts: Vec<Vec<Of<'_, Curve>>> = Vec::new();
    for (model, curve) in all {
        let same = charts.iter_mut().find(|chart| {
            let first = chart.first();
            first.is_some_and(|(_, first)| {
                (&first.title, &first.x, &first.y) == (&curve.title, &curve.x, &curve.y)
            })
        });
        match same {
            Some(chart) => chart.push((*model, curve)),
            None => charts.push(vec![(*model, curve)]),
        }
    }
    if charts.is_empty() {
        return;
    }
    markup.leaf("h3", &[], "Curves");
    markup.element("div", &[("class", "charts")], |markup| {
        for curves in charts {
            let Some((_, first)) = curves.first() else {
                continue;
            };
            let mut lines = Vec::new();
            // A line of all models, such as repeating the last frame, belongs to none.
            let common = |series: &Series| {
                models > 1
                    && curves.len() == models
                    && curves
                        .iter()
                        .all(|(_, curve)| curve.series.contains(series))
            };
            for (model, curve) in &curves {
                for (number, series) in curve.series.iter().enumerate() {
                    if common(series) {
                        if model.number == 0 {
                            lines.push(Line {
                                name: series.name.clone(),
                                colour: COMMON,
                                common: true,
                                dash: number,
                                points: &series.points,
                                band: &series.band,
                            });
                        }
                        continue;
                    }
                    // Several models have a colour each, and dashes by line.
                    let (name, colour, dash) = if models == 1 {
                        (series.name.clone(), number, number / 8)
                    } else if curve.series.iter().filter(|one| !common(one)).count() == 1 {
                        (model.label.to_owned(), model.number, 0)
                    } else {
                        let name = format!("{}: {}", model.label, series.name);
                        (name, model.number, number)
                    };
                    lines.push(Line {
                        name,
                        colour,
                        common: false,
                        dash,
                        points: &series.points,
                        band: &series.band,
                    });
                }
            }
            // Common lines come last in the legend.
            lines.sort_by_key(|line| line.common);
            chart(markup, &first.title, &first.x, &first.y, &lines);
        }
    });
}

/// Draws paths of the same title side by side at the same scale.
fn trajectories(markup: &mut Markup, all: &[Of<'_, Trajectories>], models: usize) {
    if all.is_empty() {
        return;
    }
    let mut places: Vec<&str> = Vec::new();
    for (_, drawn) in all {
        if !places.contains(&drawn.title.as_str()) {
            places.push(&drawn.title);
        }
    }
    markup.leaf("h3", &[], "Paths");
    markup.element("div", &[("class", "charts")], |markup| {
        for title in places {
            let same = || all.iter().filter(|(_, drawn)| drawn.title == title);
            let extent = Extent::of(same().map(|(_, drawn)| *drawn));
            for (model, drawn) in same() {
                paths(markup, drawn, (models > 1).then_some(model.label), extent);
            }
        }
    });
}

fn tables(markup: &mut Markup, all: &[Of<'_, TextTable>], models: usize) {
    if all.is_empty() {
        return;
    }
    markup.leaf("h3", &[], "Tables");
    markup.element("div", &[("class", "tables")], |markup| {
        for (shown, of) in shared(all.iter().copied()) {
            table(markup, shown, if of.len() < models { &of } else { &[] });
        }
    });
}

/// A table and its models.
fn table(markup: &mut Markup, table: &TextTable, of: &[LabelledModel<'_>]) {
    let class = if table.header.len() > NARROW {
        "wide"
    } else {
        "narrow"
    };
    markup.element("div", &[("class", class)], |markup| {
        super::scrolling(markup, &table.title, |markup| {
            markup.element("table", &[("class", "text")], |markup| {
                markup.element("caption", &[], |markup| {
                    for model in of {
                        labelled(markup, *model);
                    }
                    markup.text(&table.title);
                });
                markup.element("thead", &[], |markup| {
                    markup.element("tr", &[], |markup| {
                        for (column, name) in table.header.iter().enumerate() {
                            let attributes = [("scope", "col"), ("class", side(table, column))];
                            markup.leaf("th", &attributes, name);
                        }
                    });
                });
                markup.element("tbody", &[], |markup| {
                    for row in &table.rows {
                        markup.element("tr", &[], |markup| cells(markup, table, row));
                    }
                });
            });
        });
    });
}

fn cells(markup: &mut Markup, table: &TextTable, row: &[String]) {
    for (column, cell) in row.iter().enumerate() {
        if column == 0 {
            markup.leaf("th", &[("scope", "row")], cell);
        } else {
            markup.leaf("td", &[("class", side(table, column))], cell);
        }
    }
}

/// Aligns columns of numbers right.
fn side(table: &TextTable, column: usize) -> &'static str {
    let mut cells = table.rows.iter().filter_map(|row| row.get(column));
    let numbers =
        cells.all(|cell| cell.starts_with(|c: char| c.is_ascii_digit() || "-−+–.<≈".contains(c)));
    if numbers && column > 0 {
        "number"
    } else {
        "words"
    }
}

fn absent(markup: &mut Markup, suite: Suite, models: &[LabelledModel<'_>]) {
    let mut reasons: BTreeMap<String, Vec<(String, Vec<LabelledModel<'_>>)>> = BTreeMap::new();
    for model in models {
        for (metric, why) in model.findings.absent_of(suite) {
            let reasons = reasons.entry(metric.to_owned()).or_default();
            match reasons.iter_mut().find(|(other, _)| *other == why) {
                Some((_, of)) => of.push(*model),
                None => reasons.push((why, vec![*model])),
            }
        }
    }
    if reasons.is_empty() {
        return;
    }
    markup.leaf("h3", &[], "Not measured");
    markup.element("dl", &[("class", "absent")], |markup| {
        for (metric, reasons) in &reasons {
            markup.element("dt", &[], |markup| name(markup, metric));
            for (why, of) in reasons {
                markup.element("dd", &[], |markup| {
                    owners(markup, of, models.len());
                    markup.text(why);
                });
            }
        }
    });
}
