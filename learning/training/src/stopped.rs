//! The state of a model after its training was stopped, and its possible uses.

use std::{fmt::Write as _, path::Path};

use anyhow::Result;
use wm_zoo::{ModelFolder, Unfinished};

use crate::run::checkpoint;

/// State of one part.
#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    /// The last step is done.
    Done,
    /// Weights exist, and steps remain.
    Written(Unfinished),
    /// A checkpoint exists, but no weights.
    Begun,
    /// Nothing exists.
    NotBegun,
}

/// Describes the model in `out`: progress of the trainings `parts`, whether it can run, and how to continue.
///
/// # Errors
/// If the folder cannot be read.
pub fn summary(out: &Path, parts: &[&str]) -> Result<String> {
    let name = out.display().to_string();
    let marks = Unfinished::all(out)?;
    let mut text = format!("{name} so far:\n");
    for part in parts {
        let state = match state(out, &marks, part) {
            State::Done => "done".to_owned(),
            State::Written(mark) => mark.to_string(),
            State::Begun => "begun, nothing to run yet".to_owned(),
            State::NotBegun => "not begun".to_owned(),
        };
        writeln!(text, "  {part:<13}{state}")?;
    }
    let predicts = ModelFolder::open(&name).is_ok_and(|model| model.has_transition());
    if predicts {
        writeln!(
            text,
            "It can predict with its training so far. To inspect it, and to run it on a recording:\n    \
             wm model info {name}\n    \
             wm launch launch-configs/replay.launch.yaml model:={name} bag:=BAG"
        )?;
    } else if parts.contains(&"transition") && parts.len() > 1 {
        writeln!(
            text,
            "There is no transition model yet, so it can neither predict nor be launched. For a complete model with less training, \
             use another --out with --share 0.05."
        )?;
    }
    write!(
        text,
        "To continue, run the same command again; the model will equal that of an uninterrupted training."
    )?;
    Ok(text)
}

fn state(out: &Path, marks: &[Unfinished], part: &str) -> State {
    let is_written = |ending: &str| out.join(format!("{part}{ending}")).is_file();
    let has_checkpoint = checkpoint(out, part).is_file();
    match marks.iter().find(|mark| mark.part == part) {
        Some(mark) => State::Written(mark.clone()),
        None if is_written(".safetensors") => State::Done,
        None if has_checkpoint => State::Begun,
        None => State::NotBegun,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_has_all_parts_and_next_steps() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let file = |name: &str| std::fs::write(out.join(name), "").unwrap();
        let parts = ["autoencoder", "transition", "idm"];
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();

        file("autoencoder.checkpoint.safetensors");
        let text = summary(out, &parts).unwrap();
        assert!(text.contains("autoencoder  begun"), "{text}");
        assert!(text.contains("no transition model yet"), "{text}");
        assert!(!text.contains("wm launch"), "{text}");

        for name in ["autoencoder", "transition"] {
            file(&format!("{name}.safetensors"));
        }
        let mark = Unfinished {
            part: "transition".to_owned(),
            step: 3,
            steps: 40,
        };
        mark.write(out).unwrap();
        let text = summary(out, &parts).unwrap();
        assert_eq!(
            lines(&text)[1..4],
            [
                "  autoencoder  done",
                "  transition   unfinished: step 3 of 40",
                "  idm          not begun",
            ]
        );
        assert!(
            text.contains(&format!("model:={}", out.display())),
            "{text}"
        );
        // A part alone does not mention others.
        let text = summary(&out.join("idm"), &["idm"]).unwrap();
        assert!(!text.contains("transition"), "{text}");
    }
}
