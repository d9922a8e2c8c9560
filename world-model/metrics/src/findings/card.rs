//! MODEL.md: properties and limits of a model, for those who decide whether to use it.

use std::{collections::BTreeMap, fmt::Write as _};

use serde::{Deserialize, Serialize};

use crate::findings::{Metric, ModelFindings, Suite, number::Digits};

/// The parts of a model card that are not measured.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CardDetails {
    /// Name of the model.
    pub name: String,
    /// Training data with licences.
    pub data: Vec<String>,
    /// Training settings and their values.
    pub recipe: Vec<(String, String)>,
    /// Remarks on the figures, such as how much was measured.
    pub notes: Vec<String>,
    /// Limits of this model.
    pub limits: Vec<String>,
    /// Uses to avoid, in addition to those of every world model.
    pub uses_refused: Vec<String>,
    /// Commands that train and measure it again, one per line.
    pub commands: Vec<String>,
}

/// Limits of every world model of this suite.
const LIMITS: [&str; 3] = [
    "It knows only what its training data show: other robots, cameras, scenes and actions are guesses.",
    "If several futures are possible, a prediction may be their blurred mean, which is none of them.",
    "Errors grow with every imagined step; figures at one horizon do not apply to longer ones.",
];

const USES_REFUSED: [&str; 3] = [
    "As the only safety check of a robot, or in place of an emergency stop, a limit of force, or a human supervisor.",
    "As proof that a policy is safe or works: an imagined success only suggests which real trials to run.",
    "On a robot, camera or scene other than its data's, unless measured on recordings of them first.",
];

/// A model card in Markdown, with front matter as Hugging Face reads it.
#[must_use]
pub fn model_card(findings: &ModelFindings, about: &CardDetails) -> String {
    let mut card = String::new();
    let header = &findings.header;
    let mut line = |text: &str| {
        card.push_str(text);
        card.push('\n');
    };
    line("---");
    line(&format!("model_name: {}", quoted(&about.name)));
    line("pipeline_tag: robotics");
    line("tags: [world-model, robotics, ros2]");
    line("---");
    line("");
    line(&format!("# {}", inline(&about.name)));
    line("");
    line(
        "A latent world model: it predicts the latents of future frames from the last camera frames and the next actions.",
    );
    line("");
    line("| | |");
    line("| --- | --- |");
    for (name, value) in [
        ("Latent space", inline(&header.space)),
        ("SHA-256 of the weights", code(&header.hash)),
        ("Measured by", format!("wm {}", inline(&header.version))),
    ] {
        line(&format!("| {name} | {value} |"));
    }
    line("");
    line("## Data");
    line("");
    list(
        &mut line,
        about.data.iter().map(String::as_str),
        "Not specified.",
    );
    line("");
    line("## Recipe");
    line("");
    if about.recipe.is_empty() {
        line("Not specified.");
    } else {
        line("| Setting | Value |");
        line("| --- | --- |");
        for (name, value) in &about.recipe {
            line(&format!("| {} | {} |", inline(name), inline(value)));
        }
    }
    line("");
    line("## Figures");
    line("");
    let data: Vec<String> = header.data.iter().map(|path| code(path)).collect();
    line(&format!(
        "Measured on {} ({} episodes, seed {}, SHA-256 of the data {}). ↑ higher is better, ↓ lower is better; brackets: 95 % \
         bootstrap intervals over n units.",
        if data.is_empty() {
            "data without a path".to_owned()
        } else {
            data.join(", ")
        },
        header.episodes,
        header.seed,
        code(&header.data_digest),
    ));
    if !header.left_out.is_empty() {
        line("");
        line(&format!(
            "Excluded: {}.",
            inline(&header.left_out.join("; "))
        ));
    }
    for note in &about.notes {
        line("");
        line(&inline(note));
    }
    for suite in Suite::ALL {
        figures(&mut line, findings, suite);
    }
    line("");
    line("## Limits");
    line("");
    let own = about.limits.iter().map(String::as_str);
    list(&mut line, own.chain(LIMITS), "");
    line("");
    line("## Must not be used for");
    line("");
    let own = about.uses_refused.iter().map(String::as_str);
    list(&mut line, own.chain(USES_REFUSED), "");
    line("");
    line("## How to reproduce");
    line("");
    if about.commands.is_empty() {
        line("Not specified.");
    } else {
        let commands = about.commands.join("\n");
        let fence = fence(&commands);
        line(&format!("{fence}sh\n{commands}\n{fence}"));
    }
    card
}

fn figures(line: &mut impl FnMut(&str), findings: &ModelFindings, suite: Suite) {
    let metrics = findings.metrics();
    let own: Vec<(&str, &Metric)> = metrics
        .into_iter()
        .filter(|(name, _)| {
            findings
                .of(suite)
                .any(|section| section.metrics.contains_key(*name))
        })
        .collect();
    let absent = findings.absent_of(suite);
    if own.is_empty() && absent.is_empty() {
        return;
    }
    line("");
    line(&format!("### {}", suite.question()));
    line("");
    if !own.is_empty() {
        line("| Figure | Value | 95 % interval | n | Meaning |");
        line("| --- | ---: | ---: | ---: | --- |");
    }
    for (name, metric) in own {
        let interval = metric.finite_interval();
        let ends = interval.map(|interval| (interval.low, interval.high));
        let digits = Digits::of([metric.value], ends);
        let mut value = digits.show(metric.value);
        if !metric.unit.is_empty() {
            // Writing to a string cannot fail.
            write!(value, " {}", inline(&metric.unit)).ok();
        }
        line(&format!(
            "| {} {} | {value} | {} | {} | {} |",
            code(name),
            metric.better.arrow(),
            ends.map_or_else(|| "–".to_owned(), |(low, high)| digits.interval(low, high)),
            metric.n,
            inline(&metric.about),
        ));
    }
    if !absent.is_empty() {
        line("");
        line("Not measured:");
        line("");
        let mut names_by_reason: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (name, why) in absent {
            names_by_reason.entry(why).or_default().push(code(name));
        }
        for (why, names) in names_by_reason {
            line(&format!("- {}: {}", names.join(", "), inline(&why)));
        }
    }
}

fn list<'a>(line: &mut impl FnMut(&str), items: impl Iterator<Item = &'a str>, none: &str) {
    let mut listed: Vec<&str> = Vec::new();
    for item in items {
        if !listed.contains(&item) {
            line(&format!("- {}", inline(item)));
            listed.push(item);
        }
    }
    if listed.is_empty() {
        line(none);
    }
}

/// One line of text without markup; links become plain text.
pub(super) fn inline(text: &str) -> String {
    let mut escaped = String::new();
    for character in text.chars() {
        match character {
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '#' | '~' => {
                escaped.push('\\');
                escaped.push(character);
            }
            '&' => escaped.push_str("&amp;"),
            _ if character.is_control() => escaped.push(' '),
            _ => escaped.push(character),
        }
    }
    escaped
}

/// Inline code, with more backticks around it than in it. Text with a bar becomes HTML instead: the bar would end a
/// table cell even here, and a backslash would undo its escape.
pub(super) fn code(text: &str) -> String {
    if text.contains('|') {
        return format!("<code>{}</code>", inline(text));
    }
    let text: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if !text.contains('`') {
        return format!("`{text}`");
    }
    let ticks = "`".repeat(longest_run(&text) + 1);
    format!("{ticks} {text} {ticks}")
}

fn fence(text: &str) -> String {
    "`".repeat((longest_run(text) + 1).max(3))
}

fn longest_run(text: &str) -> usize {
    // `split` gives at least one part.
    let runs = text.split(|c| c != '`').map(str::len);
    runs.max().unwrap_or(0)
}

/// A YAML string in JSON syntax, which is valid YAML.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
