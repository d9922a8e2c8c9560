//! What a round is trained and tested on.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use rand::seq::SliceRandom as _;
use serde::{Deserialize, Serialize};

use super::{PLAN, TrainRoundArgs, result_of, write_whole};
use crate::{arguments::threads, optimiser::step_rng};

/// Most clips of a step of the transition model. So small a batch learns more in the same time than the recipe's.
const MOST_CLIPS: usize = 4;
/// Fraction of the most steps that the first round takes: its duration is unknown, and its model is wanted soon.
const FIRST_SHARE: f64 = 0.1;
/// Least fraction of the most steps: the preparation and the test of a round take their time too.
const LEAST_SHARE: f64 = 0.02;
/// Most by which a round has more or fewer steps than the one before: the computer's other work changes.
const MOST_CHANGE: f64 = 3.0;

/// The bags and steps of a round, fixed when it begins, so that a killed round resumes with the same ones.
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
    /// Optimiser steps of the transition model.
    pub transition_steps: u64,
    /// Clips of each of these steps, one for each thread.
    pub clips: usize,
    /// Optimiser steps of the inverse dynamics model; 0: none.
    pub idm_steps: u64,
    /// The present model.
    pub from: String,
}

impl Plan {
    /// The plan of the unfinished round, or of a new one.
    pub(super) fn of(arguments: &TrainRoundArgs) -> Result<Self> {
        let mut last = 0;
        let mut share = FIRST_SHARE;
        for (round, folder) in rounds(&arguments.models)? {
            last = round;
            let has_plan = folder.join(PLAN).is_file();
            match result_of(&folder)? {
                None if has_plan => return read(&folder),
                Some(result) if has_plan => {
                    let before = read(&folder)?.transition_steps as f64;
                    let before = before / arguments.transition_steps as f64;
                    share = result.lasted.map_or(before, |lasted| {
                        next_share(before, lasted, arguments.seconds)
                    });
                }
                _ => {}
            }
        }
        let plan = Self::new(arguments, last + 1, share)?;
        let folder = plan.folder(&arguments.models);
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        write_whole(&folder.join(PLAN), &serde_json::to_string(&plan)?)?;
        Ok(plan)
    }

    /// The folder of the round.
    pub fn folder(&self, models: &Path) -> PathBuf {
        models.join(format!("round-{:04}", self.round))
    }

    fn new(arguments: &TrainRoundArgs, round: u32, share: f64) -> Result<Self> {
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
        let steps = |most: u64| (most as f64 * share).ceil() as u64;
        Ok(Self {
            transition_steps: steps(arguments.transition_steps),
            idm_steps: steps(arguments.idm_steps),
            clips: threads(arguments.threads)?.clamp(1, MOST_CLIPS),
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

/// The fraction of the most steps with which a round lasts `wanted` seconds, if one with `share` lasted `lasted` seconds.
fn next_share(share: f64, lasted: f64, wanted: f64) -> f64 {
    let change = (wanted / lasted.max(1e-3)).clamp(1.0 / MOST_CHANGE, MOST_CHANGE);
    (share * change).clamp(LEAST_SHARE, 1.0)
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
    fn rounds_approach_their_duration() {
        // A computer that takes 2 s for each hundredth of the steps, after 20 s of preparation.
        let lasted = |share: f64| 20.0 + 200.0 * share;
        let mut share = FIRST_SHARE;
        for _ in 0..20 {
            share = next_share(share, lasted(share), 120.0);
        }
        assert!((lasted(share) - 120.0).abs() < 1.0, "{share}");
        // One that is too slow for it, and one that is too fast.
        assert_eq!(next_share(LEAST_SHARE, 1000.0, 120.0), LEAST_SHARE);
        assert_eq!(next_share(0.5, 1.0, 120.0), 1.0);
        assert_eq!(next_share(0.1, 1.0, 120.0), 0.1 * MOST_CHANGE);
    }

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
