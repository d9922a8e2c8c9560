//! Draws paths in a plane.

use std::fmt::Write as _;

use super::{
    axis::{Axis, drawable},
    markup::Markup,
};
use crate::findings::Trajectories;

const SIDE: f64 = 440.0;
const LEFT: f64 = 56.0;
const MARGIN: f64 = 14.0;
const BOTTOM: f64 = 30.0;
/// Most paths drawn; more would cover each other.
const PATHS: usize = 120;
/// Most points of a path.
const POINTS: usize = 240;

/// Range of both coordinates.
#[derive(Clone, Copy)]
pub(super) struct Extent([(f64, f64); 2]);

impl Extent {
    /// Common range of comparable paths.
    pub(super) fn of<'a>(all: impl Iterator<Item = &'a Trajectories>) -> Self {
        let mut ends = [(f64::INFINITY, f64::NEG_INFINITY); 2];
        for [x, y] in all.flat_map(|one| one.paths.iter().flatten()) {
            if drawable(*x) && drawable(*y) {
                let [(left, right), (low, high)] = ends;
                ends = [(left.min(*x), right.max(*x)), (low.min(*y), high.max(*y))];
            }
        }
        Self(ends.map(|(low, high)| if low > high { (0.0, 1.0) } else { (low, high) }))
    }

    /// Axes of equal length, with a margin.
    fn axes(self) -> [Axis; 2] {
        let [x, y] = self.0;
        let span = (x.1 - x.0).max(y.1 - y.0).max(1e-9) * 1.08;
        [x, y].map(|(low, high)| {
            let middle = f64::midpoint(low, high);
            // Shows spans below the precision of the numbers as one point.
            let span = span.max(middle.abs() * 1e-6);
            Axis::between(middle - span / 2.0, middle + span / 2.0, 5)
        })
    }
}

/// Paths with a caption; `model` if there are several.
pub(super) fn paths(
    markup: &mut Markup,
    drawn: &Trajectories,
    model: Option<&str>,
    extent: Extent,
) {
    markup.element("figure", &[("class", "paths")], |markup| {
        markup.element("figcaption", &[], |markup| {
            markup.leaf("strong", &[], &drawn.title);
            if let Some(model) = model {
                markup.text(" ");
                markup.leaf("span", &[("class", "model")], model);
            }
        });
        let count = drawn.paths.len();
        markup.element("p", &[("class", "marks")], |markup| {
            let kinds = [
                ("start", "M2 6a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z"),
                ("end", "M2.5 2.5h7v7h-7Z"),
            ];
            for (kind, shape) in kinds {
                let class = if kind == "start" {
                    "start c0"
                } else {
                    "end c0"
                };
                let attributes = [
                    ("viewBox", "0 0 12 12"),
                    ("class", "key"),
                    ("aria-hidden", "true"),
                ];
                markup.element("svg", &attributes, |markup| {
                    markup.void("path", &[("class", class), ("d", shape)]);
                });
                markup.leaf("span", &[], kind);
            }
            let shown = if count > PATHS {
                format!("the first {PATHS} of {count} episodes, colours repeat")
            } else if count > 8 {
                format!("{count} episodes, colours repeat")
            } else {
                format!("{count} paths, a colour each")
            };
            markup.leaf("span", &[], &shown);
        });
        drawing(markup, drawn, extent);
        if !drawn.caption.is_empty() {
            markup.leaf("p", &[("class", "caption")], &drawn.caption);
        }
    });
}

fn drawing(markup: &mut Markup, drawn: &Trajectories, extent: Extent) {
    let [x, y] = extent.axes();
    let floor = SIDE - BOTTOM;
    // Square, so that both axes have the same scale.
    let length = floor - MARGIN;
    let (x, y) = (x.drawn(LEFT, LEFT + length), y.drawn(floor, MARGIN));
    let told = format!(
        "{}: {} paths. {}",
        drawn.title,
        drawn.paths.len(),
        drawn.caption
    );
    let view = format!("0 0 {:.0} {SIDE:.0}", LEFT + length + MARGIN);
    let attributes = [
        ("viewBox", view.as_str()),
        ("role", "img"),
        ("aria-label", &told),
    ];
    markup.element("svg", &attributes, |markup| {
        for (place, text) in y.ticks() {
            let path = format!("M{LEFT} {place:.1}h{length}");
            markup.void("path", &[("class", "grid"), ("d", &path)]);
            let (at, below) = (format!("{:.1}", LEFT - 8.0), format!("{:.1}", place + 4.5));
            markup.leaf(
                "text",
                &[("x", &at), ("y", &below), ("text-anchor", "end")],
                &text,
            );
        }
        for (place, text) in x.ticks() {
            let path = format!("M{place:.1} {floor}V{MARGIN}");
            markup.void("path", &[("class", "grid"), ("d", &path)]);
            let (at, below) = (format!("{place:.1}"), format!("{:.1}", floor + 20.0));
            markup.leaf(
                "text",
                &[("x", &at), ("y", &below), ("text-anchor", "middle")],
                &text,
            );
        }
        for (number, points) in drawn.paths.iter().take(PATHS).enumerate() {
            path(markup, number, points, &x, &y);
        }
    });
}

fn path(markup: &mut Markup, number: usize, points: &[[f64; 2]], x: &Axis, y: &Axis) {
    let apart = points.len().div_ceil(POINTS).max(1);
    let last = points.len().saturating_sub(1);
    let kept = points.iter().enumerate();
    let places: Vec<(f64, f64)> = kept
        .filter(|(index, _)| index % apart == 0 || *index == last)
        .filter_map(|(_, [px, py])| x.place(*px).zip(y.place(*py)))
        .collect();
    let (Some((from_x, from_y)), Some((to_x, to_y))) = (places.first(), places.last()) else {
        return;
    };
    let mut line = String::new();
    for (px, py) in &places {
        let letter = if line.is_empty() { 'M' } else { 'L' };
        // Writing to a string cannot fail.
        write!(line, "{letter}{px:.1} {py:.1}").ok();
    }
    markup.element("g", &[("class", &format!("c{}", number % 8))], |markup| {
        markup.leaf("title", &[], &format!("episode {}", number + 1));
        markup.void("path", &[("class", "path"), ("d", &line)]);
        let start = format!(
            "M{:.1} {from_y:.1}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z",
            from_x - 4.0
        );
        markup.void("path", &[("class", "start"), ("d", &start)]);
        let end = format!("M{:.1} {:.1}h7v7h-7Z", to_x - 3.5, to_y - 3.5);
        markup.void("path", &[("class", "end"), ("d", &end)]);
    });
}
