//! What there is of a model whose training was stopped, and what can be done with it.

use std::{fmt::Write as _, path::Path};

use anyhow::Result;
use wm_zoo::{ModelFolder, Unfinished};

use crate::run::checkpoint;

/// What has become of a training's part.
#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    /// Its last step is taken.
    Done,
    /// There are weights, and steps to come.
    Written(Unfinished),
    /// There is a checkpoint, and nothing to run.
    Begun,
    /// There is nothing of it.
    NotBegun,
}

/// Says of the model in `out` how far the trainings `parts` are that make it, whether it can be run as it is, and how to go
/// on with it.
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
            "It predicts, as well as it has learnt by now. To see what it is, and to run it on a recording:\n    \
             wm model info {name}\n    \
             wm launch launch-configs/replay.launch.yaml model:={name} bag:=BAG"
        )?;
    } else if parts.contains(&"transition") && parts.len() > 1 {
        writeln!(
            text,
            "There is no transition model yet: nothing can be predicted with it, and no launch takes it. A whole model, less \
             trained, comes sooner from another --out with --share 0.05."
        )?;
    }
    write!(
        text,
        "To go on, run the same command again: the model becomes what it would have become without the stop."
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
    fn every_part_is_told_and_what_can_be_done() {
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
        // Of a part by itself there is nothing to say of others.
        let text = summary(&out.join("idm"), &["idm"]).unwrap();
        assert!(!text.contains("transition"), "{text}");
    }
}
