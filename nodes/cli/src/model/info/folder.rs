//! The parts of a model folder.

use anyhow::Result;
use serde_json::{Value, json};
use std::fmt;
use wm_model::LatentSpace;
use wm_zoo::{DISTANCE_FILE, Error, IDM_FILE, ModelFolder, PROBE_FILE, SUBGOALS_FILE, Unfinished};

/// A model; reads only the encoder's weights.
pub(super) struct Folder {
    name: String,
    space: LatentSpace,
    /// The parts; if missing, with the consequence.
    parts: Vec<(&'static str, Result<(), &'static str>)>,
    unfinished: Vec<Unfinished>,
    has_transition: bool,
}

impl Folder {
    /// Reads a model.
    ///
    /// # Errors
    /// There is no such model, or a file cannot be used.
    pub(super) fn open(name: &str) -> Result<Self> {
        let model = ModelFolder::open(name)?;
        let (has_decoder, has_probe) = match model.described() {
            None => (true, false),
            Some(folder) => {
                let description = folder.description();
                (description.decoder.is_some(), description.probe.is_some())
            }
        };
        let has = |file: &str| Ok::<_, Error>(model.weights(file)?.is_some());
        let there = |is_there: bool, otherwise| match is_there {
            true => Ok(()),
            false => Err(otherwise),
        };
        let has_transition = model.has_transition();
        Ok(Self {
            name: name.to_owned(),
            space: model.space()?,
            parts: vec![
                ("encoder", Ok(())),
                ("decoder", there(has_decoder, "no pictures of predictions")),
                ("transition", there(has_transition, "no predictions")),
                (
                    "idm",
                    there(
                        has(IDM_FILE)?,
                        "the planners idm and idm+... do not work with it",
                    ),
                ),
                (
                    "subgoals",
                    there(
                        has(SUBGOALS_FILE)?,
                        "the planners subgoals+... do not work with it",
                    ),
                ),
                (
                    "distance",
                    there(
                        has(DISTANCE_FILE)?,
                        "plans do not tell the model steps to their goal",
                    ),
                ),
                (
                    "probe",
                    there(has_probe || has(PROBE_FILE)?, "no success probabilities"),
                ),
            ],
            unfinished: model.unfinished()?,
            has_transition,
        })
    }

    /// For programs.
    pub(super) fn json(&self) -> Value {
        let parts = self.parts.iter().filter(|(_, is_there)| is_there.is_ok());
        let marks = self.unfinished.iter();
        let marks = marks.map(|mark| {
            let far = json!({"step": mark.step, "steps": mark.steps});
            (mark.part.clone(), far)
        });
        json!({
            "name": self.name,
            "latent_space": self.space,
            "parts": parts.map(|(part, _)| *part).collect::<Vec<_>>(),
            "unfinished": marks.collect::<serde_json::Map<_, _>>(),
        })
    }
}

impl fmt::Display for Folder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, space, .. } = self;
        writeln!(f, "{name}: latent space {space}")?;
        for (part, is_there) in &self.parts {
            match is_there {
                Ok(()) => writeln!(f, "  {part:<12}there")?,
                Err(otherwise) => writeln!(f, "  {part:<12}missing: {otherwise}")?,
            }
        }
        for mark in &self.unfinished {
            writeln!(f, "The training of its {} is {mark}.", mark.part)?;
        }
        if !self.unfinished.is_empty() {
            writeln!(f, "The same command resumes it.")?;
        }
        if !self.has_transition {
            let name = name.clone();
            writeln!(f, "{}", Error::NoTransition { name })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn told(folder: &Path) -> String {
        Folder::open(&folder.to_string_lossy()).unwrap().to_string()
    }

    #[test]
    fn unfinished_training_is_reported_with_a_remedy() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        let config = wm_model::autoencoder::AutoencoderConfig::tiny();
        let autoencoder = wm_model::Autoencoder::random(config, 1).unwrap();
        let file = folder.join("autoencoder.safetensors");
        autoencoder
            .save(file, wm_model::weights::Precision::F16)
            .unwrap();
        let mark = |part: &str| Unfinished {
            part: part.to_owned(),
            step: 7,
            steps: 90,
        };
        mark("autoencoder").write(folder).unwrap();
        let text = told(folder);
        assert!(text.contains("transition  missing"), "{text}");
        assert!(text.contains("wm train transition --data BAGS"), "{text}");
        assert!(
            text.contains("its autoencoder is unfinished: step 7 of 90"),
            "{text}"
        );

        Unfinished::remove(folder, "autoencoder").unwrap();
        std::fs::write(folder.join("transition.safetensors"), "").unwrap();
        mark("transition").write(folder).unwrap();
        let text = told(folder);
        assert!(text.contains("transition  there"), "{text}");
        assert!(text.contains("step 7 of 90"), "{text}");
        assert!(!text.contains("wm train transition"), "{text}");
        let json = Folder::open(&folder.to_string_lossy()).unwrap().json();
        assert_eq!(json["unfinished"]["transition"]["steps"], 90);
        assert_eq!(json["parts"], json!(["encoder", "decoder", "transition"]));
    }

    #[test]
    fn embedded_default_has_every_part_but_two() {
        let text = Folder::open("tiny").unwrap().to_string();
        assert_eq!(text.matches("  there").count(), 5, "{text}");
        assert!(text.contains("subgoals    missing"), "{text}");
        assert!(text.contains("distance    missing"), "{text}");
        // The first line names the latent space.
        assert_eq!(text.lines().count(), 1 + 5 + 2, "{text}");
    }
}
