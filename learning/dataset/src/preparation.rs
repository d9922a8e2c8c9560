//! Prepares bags: a first pass over every bag finds the episodes, a second one decodes their frames into the file.

mod bags;
mod frames;

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest as _, Sha256};
use wm_audit::{ActionTrack, Audit, Episode, Episodes};
use wm_model::Fit;

use super::{
    DatasetError, Manifest, Settings, Size, SplitRule,
    cutting::Draft,
    fingerprint::{fingerprint, hex},
    manifest::{LeftOut, ManifestEpisode, Source, Split, VERSION},
    recording::BrokenPictures,
    search::FoundBags,
    source_sizes::source_sizes,
    split::{Identity, split},
    statistics::DataStatistics,
    store::{Folder, NewFolder},
};
use bags::Survey;
use frames::DecodedFrames;

/// Rules that change the contents of a cached folder, but not its form: velocities are motions per period, and pieces of an
/// episode share a side of the split.
const RULES: u32 = 1;

/// Inputs and settings of a prepared folder.
pub(super) struct Preparation {
    sources: Vec<Source>,
    left_out: Vec<LeftOut>,
    settings: Settings,
    size: Size,
    fit: Fit,
    split: SplitRule,
    digest: String,
}

/// A bag's part in a data set.
pub(super) struct BagPlan {
    /// Index of the bag among the sources.
    pub source: usize,
    /// Topics of its pictures: cameras, then masks.
    pub topics: Vec<String>,
    pub episodes: Vec<Draft>,
    /// Motion of the robot, for the audit.
    pub actions: ActionTrack,
    /// Index of its findings in the plan.
    pub findings: usize,
}

impl Preparation {
    /// Plans bags for training (some become validation) and bags for validation; a camera's pictures get `size` by
    /// `fit`.
    ///
    /// # Errors
    /// If a file cannot be read, or a bag is given for both.
    pub fn new(
        training: FoundBags,
        held_out: FoundBags,
        settings: Settings,
        (size, fit): (Size, Fit),
        split: SplitRule,
    ) -> Result<Self, DatasetError> {
        let bags = training.bags.iter().map(|bag| (bag, false));
        let bags: Vec<(&PathBuf, bool)> = bags
            .chain(held_out.bags.iter().map(|bag| (bag, true)))
            .collect();
        let sources = bags.par_iter().map(|(bag, held_out)| {
            Ok(Source {
                bag: (*bag).clone(),
                digest: fingerprint(bag)?,
                held_out: *held_out,
            })
        });
        let sources = sources.collect::<Result<Vec<_>, DatasetError>>()?;
        let trained = |held: &&Source| {
            let mut others = sources.iter().filter(|source| !source.held_out);
            held.held_out && others.any(|other| other.digest == held.digest)
        };
        if let Some(held) = sources.iter().find(trained) {
            return Err(DatasetError::Episode {
                bag: held.bag.clone(),
                what: "held out, but its contents are also among the bags to train on".to_owned(),
            });
        }
        let mut hash = Sha256::new();
        hash.update(format!("{VERSION} {RULES} {size} {fit}\n"));
        // Settings are numbers, lists and texts: JSON cannot fail.
        hash.update(serde_json::to_vec(&settings).unwrap_or_default());
        for source in &sources {
            let name = source.bag.file_name().unwrap_or_default();
            hash.update(name.as_encoded_bytes());
            hash.update(&source.digest);
        }
        let mut left_out = training.left_out;
        left_out.extend(held_out.left_out);
        Ok(Self {
            sources,
            left_out,
            settings,
            size,
            fit,
            split,
            digest: hex(hash),
        })
    }

    /// Hex SHA-256 of all inputs that determine frames and actions.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Writes the folder `dir`, which appears when complete.
    ///
    /// # Errors
    /// If `dir` exists, bags are of different robots, nothing is usable, or a file cannot be read or written.
    pub fn write(self, dir: &Path) -> Result<(), DatasetError> {
        if dir.exists() {
            return Err(DatasetError::Exists(dir.to_owned()));
        }
        let survey = Survey::of(&self.sources, &self.settings)?;
        let mut broken: Vec<BrokenPictures> = vec![BrokenPictures::default(); self.sources.len()];
        loop {
            let plan = survey.plan(&self.sources, &self.settings, &broken)?;
            let folder = NewFolder::create(dir)?;
            let (mut manifest, actions) = self.manifest(&plan);
            let found = frames::write(&plan.bags, &self.sources, &manifest, &folder)?;
            manifest.source_sizes = source_sizes(&found.sizes, &manifest.cameras);
            if found.broken.iter().all(BrokenPictures::is_empty) {
                folder.write_audit(&audit(&plan, &manifest, &found))?;
                folder.write_actions(&actions)?;
                folder.write_statistics(&statistics(&manifest, &actions)?)?;
                return folder.finish(&manifest);
            }
            // Cut episodes again without the undecodable pictures.
            for (broken, found) in broken.iter_mut().zip(found.broken) {
                broken.extend(found);
            }
        }
    }

    /// The manifest, and the motion from each frame to the next.
    fn manifest(&self, plan: &bags::Plan) -> (Manifest, Vec<Vec<f32>>) {
        let mut episodes = Vec::new();
        let mut identities = Vec::new();
        let mut actions = Vec::new();
        for bag in &plan.bags {
            let Some(source) = self.sources.get(bag.source) else {
                continue;
            };
            for (number, draft) in bag.episodes.iter().enumerate() {
                // Bags are paths to files or folders: they have names.
                let stem = source.bag.file_stem().unwrap_or_default().to_string_lossy();
                let name = if bag.episodes.len() == 1 {
                    stem.into_owned()
                } else {
                    format!("{stem}#{}", number + 1)
                };
                let (begin_ns, end_ns) = draft.span_ns();
                let continues_ns =
                    Some(draft.episode_ns).filter(|episode_ns| *episode_ns != begin_ns);
                identities.push((source.held_out, identity(source, begin_ns, continues_ns)));
                actions.extend(draft.actions.iter().cloned());
                episodes.push(ManifestEpisode {
                    name,
                    source: bag.source,
                    begin_ns,
                    continues_ns,
                    end_ns,
                    frames: draft.actions.len(),
                    split: Split::Validation,
                    instruction: draft.instruction.clone(),
                    success: draft.success,
                    labels: draft.labels.clone(),
                });
            }
        }
        let has_held_out = self.sources.iter().any(|source| source.held_out);
        let rule = SplitRule {
            // Validation bags need no further share.
            validation: if has_held_out {
                0.0
            } else {
                self.split.validation
            },
            ..self.split
        };
        let free: Vec<Identity> = identities
            .iter()
            .filter(|(held_out, _)| !held_out)
            .map(|(_, identity)| identity.clone())
            .collect();
        let mut splits = split(&free, rule).into_iter();
        for (episode, (held_out, _)) in episodes.iter_mut().zip(&identities) {
            if !held_out {
                // `splits` has one entry per free episode.
                episode.split = splits.next().unwrap_or(Split::Training);
            }
        }
        let mut left_out = self.left_out.clone();
        left_out.extend(plan.left_out.iter().cloned());
        let manifest = Manifest {
            version: VERSION,
            digest: self.digest.clone(),
            size: self.size,
            fit: self.fit,
            source_sizes: Vec::new(),
            cameras: plan.cameras.clone(),
            has_masks: plan.has_masks,
            settings: self.settings.clone(),
            split: rule,
            action_space: plan.space.clone(),
            sources: self.sources.clone(),
            episodes,
            left_out,
        };
        (manifest, actions)
    }
}

/// Identity of an episode that starts at `begin_ns` and may continue the one of `continues_ns`.
pub(super) fn identity(source: &Source, begin_ns: i64, continues_ns: Option<i64>) -> Identity {
    let of = |begin_ns: i64| format!("{} {begin_ns}", source.digest);
    Identity {
        piece: of(begin_ns),
        episode: of(continues_ns.unwrap_or(begin_ns)),
    }
}

/// The audit of each bag and of all episodes.
fn audit(plan: &bags::Plan, manifest: &Manifest, decoded: &DecodedFrames) -> Audit {
    let space = &plan.space;
    let drafts = plan.bags.iter().flat_map(|bag| &bag.episodes);
    let listed = drafts.zip(&manifest.episodes).zip(&decoded.changes);
    let episodes = listed.map(|((draft, listed), changes)| {
        let mut episode = Episode::new(listed.name.as_str(), space.len());
        let states = draft.states.iter().map(Some).chain(std::iter::repeat(None));
        for ((action, change), state) in draft.actions.iter().zip(changes).zip(states) {
            episode.push(action, *change, state.map(Vec::as_slice));
        }
        episode
    });
    let episodes: Vec<Episode> = episodes.collect();
    let all = Audit::of_episodes(Episodes {
        episodes: &episodes,
        space,
        period_s: 1.0 / space.rate(),
    });
    let mut findings = plan.findings.clone();
    for bag in &plan.bags {
        let pictures = decoded.videos.get(bag.source).into_iter().flatten();
        let found = pictures.flat_map(|pictures| bag.actions.check_pictures(pictures));
        // The stamps of the packets already showed missing frames.
        let found = found.filter(|finding| finding.check != "dropped");
        if let Some(of_bag) = findings.get_mut(bag.findings) {
            of_bag.findings.extend(found);
        }
    }
    Audit::new(&findings, all)
}

fn statistics(manifest: &Manifest, actions: &[Vec<f32>]) -> Result<DataStatistics, DatasetError> {
    let episodes = Folder::episodes(manifest, actions.iter().cloned());
    let training = manifest.episodes.iter().zip(&episodes);
    let training = training.filter(|(listed, _)| listed.split == Split::Training);
    let training = training.map(|(_, episode)| episode);
    let statistics = DataStatistics::of_episodes(training, &manifest.action_space);
    statistics.map_err(DatasetError::of_scales)
}
