use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::Arc,
};

use wm_audit::Audit;
use wm_model::Framing;

use super::{
    DataOptions, Dataset, DatasetError, Manifest, Size, SplitRule,
    manifest::Split,
    preparation::{Preparation, identity},
    search::{Found, find_others},
    split::split,
    store::{Folder, cache_name, if_another_was_first, is_prepared, read_audit, read_manifest},
};

/// Most things that were left out that are named one by one.
const NAMED: usize = 20;

/// What a model is trained on, and what it is measured on.
#[derive(Debug)]
pub struct Data {
    /// Episodes that the model is fitted to.
    pub training: Dataset,
    /// Episodes for validation, if there are any.
    pub validation: Option<Dataset>,
}

impl Data {
    /// Holds paths and options against what is on the disk, before anything long begins: no recording is read.
    ///
    /// # Errors
    /// Names a path where there are no data, or options that cannot be used.
    pub fn require(paths: &[PathBuf], options: &DataOptions) -> Result<(), DatasetError> {
        expect_effect(paths, options)?;
        options.with_config()?.split_rule()?;
        let is_bags = |path: &&PathBuf| !is_prepared(path);
        let bags =
            |paths: &[PathBuf]| -> Vec<PathBuf> { paths.iter().filter(is_bags).cloned().collect() };
        find_others(&bags(paths), &bags(&options.held_out)).or_else(|error| match error {
            // All is prepared: there is nothing to look for.
            DatasetError::Nothing(_) if bags(paths).is_empty() => Ok(Found::default()),
            error => Err(error),
        })?;
        for dir in paths.iter().chain(&options.held_out) {
            if is_prepared(dir) {
                read_manifest(dir)?;
            }
        }
        Ok(())
    }

    /// The data at `paths`: bags (folders with `metadata.yaml`, or `.mcap` files), folders that are searched for bags, and
    /// folders that `wm dataset` prepared. Bags are prepared into `cache`, or taken from there where an earlier call has
    /// left them. Frames are as `framing` says; its size is that of all cameras side by side.
    ///
    /// Which episodes are for validation: those of `options.held_out`; else those that a prepared folder names; else, and
    /// wherever `options.validation` or its seed is given, a share by the options.
    ///
    /// What is left out is named by `tracing` at the level of warnings.
    ///
    /// # Errors
    /// When options or files cannot be used, bags are of different robots, or there is nothing to train on: the error
    /// names the offender.
    pub fn open(
        paths: &[PathBuf],
        framing: impl Into<Framing>,
        cache: &Path,
        options: &DataOptions,
    ) -> Result<Self, DatasetError> {
        expect_effect(paths, options)?;
        let (framing, options) = (framing.into(), options.with_config()?);
        let rule = options.split_rule()?;
        let folders = open_all((paths, &options.held_out), framing, cache, &options)?;
        let on = (&options, framing.fit);
        if !options.held_out.is_empty() {
            let held_out = open_all((&options.held_out, &[]), framing, cache, &options)?;
            expect_apart(&folders, &held_out)?;
            let training = Dataset::of_folders(folders, on, |_, _| true)?;
            let validation = Dataset::of_folders(held_out, on, |_, _| true)?;
            training.expect_same(&validation)?;
            return Ok(Self {
                training,
                validation: Some(validation),
            });
        }
        let splits = splits(&folders, &options, rule);
        let is = |wanted: Split| {
            let splits = &splits;
            move |folder: usize, episode: usize| {
                splits.get(folder).and_then(|splits| splits.get(episode)) == Some(&wanted)
            }
        };
        let training = Dataset::of_folders(folders.clone(), on, is(Split::Training))?;
        let validation = Dataset::of_folders(folders, on, is(Split::Validation))?;
        if training.episodes().is_empty() {
            let what = "    all episodes are for validation".to_owned();
            return Err(DatasetError::Nothing(what));
        }
        let validation = Some(validation).filter(|set| !set.episodes().is_empty());
        Ok(Self {
            training,
            validation,
        })
    }
}

impl Dataset {
    /// What a trained model is measured on: the episodes for validation, where a prepared folder names some or
    /// `options` gives a share or a seed, as a training with these options chooses them; else all episodes. Otherwise as
    /// [`Data::open`].
    ///
    /// # Errors
    /// Those of [`Data::open`].
    pub fn held_out(
        paths: &[PathBuf],
        framing: impl Into<Framing>,
        cache: &Path,
        options: &DataOptions,
    ) -> Result<Self, DatasetError> {
        expect_effect(paths, options)?;
        let (framing, options) = (framing.into(), options.with_config()?);
        let folders = open_all((paths, &[]), framing, cache, &options)?;
        let splits = splits(&folders, &options, options.split_rule()?);
        let is_split = |(opened, splits): (&Opened, &Vec<Split>)| {
            (is_chosen(&options) || opened.is_given) && splits.contains(&Split::Validation)
        };
        let is_split: Vec<bool> = folders.iter().zip(&splits).map(is_split).collect();
        Self::of_folders(folders, (&options, framing.fit), |folder, episode| {
            let split = splits.get(folder).and_then(|splits| splits.get(episode));
            is_split.get(folder) != Some(&true) || split == Some(&Split::Validation)
        })
    }

    /// All episodes of the bags at or under `bags_root`, or of a prepared folder, with the usual options. Otherwise as
    /// [`Data::open`].
    ///
    /// # Errors
    /// Those of [`Data::open`].
    pub fn open(
        bags_root: &Path,
        cache_dir: &Path,
        framing: impl Into<Framing>,
    ) -> Result<Self, DatasetError> {
        let (framing, options) = (framing.into(), DataOptions::default());
        let folders = open_all((&[bags_root.to_owned()], &[]), framing, cache_dir, &options)?;
        Self::of_folders(folders, (&options, framing.fit), |_, _| true)
    }
}

/// A folder, and whether the user gave it: else it is one of a cache, and its split means nothing.
#[derive(Clone)]
pub(super) struct Opened {
    pub folder: Arc<Folder>,
    is_given: bool,
}

impl Opened {
    /// What each of its episodes is, wherever their bags lie.
    fn identities(&self) -> Vec<String> {
        let manifest = self.folder.manifest();
        let episodes = manifest.episodes.iter().map(|episode| {
            let source = manifest.sources.get(episode.source);
            // A manifest that names no source was changed by hand: a name is an identity too.
            source.map_or_else(
                || episode.name.clone(),
                |source| identity(source, episode.begin_ns),
            )
        });
        episodes.collect()
    }
}

/// Whether the user wants a certain split, and not that of a prepared folder.
fn is_chosen(options: &DataOptions) -> bool {
    options.validation.is_some() || options.validation_seed.is_some()
}

/// What each episode of each folder is for. Without other wishes a prepared folder stays split as it is.
fn splits(folders: &[Opened], options: &DataOptions, rule: SplitRule) -> Vec<Vec<Split>> {
    let is_free = |opened: &&Opened| is_chosen(options) || !opened.is_given;
    let free = folders.iter().filter(is_free);
    let free: Vec<String> = free.flat_map(Opened::identities).collect();
    let mut chosen = split(&free, rule).into_iter();
    let splits = folders.iter().map(|opened| {
        let listed = &opened.folder.manifest().episodes;
        if is_free(&opened) {
            chosen.by_ref().take(listed.len()).collect()
        } else {
            listed.iter().map(|episode| episode.split).collect()
        }
    });
    splits.collect()
}

/// Refuses options for bags where there are none. Those of a file are no mistake: the bags were prepared by it.
fn expect_effect(paths: &[PathBuf], options: &DataOptions) -> Result<(), DatasetError> {
    let mut all = paths.iter().chain(&options.held_out);
    match (paths.first(), options.of_preparation()) {
        (Some(dir), Some(option)) if all.all(|path| is_prepared(path)) => {
            Err(DatasetError::Prepared {
                dir: dir.clone(),
                what: format!("{option} has no effect on a data set that is prepared already"),
            })
        }
        _ => Ok(()),
    }
}

/// Opens data sets and bags, but for the bags that are `others`.
fn open_all(
    (paths, others): (&[PathBuf], &[PathBuf]),
    Framing { size, fit, .. }: Framing,
    cache: &Path,
    options: &DataOptions,
) -> Result<Vec<Opened>, DatasetError> {
    let (prepared, bags): (Vec<_>, Vec<_>) = paths.iter().cloned().partition(|p| is_prepared(p));
    let mut opened = Vec::new();
    for dir in prepared {
        let folder = Folder::open(&dir)?;
        name_left_out(folder.manifest(), &dir);
        name_mixed_sizes(folder.manifest(), None);
        let view = view(size, folder.views())?;
        folder.manifest().expect_fit(&dir, view, fit)?;
        opened.push(Opened {
            folder: Arc::new(folder.at_size(view, cache)?),
            is_given: true,
        });
    }
    if !bags.is_empty() {
        let settings = options.settings()?;
        let view = view(size, settings.cameras.len().max(1))?;
        let others: Vec<_> = others.iter().filter(|p| !is_prepared(p)).cloned().collect();
        let found = find_others(&bags, &others)?;
        let none = Found::default();
        let rule = options.split_rule()?;
        let preparation = Preparation::new(found, none, settings, (view, fit), rule)?;
        let dir = cache.join(cache_name(preparation.digest()));
        if !is_prepared(&dir) {
            preparation
                .write(&dir)
                .or_else(if_another_was_first(&dir))?;
        }
        let folder = Folder::open(&dir)?;
        name_left_out(folder.manifest(), &dir);
        let audit = read_audit(&dir)?;
        name_faults(audit.as_ref());
        name_mixed_sizes(folder.manifest(), audit.as_ref());
        opened.push(Opened {
            folder: Arc::new(folder),
            is_given: false,
        });
    }
    Ok(opened)
}

/// The size of one of `views` pictures that lie side by side.
fn view(size: (usize, usize), views: usize) -> Result<Size, DatasetError> {
    let (height, width) = size;
    if !width.is_multiple_of(views) {
        let what = format!("frames of {height}x{width} cannot show {views} cameras side by side");
        return Err(DatasetError::Option {
            option: "--camera",
            what,
        });
    }
    Ok(Size {
        height,
        width: width / views,
    })
}

pub(super) fn name_left_out(manifest: &Manifest, dir: &Path) {
    for left in manifest.left_out.iter().take(NAMED) {
        tracing::warn!("left out: {left}");
    }
    let more = manifest.left_out.len().saturating_sub(NAMED);
    if more > 0 {
        let path = dir.join("dataset.json");
        tracing::warn!("left out: {more} more; all are named in {}", path.display());
    }
}

/// Logs what the audit found wrong with a folder of a cache, whose audit nobody has seen.
fn name_faults(audit: Option<&Audit>) {
    for finding in audit.into_iter().flat_map(Audit::faults) {
        let fix = finding.fix.as_deref().unwrap_or_default();
        tracing::warn!("audit: {}: {}; {fix}", finding.check, finding.what);
    }
}

/// Logs which cameras have pictures of several sizes, unless the audit that the user sees has it.
pub(super) fn name_mixed_sizes(manifest: &Manifest, audit: Option<&Audit>) {
    let mut faults = audit.into_iter().flat_map(Audit::faults);
    if faults.any(|finding| finding.check == "sizes") {
        return;
    }
    for mixed in manifest.mixed_sizes() {
        tracing::warn!("{mixed}");
    }
}

/// Refuses an episode that is for both.
fn expect_apart(training: &[Opened], held_out: &[Opened]) -> Result<(), DatasetError> {
    let identities = training.iter().flat_map(Opened::identities);
    let training: BTreeSet<String> = identities.collect();
    for opened in held_out {
        let manifest = opened.folder.manifest();
        for (episode, identity) in manifest.episodes.iter().zip(opened.identities()) {
            if training.contains(&identity) {
                let source = manifest.sources.get(episode.source);
                return Err(DatasetError::Episode {
                    bag: source.map_or_else(PathBuf::new, |source| source.bag.clone()),
                    what: format!("{} is held out, but also trained on", episode.name),
                });
            }
        }
    }
    Ok(())
}
