//! Vision-language models that judge imagined episodes.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    sync::{Arc, Mutex},
};

use crate::judges::{Panel, PanelSettings, Prompts, Record, Rollout};
use anyhow::{Context as _, Result, anyhow};
use serde::{Deserialize, Serialize};

use crate::Shard;

/// Folder of the answers, inside the records folder, where only record files count.
const FOLDER: &str = "judgements";

/// Verdicts of the judges on an episode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdicts {
    /// By judge: 0, 0.5 or 1; `None` for an unusable answer.
    pub scores: BTreeMap<String, Option<f64>>,
    /// The first judge's rubric, if usable.
    pub rubric: Option<Rubric>,
}

/// Scores from 1 to 5.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rubric {
    /// Plausibility of the contact between robot and objects.
    pub interaction_quality: u8,
    /// Spatial consistency.
    pub perspectivity: u8,
    /// Completion of the instruction.
    pub instruction_following: u8,
}

/// The judges with their earlier answers. Questions are asked one at a time.
#[derive(Debug)]
pub(super) struct JudgePanel(Mutex<(Panel, Record)>);

impl JudgePanel {
    /// Opens the answers of a shard; each process writes its own file.
    ///
    /// # Errors
    /// If a judge's settings are invalid, or the answers cannot be read.
    pub(super) fn open(
        panel: PanelSettings,
        prompts: Arc<Prompts>,
        (folder, shard): (&Path, Shard),
    ) -> Result<Self> {
        let folder = folder.join(FOLDER);
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let record = Record::open(&folder.join(format!("{shard}.jsonl")))?;
        Ok(Self(Mutex::new((Panel::new(panel, prompts)?, record))))
    }

    /// Verdicts of the judges. Known answers are reused.
    ///
    /// # Errors
    /// If a judge does not answer.
    pub(super) fn judge(&self, rollout: &Rollout) -> Result<Verdicts> {
        let both = self.0.lock();
        let mut both = both.map_err(|_| anyhow!("another thread failed while it asked a judge"))?;
        let (panel, record) = &mut *both;
        let ratings = panel.success([rollout], record, |_| {})?;
        let scores = ratings
            .scores
            .into_iter()
            .map(|row| row.first().copied().flatten());
        let scores = ratings.judges.into_iter().zip(scores).collect();
        let rubric = match panel.judges().first_mut() {
            Some(first) => first.rubric(rollout, record)?.verdict,
            None => None,
        };
        Ok(Verdicts {
            scores,
            rubric: rubric.map(|rubric| Rubric {
                interaction_quality: rubric.interaction_quality.score,
                perspectivity: rubric.perspectivity.score,
                instruction_following: rubric.instruction_following.score,
            }),
        })
    }
}
