//! What a round is trained and tested on.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use rand::seq::SliceRandom as _;
use serde::{Deserialize, Serialize};

use super::{PLAN, TrainRoundArgs, result_of, write_whole};
use crate::optimiser::step_rng;

/// The bags of a round, fixed when it begins, so that a killed round resumes with the same ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Number of the round, from 1.
    pub round: u32,
    /// Bags to train on.
    pub train: Vec<PathBuf>,
    /// Bags for the test.
    pub test: Vec<PathBuf>,
    /// Duration of the bags to train on \[s\].
    pub train_s: f64,
    /// Duration of the bags for the test \[s\].
    pub test_s: f64,
    /// The present model.
    pub from: String,
}

impl Plan {
    /// The plan of the unfinished round, or of a new one.
    pub(super) fn of(arguments: &TrainRoundArgs) -> Result<Self> {
        let mut last = 0;
        for (round, folder) in rounds(&arguments.models)? {
            last = round;
            if result_of(&folder)?.is_none() && folder.join(PLAN).is_file() {
                return read(&folder);
            }
        }
        let plan = Self::new(arguments, last + 1)?;
        let folder = plan.folder(&arguments.models);
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        write_whole(&folder.join(PLAN), &serde_json::to_string(&plan)?)?;
        Ok(plan)
    }

    /// The folder of the round.
    pub fn folder(&self, models: &Path) -> PathBuf {
        models.join(format!("round-{:04}", self.round))
    }

    fn new(arguments: &TrainRoundArgs, round: u32) -> Result<Self> {
        let mut bags = bags(&arguments.recordings)?;
        let test_bags = arguments.test_bags.max(1);
        ensure!(
            bags.len() > test_bags,
            "{} bags in {}, expected more than the {test_bags} for the test",
            bags.len(),
            arguments.recordings.display()
        );
        let test = bags.split_off(bags.len() - test_bags);
        let train = choose(bags, arguments.most_bags.max(1), u64::from(round));
        let seconds =
            |bags: &[PathBuf]| bags.iter().map(|bag| duration_s(bag)).sum::<Result<f64>>();
        Ok(Self {
            round,
            train_s: seconds(&train)?,
            test_s: seconds(&test)?,
            train,
            test,
            from: arguments.from.clone(),
        })
    }
}

/// At most `most` of `bags`, which are in the order of age: the newest half, and others drawn from the rest.
fn choose(mut bags: Vec<PathBuf>, most: usize, seed: u64) -> Vec<PathBuf> {
    if bags.len() <= most {
        return bags;
    }
    let recent = bags.split_off(bags.len() - most.div_ceil(2));
    bags.shuffle(&mut step_rng(seed, 0));
    bags.truncate(most - recent.len());
    bags.sort();
    bags.extend(recent);
    bags
}

/// The rounds in a folder, in their order.
pub(super) fn rounds(models: &Path) -> Result<Vec<(u32, PathBuf)>> {
    if !models.is_dir() {
        return Ok(Vec::new());
    }
    let mut rounds = Vec::new();
    for entry in fs::read_dir(models).with_context(|| models.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        let number = name.and_then(|name| name.strip_prefix("round-")?.parse().ok());
        rounds.extend(number.map(|number: u32| (number, path)));
    }
    rounds.sort();
    Ok(rounds)
}

fn read(folder: &Path) -> Result<Plan> {
    let path = folder.join(PLAN);
    let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

/// The complete bags in a folder, by name.
fn bags(recordings: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(recordings).with_context(|| recordings.display().to_string())?;
    let mut bags = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.join("metadata.yaml").is_file() {
            bags.push(path);
        }
    }
    bags.sort();
    Ok(bags)
}

fn duration_s(bag: &Path) -> Result<f64> {
    let reader = wm_bag::BagReader::open(bag).with_context(|| bag.display().to_string())?;
    Ok(reader.summary().duration_ns() as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_bags_are_kept_and_older_ones_drawn() {
        let bags: Vec<PathBuf> = (0..100).map(|index| format!("{index:03}").into()).collect();
        let chosen = choose(bags.clone(), 20, 1);
        assert_eq!(chosen.len(), 20);
        assert_eq!(chosen[10..], bags[90..]);
        assert!(chosen.is_sorted());
        assert!(chosen[..10].iter().all(|bag| bags[..90].contains(bag)));
        assert_ne!(chosen, choose(bags.clone(), 20, 2));
        assert_eq!(chosen, choose(bags.clone(), 20, 1));
        assert_eq!(choose(bags.clone(), 100, 1), bags);
    }
}
