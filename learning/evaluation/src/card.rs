//! MODEL.md: the model card of findings.

use std::{fs, path::Path};

use anyhow::{Context as _, Result, ensure};
use sha2::{Digest as _, Sha256};
use wm_metrics::findings::{CardDetails, ModelFindings, model_card};

/// The name of the file in a model's folder.
pub const FILE: &str = "MODEL.md";
const SEAL: &str = "<!-- wm replaces this file as long as the SHA-256 of what is above is ";

/// What became of a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// It was written.
    Yes,
    /// A card that somebody wrote or changed is there, and stays.
    Kept,
}

/// Whether a card may be written to `path`: nobody has changed what is there.
///
/// # Errors
/// If what is there cannot be read.
pub fn is_free(path: &Path) -> Result<bool> {
    if !path.exists() {
        return Ok(true);
    }
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    Ok(is_ours(&text))
}

/// Writes the card of findings to `path`. A card that is there is replaced only if nobody has changed it.
///
/// # Errors
/// If the file cannot be read or written.
pub fn write(path: &Path, findings: &ModelFindings, about: &CardDetails) -> Result<Written> {
    let name = || path.display().to_string();
    if !is_free(path)? {
        return Ok(Written::Kept);
    }
    let card = sealed(&model_card(findings, about));
    // In one move: half a card would count as changed.
    let partial = path.with_extension("partial");
    fs::write(&partial, card).with_context(|| partial.display().to_string())?;
    fs::rename(&partial, path).with_context(name)?;
    Ok(Written::Yes)
}

/// What a YAML file says of a model: name, data, recipe, limits, uses_refused, commands.
///
/// # Errors
/// If it cannot be read, or says something else.
pub fn about(path: &Path) -> Result<CardDetails> {
    let name = || path.display().to_string();
    let text = fs::read_to_string(path).with_context(name)?;
    let about: CardDetails = serde_yaml_ng::from_str(&text).with_context(name)?;
    ensure!(!about.name.is_empty(), "{}: `name` is empty", name());
    Ok(about)
}

/// How much was measured, by the settings.
pub(crate) fn extent(settings: &serde_json::Value) -> String {
    let of = |path: &str| match settings.pointer(path) {
        Some(value) => value.to_string(),
        None => "-".to_owned(),
    };
    let searches = settings.pointer("/control/searches");
    let searches = searches.and_then(serde_json::Value::as_array);
    let searches = searches.into_iter().flatten().map(|search| {
        let of = |key: &str| search.get(key).map_or("-".to_owned(), ToString::to_string);
        format!("{} windows at k = {}", of("windows"), of("k"))
    });
    let searches: Vec<String> = searches.collect();
    format!(
        "At most: decoded rollouts of {} steps of {} episodes; searches of {} x {} candidates ({}); {} windows of responses to \
         actions. All settings: --json.",
        of("/fidelity/steps"),
        of("/fidelity/episodes"),
        of("/control/iterations"),
        of("/control/population"),
        match searches.is_empty() {
            true => "none".to_owned(),
            false => searches.join(", "),
        },
        of("/control/response_windows"),
    )
}

fn sealed(card: &str) -> String {
    format!("{card}\n{SEAL}{} -->\n", digest(card))
}

fn is_ours(text: &str) -> bool {
    let Some((card, seal)) = text.rsplit_once(SEAL) else {
        return false;
    };
    let card = card.strip_suffix('\n').unwrap_or(card);
    seal.strip_suffix(" -->\n") == Some(&digest(card))
}

fn digest(card: &str) -> String {
    Sha256::digest(card)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_that_somebody_changed_stays() {
        let card = sealed("# a model\n\nof ours\n");
        assert!(is_ours(&card));
        assert!(!is_ours(&card.replace("of ours", "of mine")));
        assert!(!is_ours("# a model\n"));
        assert!(!is_ours(""));
    }
}
