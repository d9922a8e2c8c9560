//! A curve as SVG.
//!
//! plotters is not used: its SVG has fixed colours and no classes. Here `report.css` gives colours, dashes and the dark theme,
//! and elements have texts for screen readers.

use std::fmt::Write as _;

use super::{
    axis::{Axis, drawable},
    markup::Markup,
};
use crate::findings::number::Digits;

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 300.0;
/// Left margin, for tick labels.
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
/// Top margin, for the name of the values.
const TOP: f64 = 34.0;
const BOTTOM: f64 = 50.0;
/// Most points of a line; more only enlarge the file.
const POINTS: usize = 500;
/// Most points with a mark.
const MARKED: usize = 32;
/// Most values in the table below the curve.
const TABLED: usize = 240;
/// Letters that fit along an axis.
const LETTERS: usize = 54;

/// A line of a chart.
pub(super) struct Line<'a> {
    pub(super) name: String,
    /// Index of colour and dashes.
    pub(super) colour: usize,
    pub(super) dash: usize,
    /// Whether the line is the same for all models.
    pub(super) common: bool,
    pub(super) points: &'a [[f64; 2]],
    pub(super) band: &'a [[f64; 2]],
}

/// A chart with a legend above and a table of its values below.
pub(super) fn chart(markup: &mut Markup, title: &str, x: &str, y: &str, lines: &[Line<'_>]) {
    markup.element("figure", &[("class", "chart")], |markup| {
        markup.element("figcaption", &[], |markup| {
            markup.leaf("strong", &[], title);
        });
        legend(markup, lines);
        drawing(markup, title, x, y, lines);
        table(markup, x, y, lines);
    });
}

fn legend(markup: &mut Markup, lines: &[Line<'_>]) {
    if lines.iter().all(|line| line.name.is_empty()) {
        return;
    }
    markup.element("ul", &[("class", "legend")], |markup| {
        for line in lines {
            markup.element("li", &[], |markup| {
                let attributes = [
                    ("viewBox", "0 0 26 10"),
                    ("class", "key"),
                    ("aria-hidden", "true"),
                ];
                markup.element("svg", &attributes, |markup| {
                    markup.void("path", &[("class", &class(line, "line")), ("d", "M1 5H25")]);
                    mark(markup, line, 13.0, 5.0, None);
                });
                markup.text(&line.name);
            });
        }
    });
}

fn drawing(markup: &mut Markup, title: &str, x_name: &str, y_name: &str, lines: &[Line<'_>]) {
    let points = || lines.iter().flat_map(|line| line.points);
    let bands = lines.iter().flat_map(|line| line.band.iter().flatten());
    let x = Axis::of_places(points().map(|[x, _]| *x), 6).drawn(LEFT + 8.0, WIDTH - RIGHT - 8.0);
    let y = Axis::of_values(points().map(|[_, y]| *y).chain(bands.copied()), 5)
        .drawn(HEIGHT - BOTTOM, TOP);
    let names: Vec<&str> = lines.iter().map(|line| line.name.as_str()).collect();
    let description = format!("{title}: {y_name} over {x_name}; {}", names.join(", "));
    let view = format!("0 0 {WIDTH} {HEIGHT}");
    let attributes = [
        ("viewBox", view.as_str()),
        ("role", "img"),
        ("aria-label", &description),
    ];
    markup.element("svg", &attributes, |markup| {
        for (place, text) in y.ticks() {
            let path = format!("M{LEFT} {place:.1}H{}", WIDTH - RIGHT);
            markup.void("path", &[("class", "grid"), ("d", &path)]);
            label(markup, LEFT - 8.0, place + 4.5, "end", &text);
        }
        let floor = HEIGHT - BOTTOM;
        markup.void(
            "path",
            &[
                ("class", "axis"),
                ("d", &format!("M{LEFT} {floor}H{}", WIDTH - RIGHT)),
            ],
        );
        for (place, text) in x.ticks() {
            let path = format!("M{place:.1} {floor}v5");
            markup.void("path", &[("class", "axis"), ("d", &path)]);
            label(markup, place, floor + 20.0, "middle", &text);
        }
        let middle = (LEFT + WIDTH - RIGHT) / 2.0;
        named(markup, middle, HEIGHT - 8.0, "middle", x_name);
        named(markup, 4.0, 16.0, "start", y_name);
        for line in lines {
            band(markup, line, &x, &y);
        }
        for line in lines {
            path(markup, line, &x, &y);
        }
    });
}

fn band(markup: &mut Markup, line: &Line<'_>, x: &Axis, y: &Axis) {
    let ends: Vec<(f64, f64, f64)> = thinned(line.points, POINTS)
        .into_iter()
        .filter_map(|(index, [at, _])| {
            let [low, high] = *line.band.get(index)?;
            Some((x.place(at)?, y.place(low)?, y.place(high)?))
        })
        .collect();
    if ends.len() < 2 {
        return;
    }
    let mut path = String::new();
    let upper = ends.iter().map(|(x, _, high)| (x, high));
    let lower = ends.iter().rev().map(|(x, low, _)| (x, low));
    for (x, y) in upper.chain(lower) {
        let letter = if path.is_empty() { 'M' } else { 'L' };
        // Writing to a string cannot fail.
        write!(path, "{letter}{x:.1} {y:.1}").ok();
    }
    path.push('Z');
    let class = class(line, "band");
    markup.void("path", &[("class", &class), ("d", &path)]);
}

fn path(markup: &mut Markup, line: &Line<'_>, x: &Axis, y: &Axis) {
    let mut path = String::new();
    let mut joined = false;
    let mut marks = Vec::new();
    for (index, [at, value]) in thinned(line.points, POINTS) {
        let Some((px, py)) = x.place(at).zip(y.place(value)) else {
            joined = false;
            continue;
        };
        let letter = if joined { 'L' } else { 'M' };
        write!(path, "{letter}{px:.1} {py:.1}").ok();
        joined = true;
        marks.push((index, px, py));
    }
    if path.is_empty() {
        return;
    }
    let class = class(line, "line");
    markup.void("path", &[("class", &class), ("d", &path)]);
    if line.points.len() > MARKED {
        return;
    }
    for (index, px, py) in marks {
        let (Some([at, value]), band) = (line.points.get(index), line.band.get(index)) else {
            continue;
        };
        let digits = Digits::of([*value], band.map(|[low, high]| (*low, *high)));
        let mut description = format!(
            "{}: {}",
            Digits::of([*at], []).show(*at),
            digits.show(*value)
        );
        if let Some([low, high]) = band {
            write!(description, " {}", digits.interval(*low, *high)).ok();
        }
        if !line.name.is_empty() {
            description = format!("{}, {description}", line.name);
        }
        mark(markup, line, px, py, Some(&description));
    }
}

/// Distinct marks for neighbouring colours, so that colour is not the only difference.
fn mark(markup: &mut Markup, line: &Line<'_>, x: f64, y: f64, description: Option<&str>) {
    let shape = match line.colour % 4 {
        0 => format!(
            "M{:.1} {y:.1}a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0Z",
            x - 3.5
        ),
        1 => format!("M{:.1} {:.1}h6.4v6.4h-6.4Z", x - 3.2, y - 3.2),
        2 => format!("M{x:.1} {:.1}l4.2 7.4h-8.4Z", y - 4.4),
        _ => format!("M{x:.1} {:.1}l4.5 4.5l-4.5 4.5l-4.5 -4.5Z", y - 4.5),
    };
    let class = class(line, "mark");
    let attributes = [("class", class.as_str()), ("d", &shape)];
    match description {
        Some(description) => {
            markup.element("path", &attributes, |markup| {
                markup.leaf("title", &[], description);
            });
        }
        None => markup.void("path", &attributes),
    }
}

fn class(line: &Line<'_>, kind: &str) -> String {
    format!("{kind} c{} d{}", line.colour % 8, line.dash % 4)
}

fn label(markup: &mut Markup, x: f64, y: f64, anchor: &str, text: &str) {
    let (x, y) = (format!("{x:.1}"), format!("{y:.1}"));
    markup.leaf(
        "text",
        &[("x", &x), ("y", &y), ("text-anchor", anchor)],
        text,
    );
}

fn named(markup: &mut Markup, x: f64, y: f64, anchor: &str, text: &str) {
    let (x, y) = (format!("{x:.1}"), format!("{y:.1}"));
    let mut shown: String = text.chars().take(LETTERS).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    let attributes = [
        ("x", x.as_str()),
        ("y", &y),
        ("text-anchor", anchor),
        ("class", "name"),
    ];
    markup.leaf("text", &attributes, &shown);
}

/// About `limit` of the points with their indices: lowest and highest of each stretch.
fn thinned(points: &[[f64; 2]], limit: usize) -> Vec<(usize, [f64; 2])> {
    let numbered = points.iter().copied().enumerate();
    if points.len() <= limit {
        return numbered.collect();
    }
    let all: Vec<(usize, [f64; 2])> = numbered.filter(|(_, [_, y])| drawable(*y)).collect();
    let stretch = all.len().div_ceil(limit.max(2) / 2).max(1);
    let mut kept = Vec::new();
    for stretch in all.chunks(stretch) {
        let by_value = |a: &&(usize, [f64; 2]), b: &&(usize, [f64; 2])| a.1[1].total_cmp(&b.1[1]);
        let low = stretch.iter().min_by(by_value);
        let high = stretch.iter().max_by(by_value);
        let mut pair: Vec<_> = low.into_iter().chain(high).copied().collect();
        pair.sort_unstable_by_key(|(index, _)| *index);
        pair.dedup_by_key(|(index, _)| *index);
        kept.extend(pair);
    }
    kept
}

/// The values as a table for screen readers, for short curves only.
fn table(markup: &mut Markup, x: &str, y: &str, lines: &[Line<'_>]) {
    let points = || lines.iter().flat_map(|line| line.points);
    let mut places: Vec<f64> = points()
        .map(|[x, _]| *x)
        .filter(|x| x.is_finite())
        .collect();
    places.sort_unstable_by(f64::total_cmp);
    places.dedup();
    if places.is_empty() || places.len() * lines.len() > TABLED {
        return;
    }
    let digits = Digits::of(points().map(|[_, y]| *y).filter(|y| y.is_finite()), []);
    let digits_of_x = Digits::of(places.iter().copied(), []);
    markup.element("details", &[("class", "values")], |markup| {
        markup.leaf("summary", &[], "Values");
        super::scrolling(markup, "Values", |markup| {
            markup.element("table", &[], |markup| {
                markup.leaf("caption", &[("class", "spoken")], y);
                markup.element("thead", &[], |markup| {
                    markup.element("tr", &[], |markup| {
                        markup.leaf("th", &[("scope", "col")], x);
                        for line in lines {
                            let name = if line.name.is_empty() { y } else { &line.name };
                            markup.leaf("th", &[("scope", "col"), ("class", "number")], name);
                        }
                    });
                });
                markup.element("tbody", &[], |markup| {
                    for place in &places {
                        markup.element("tr", &[], |markup| {
                            markup.leaf("th", &[("scope", "row")], &digits_of_x.show(*place));
                            for line in lines {
                                let value = line.points.iter().find(|[x, _]| x == place);
                                let text = match value {
                                    Some([_, value]) if value.is_finite() => digits.show(*value),
                                    _ => "–".to_owned(),
                                };
                                markup.leaf("td", &[("class", "number")], &text);
                            }
                        });
                    }
                });
            });
        });
    });
}
