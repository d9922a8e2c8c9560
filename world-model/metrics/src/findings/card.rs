//! MODEL.md: what a model is, and is not, for those who are to decide whether to use it.

use std::{collections::BTreeMap, fmt::Write as _};

use serde::{Deserialize, Serialize};

use crate::findings::{Metric, ModelFindings, Suite, number::Digits};

/// What of a model no measurement tells.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CardAbout {
    /// Its name.
    pub name: String,
    /// What it was trained on, with licences.
    pub data: Vec<String>,
    /// How it was trained: settings and their values.
    pub recipe: Vec<(String, String)>,
    /// What is to be known of the figures, as how much was measured.
    pub notes: Vec<String>,
    /// What it cannot do.
    pub limits: Vec<String>,
    /// What it must not be used for, besides what no world model must.
    pub uses_refused: Vec<String>,
    /// By which it can be made and measured again, a line each.
    pub commands: Vec<String>,
}

/// What holds for every world model of this suite.
const LIMITS: [&str; 3] = [
    "It knows only what its training data show: other robots, cameras, scenes and actions are guesses.",
    "Where several futures are possible, a prediction may be their mean, which blurs, and is none of them.",
    "Errors grow with every imagined step; figures at one horizon say nothing of longer ones.",
];

const USES_REFUSED: [&str; 3] = [
    "As the only safety check of a robot, or in place of an emergency stop, a limit of force, or a person who watches.",
    "As proof that a policy is safe or works: an imagined success is a hint which real trials to make.",
    "On a robot, camera or scene other than its data's, without being measured on recordings of them first.",
];

/// A model card in Markdown, with front matter as Hugging Face reads it.
#[must_use]
pub fn model_card(findings: &ModelFindings, about: &CardAbout) -> String {
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
        "A latent world model: from the last camera frames and the actions to come it predicts the latents of the frames to \
         come.",
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
        "Not told.",
    );
    line("");
    line("## Recipe");
    line("");
    if about.recipe.is_empty() {
        line("Not told.");
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
        "Measured on {} ({} episodes, seed {}, SHA-256 of the data {}). ↑ more is better, ↓ less is better; in brackets 95 % \
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
            "Left out: {}.",
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
    line("## What it must not be used for");
    line("");
    let own = about.uses_refused.iter().map(String::as_str);
    list(&mut line, own.chain(USES_REFUSED), "");
    line("");
    line("## How to reproduce");
    line("");
    if about.commands.is_empty() {
        line("Not told.");
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
        line("| Figure | Value | 95 % interval | n | What it says |");
        line("| --- | ---: | ---: | ---: | --- |");
    }
    for (name, metric) in own {
        let interval = metric.finite_interval();
        let ends = interval.map(|interval| (interval.low, interval.high));
        let digits = Digits::of([metric.value], ends);
        let mut value = digits.show(metric.value);
        if !metric.unit.is_empty() {
            // Writing to a string does not fail.
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
    let mut told: Vec<&str> = Vec::new();
    for item in items {
        if !told.contains(&item) {
            line(&format!("- {}", inline(item)));
            told.push(item);
        }
    }
    if told.is_empty() {
        line(none);
    }
}

/// One line of text in which nothing is markup but links, which are only text that a reader follows if they want to.
fn inline(text: &str) -> String {
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

/// Code, with more backticks around it than are in it. A bar would end the cell of a table even here, and a backslash before
/// it undo its escape: text with a bar is marked up as HTML.
fn code(text: &str) -> String {
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
    let runs = text.split(|c| c != '`').map(str::len);
    runs.max().unwrap_or(0)
}

/// A string of YAML, of which JSON's are a part.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
