//! The quantities of the paper's tables and figures, filled with the findings of models.

mod rows;

use std::collections::BTreeMap;

use serde_json::Value;

use crate::findings::{
    Metric, ModelFindings,
    card::{code, inline},
    number::Digits,
};
use rows::{ROWS, Row};

/// A page in Markdown: every quantity of the paper's tables and figures that one model on one set of bags has, with the values of
/// the models, their 95 % intervals and numbers of units, and the ranges that the paper prints for DiT-S; what was not measured,
/// and why; and the settings that differ from `protocol`, those of the paper.
#[must_use]
pub fn paper_page(findings: &[ModelFindings], protocol: &Value) -> String {
    let mut page = String::from("# The paper's tables and figures\n\n");
    let mut line = |text: &str| {
        page.push_str(text);
        page.push('\n');
    };
    for one in findings {
        let header = &one.header;
        line(&format!(
            "- {}: hash {}, {} episodes, SHA-256 of the data {}, seed {}, wm {}",
            inline(&header.model),
            code(&header.short_hash()),
            header.episodes,
            code(&header.data_digest),
            header.seed,
            inline(&header.version)
        ));
    }
    line("");
    line(
        "Each cell has a value, its 95 % bootstrap interval, and its number of units. The last two columns have the lowest and the \
         highest value that the paper prints for DiT-S on Bridge V2. They come from other data and larger networks.",
    );
    line("");
    let names: Vec<String> = findings
        .iter()
        .map(|one| inline(&one.header.model))
        .collect();
    line(&heading(&names.join(" | "), names.len()));
    let metrics: Vec<_> = findings.iter().map(ModelFindings::metrics).collect();
    let mut missing = Vec::new();
    for row in ROWS {
        let found: Vec<_> = metrics.iter().map(|all| find(all, row.figure)).collect();
        if found.iter().all(Option::is_none) {
            missing.push(row);
            continue;
        }
        let cells = found.iter().map(|found| found.map_or_else(dash, cell));
        line(&shown(row, &cells.collect::<Vec<_>>().join(" | ")));
    }
    line("");
    line("## Not measured");
    line("");
    if missing.is_empty() {
        line("Nothing.");
    } else {
        line(&heading("why", 1));
    }
    for row in missing {
        line(&shown(row, &why(findings, row.figure)));
    }
    line("");
    line("## Settings that differ from the paper's protocol");
    line("");
    let settings = findings.first().map(|one| &one.header.settings);
    let changes = settings.map_or_else(Vec::new, |settings| changes(settings, protocol));
    if changes.is_empty() {
        line("None.");
    } else {
        line("| setting | here | paper |");
        line("|---|---|---|");
    }
    for (name, here, paper) in changes {
        line(&format!(
            "| {} | {} | {} |",
            code(&name),
            inline(&here),
            inline(&paper)
        ));
    }
    page
}

/// The metric of this name, or the first that begins with it where a judge's name follows.
fn find<'a>(all: &BTreeMap<&str, &'a Metric>, figure: &str) -> Option<&'a Metric> {
    if figure.ends_with('_') {
        let mut following = all.range(figure..);
        return following
            .next()
            .filter(|(name, _)| name.starts_with(figure))
            .map(|(_, metric)| *metric);
    }
    all.get(figure).copied()
}

fn cell(metric: &Metric) -> String {
    let interval = metric.finite_interval();
    let ends = interval.map(|interval| (interval.low, interval.high));
    let digits = Digits::of([metric.value], ends);
    let ends = ends.map_or_else(String::new, |(low, high)| {
        format!(" {}", inline(&digits.interval(low, high)))
    });
    format!("{}{ends} ({})", digits.show(metric.value), metric.n)
}

fn dash() -> String {
    "–".to_owned()
}

/// The heading of a table of quantities with `count` columns of its own.
fn heading(own: &str, count: usize) -> String {
    let titles = format!(
        "| paper (section) | quantity | command, figure | {own} | paper: reconstruction | paper: semantic |"
    );
    format!("{titles}\n|{}", "---|".repeat(count + 5))
}

/// A quantity with the contents of the columns of its own.
fn shown(row: &Row, own: &str) -> String {
    let [reconstruction, semantic] = printed(row);
    format!(
        "| {} | {} | {} | {own} | {reconstruction} | {semantic} |",
        row.place,
        row.quantity,
        command(row.figure)
    )
}

/// Ranges of the reconstruction and of the semantic encoders.
fn printed(row: &Row) -> [String; 2] {
    let Some(printed) = &row.printed else {
        return [dash(), dash()];
    };
    [printed.reconstruction, printed.semantic].map(|[low, high]| format!("{low} to {high}"))
}

/// The command that measures a figure, and its name.
fn command(figure: &str) -> String {
    let (suite, name) = figure.split_once('.').unwrap_or((figure, ""));
    let judge = if name.ends_with('_') { "JUDGE" } else { "" };
    format!("`wm eval {suite}`, `{name}{judge}`")
}

/// Why no model has a figure.
fn why(findings: &[ModelFindings], figure: &str) -> String {
    let mut reasons: Vec<String> = Vec::new();
    for one in findings {
        for (name, why) in one.absent() {
            // A gap, or a rate by a judge, is missing with the figure from which it follows.
            if figure.starts_with(name) && !reasons.contains(&why) {
                reasons.push(why);
            }
        }
    }
    if reasons.is_empty() {
        return "the suite did not run, or an input is missing".to_owned();
    }
    inline(&reasons.join("; "))
}

/// Settings with another value than the protocol's: name, value here, value there.
fn changes(here: &Value, protocol: &Value) -> Vec<(String, String, String)> {
    let (mut own, mut paper) = (BTreeMap::new(), BTreeMap::new());
    flatten("", here, &mut own);
    flatten("", protocol, &mut paper);
    let names: std::collections::BTreeSet<&String> = own.keys().chain(paper.keys()).collect();
    let text = |values: &BTreeMap<String, String>, name| {
        let text = values.get(name).filter(|text| !text.is_empty());
        text.cloned().unwrap_or_else(dash)
    };
    let differing = names
        .into_iter()
        .filter(|name| own.get(*name) != paper.get(*name));
    let shown = differing.map(|name| (name.clone(), text(&own, name), text(&paper, name)));
    shown.collect()
}

/// The leaves of a value, by their paths.
fn flatten(path: &str, value: &Value, leaves: &mut BTreeMap<String, String>) {
    let join = |name: &str| match path {
        "" => name.to_owned(),
        path => format!("{path}.{name}"),
    };
    match value {
        Value::Object(members) => {
            for (name, member) in members {
                flatten(&join(name), member, leaves);
            }
        }
        Value::Array(members) => {
            for (index, member) in members.iter().enumerate() {
                flatten(&join(&index.to_string()), member, leaves);
            }
        }
        Value::String(text) => {
            leaves.insert(path.to_owned(), text.clone());
        }
        Value::Null | Value::Bool(_) | Value::Number(_) => {
            leaves.insert(path.to_owned(), value.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde_json::json;

    use super::*;
    use crate::findings::{Better, Header, Section, Suite};
    use crate::statistics::Interval;

    fn findings(name: &str) -> ModelFindings {
        let mut control = Section::new(Suite::Control);
        let error = Metric {
            interval: Some(Interval {
                low: 0.07,
                high: 0.1,
            }),
            ..Metric::plain(0.084, 12, Better::Lower, "error")
        };
        control.metric("cem_k1_error", error);
        let mut policy = Section::new(Suite::Policy);
        policy.metric(
            "success_by_qwen",
            Metric::plain(0.5, 8, Better::Higher, "rate"),
        );
        policy.absent("consensus_success", "one judge, but a consensus needs two");
        let mut fidelity = Section::new(Suite::Fidelity);
        fidelity.absent("lpips", "no network | none");
        ModelFindings {
            header: Header {
                settings: json!({"seed": 0, "control": {"searches": [{"k": 1, "windows": 12}]}}),
                ..Header::of(name, "0123456789", "space")
            },
            sections: vec![fidelity, control, policy],
        }
    }

    #[test]
    fn rows_have_values_reasons_and_changed_settings() {
        let protocol =
            json!({"seed": 0, "control": {"searches": [{"k": 1, "windows": 100}], "bound": 2.0}});
        let page = paper_page(&[findings("one"), findings("two_b")], &protocol);
        for expected in [
            "| two\\_b |",
            "| CEM error, k = 1 | `wm eval control`, `cem_k1_error` | 0.084 \\[0.070, 0.100\\] (12) | 0.084 \\[0.070, 0.100\\] (12) | .097 to .112 | .082 to .104 |",
            "| success rate by one judge | `wm eval policy`, `success_by_JUDGE` | 0.500 (8) | 0.500 (8) |",
            "| consensus success rate | `wm eval policy`, `consensus_success` | one judge, but a consensus needs two |",
            "| `wm eval fidelity`, `lpips_gap` | no network \\| none |",
            "| `control.searches.0.windows` | 12 | 100 |",
            "| `control.bound` | – | 2.0 |",
        ] {
            assert!(page.contains(expected), "{expected}\n{page}");
        }
        assert!(!page.contains("| `seed` |"), "{page}");
        let same = paper_page(&[findings("one")], &findings("one").header.settings);
        assert!(same.ends_with("None.\n"), "{same}");
    }

    #[test]
    fn each_figure_is_listed_once() {
        let mut names: Vec<&str> = ROWS.iter().map(|row| row.figure).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        for row in ROWS {
            let suite = row.figure.split('.').next().unwrap();
            assert!(
                Suite::ALL.iter().any(|known| known.name() == suite),
                "{suite}"
            );
        }
    }
}
