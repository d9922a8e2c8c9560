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

/// Folder of the answers, in that of the records, which has files of records only.
const FOLDER: &str = "judgements";

/// What the judges say of an episode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdicts {
    /// By judge: 0, 0.5 or 1, or none where it gave no usable answer.
    pub scores: BTreeMap<String, Option<f64>>,
    /// What the first judge says to the rubric, if its answer is usable.
    pub rubric: Option<Rubric>,
}

/// From 1 to 5 each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rubric {
    /// How plausible the contact of robot and objects is.
    pub interaction_quality: u8,
    /// How consistent the space is.
    pub perspectivity: u8,
    /// How far the instruction is carried out.
    pub instruction_following: u8,
}

/// The judges with their answers so far. One question is asked at a time.
#[derive(Debug)]
pub(super) struct Judging(Mutex<(Panel, Record)>);

impl Judging {
    /// Opens the answers of a shard, of which one process writes one file.
    ///
    /// # Errors
    /// If a setting of a judge cannot be, or the answers cannot be read.
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

    /// What the judges say. What they have said before is not asked again.
    ///
    /// # Errors
    /// If a judge gives no answer.
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
