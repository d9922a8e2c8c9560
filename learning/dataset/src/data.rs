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
    search::{FoundBags, find_others},
    split::{Identity, split},
    store::{Folder, cache_name, if_another_was_first, is_prepared, read_audit, read_manifest},
};

/// Most excluded items logged individually.
const MAX_LOGGED: usize = 20;

/// Training and validation data.
#[derive(Debug)]
pub struct Data {
    /// Training episodes.
    pub training: Dataset,
    /// Validation episodes, if any.
    pub validation: Option<Dataset>,
}

impl Data {
    /// Checks paths and options quickly, without reading recordings.
    ///
    /// # Errors
    /// Names a path without data, or an invalid option.
    pub fn require(paths: &[PathBuf], options: &DataOptions) -> Result<(), DatasetError> {
        expect_effect(paths, options)?;
        options.with_config()?.split_rule()?;
        let is_bags = |path: &&PathBuf| !is_prepared(path);
        let bags =
            |paths: &[PathBuf]| -> Vec<PathBuf> { paths.iter().filter(is_bags).cloned().collect() };
        find_others(&bags(paths), &bags(&options.held_out)).or_else(|error| match error {
            // All paths are prepared.
            DatasetError::Nothing(_) if bags(paths).is_empty() => Ok(FoundBags::default()),
            error => Err(error),
        })?;
        for dir in paths.iter().chain(&options.held_out) {
            if is_prepared(dir) {
                read_manifest(dir)?;
            }
        }
        Ok(())
    }

    /// Opens `paths`: bags (folders with `metadata.yaml`, or `.mcap` files), folders to search for bags, and folders
    /// prepared by `wm dataset`. Bags are prepared in `cache`, or reused from there. Frames have the size of `framing`,
    /// all cameras side by side.
    ///
    /// The validation episodes are those of `options.held_out`, else those of a prepared folder. Without both, or with
    /// `options.validation` or its seed, they are a share of the episodes. Excluded data are logged as warnings.
    ///
    /// # Errors
    /// Names an invalid option or file, bags of different robots, or missing training data.
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
    /// The evaluation data: the validation episodes of a prepared folder or of a share given by `options`, chosen as in
    /// training; else all episodes. Otherwise as [`Data::open`].
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
        let is_split = |(opened, splits): (&OpenFolder, &Vec<Split>)| {
            (is_chosen(&options) || opened.is_given) && splits.contains(&Split::Validation)
        };
        let is_split: Vec<bool> = folders.iter().zip(&splits).map(is_split).collect();
        Self::of_folders(folders, (&options, framing.fit), |folder, episode| {
            let split = splits.get(folder).and_then(|splits| splits.get(episode));
            is_split.get(folder) != Some(&true) || split == Some(&Split::Validation)
        })
    }

    /// All episodes of the bags under `bags_root`, or of a prepared folder, with the usual options. Otherwise as
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

/// A folder, and whether the user gave it. The split of a cache folder is ignored.
#[derive(Clone)]
pub(super) struct OpenFolder {
    pub folder: Arc<Folder>,
    is_given: bool,
}

impl OpenFolder {
    /// Identities of its episodes, independent of the bags' location.
    fn identities(&self) -> Vec<Identity> {
        let manifest = self.folder.manifest();
        let episodes = manifest.episodes.iter().map(|episode| {
            let source = manifest.sources.get(episode.source);
            // A manifest without sources was edited: use the name instead.
            source.map_or_else(
                || Identity::of(episode.name.clone()),
                |source| identity(source, episode.begin_ns, episode.continues_ns),
            )
        });
        episodes.collect()
    }
}

/// Whether the user chose a split.
fn is_chosen(options: &DataOptions) -> bool {
    options.validation.is_some() || options.validation_seed.is_some()
}

/// The split of each folder's episodes; by default that of the prepared folder.
fn splits(folders: &[OpenFolder], options: &DataOptions, rule: SplitRule) -> Vec<Vec<Split>> {
    let is_free = |opened: &&OpenFolder| is_chosen(options) || !opened.is_given;
    let free = folders.iter().filter(is_free);
    let free: Vec<Identity> = free.flat_map(OpenFolder::identities).collect();
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

/// Rejects bag options on the command line if there are no bags. Options of a file may belong to an earlier
/// preparation.
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

/// Opens data sets and bags, except the bags in `others`.
fn open_all(
    (paths, others): (&[PathBuf], &[PathBuf]),
    Framing { size, fit, .. }: Framing,
    cache: &Path,
    options: &DataOptions,
) -> Result<Vec<OpenFolder>, DatasetError> {
    let (prepared, bags): (Vec<_>, Vec<_>) = paths.iter().cloned().partition(|p| is_prepared(p));
    let mut opened = Vec::new();
    for dir in prepared {
        let folder = Folder::open(&dir)?;
        log_exclusions(folder.manifest(), &dir);
        log_mixed_sizes(folder.manifest(), None);
        let view = view(size, folder.views())?;
        folder.manifest().expect_fit(&dir, view, fit)?;
        opened.push(OpenFolder {
            folder: Arc::new(folder.at_size(view, cache)?),
            is_given: true,
        });
    }
    if !bags.is_empty() {
        let settings = options.settings()?;
        let view = view(size, settings.cameras.len().max(1))?;
        let others: Vec<_> = others.iter().filter(|p| !is_prepared(p)).cloned().collect();
        let found = find_others(&bags, &others)?;
        let rule = options.split_rule()?;
        let prepare = |found| {
            let none = FoundBags::default();
            let preparation = Preparation::new(found, none, settings.clone(), (view, fit), rule)?;
            open_cached(preparation, cache)
        };
        if options.by_bag {
            opened.extend(each_bag(found, prepare)?);
        } else {
            opened.push(prepare(found)?);
        }
    }
    Ok(opened)
}

/// Prepares each bag for itself. A bag without a usable frame is logged and left out, as it is among others.
fn each_bag(
    found: FoundBags,
    prepare: impl Fn(FoundBags) -> Result<OpenFolder, DatasetError>,
) -> Result<Vec<OpenFolder>, DatasetError> {
    for left in &found.left_out {
        tracing::warn!("excluded: {left}");
    }
    let mut opened = Vec::new();
    let mut unusable = Vec::new();
    for bag in found.bags {
        let alone = FoundBags {
            bags: vec![bag],
            left_out: Vec::new(),
        };
        match prepare(alone) {
            Ok(folder) => opened.push(folder),
            Err(DatasetError::Nothing(what)) => {
                tracing::warn!("excluded: {}", what.trim_start());
                unusable.push(what);
            }
            Err(error) => return Err(error),
        }
    }
    if opened.is_empty() {
        return Err(DatasetError::Nothing(unusable.join("\n")));
    }
    Ok(opened)
}

/// Opens the prepared folder in the cache, and writes it first if it is missing. Logs what the folder leaves out.
fn open_cached(preparation: Preparation, cache: &Path) -> Result<OpenFolder, DatasetError> {
    let dir = cache.join(cache_name(preparation.digest()));
    if !is_prepared(&dir) {
        preparation
            .write(&dir)
            .or_else(if_another_was_first(&dir))?;
    }
    let folder = Folder::open(&dir)?;
    log_exclusions(folder.manifest(), &dir);
    let audit = read_audit(&dir)?;
    log_faults(audit.as_ref());
    log_mixed_sizes(folder.manifest(), audit.as_ref());
    Ok(OpenFolder {
        folder: Arc::new(folder),
        is_given: false,
    })
}

/// The size of one of `views` pictures side by side.
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

pub(super) fn log_exclusions(manifest: &Manifest, dir: &Path) {
    for left in manifest.left_out.iter().take(MAX_LOGGED) {
        tracing::warn!("excluded: {left}");
    }
    let more = manifest.left_out.len().saturating_sub(MAX_LOGGED);
    if more > 0 {
        let path = dir.join("dataset.json");
        tracing::warn!(
            "excluded: {more} more; all are listed in {}",
            path.display()
        );
    }
}

/// Logs audit faults of a cache folder, whose audit no one has read.
fn log_faults(audit: Option<&Audit>) {
    for finding in audit.into_iter().flat_map(Audit::faults) {
        let fix = finding.fix.as_deref().unwrap_or_default();
        tracing::warn!("audit: {}: {}; {fix}", finding.check, finding.what);
    }
}

/// Logs cameras with pictures of several sizes, unless the visible audit does.
pub(super) fn log_mixed_sizes(manifest: &Manifest, audit: Option<&Audit>) {
    let mut faults = audit.into_iter().flat_map(Audit::faults);
    if faults.any(|finding| finding.check == "sizes") {
        return;
    }
    for mixed in manifest.mixed_sizes() {
        tracing::warn!("{mixed}");
    }
}

/// Rejects an episode in both parts.
fn expect_apart(training: &[OpenFolder], held_out: &[OpenFolder]) -> Result<(), DatasetError> {
    let identities = training.iter().flat_map(OpenFolder::identities);
    let training: BTreeSet<String> = identities.map(|identity| identity.piece).collect();
    for opened in held_out {
        let manifest = opened.folder.manifest();
        for (episode, identity) in manifest.episodes.iter().zip(opened.identities()) {
            if training.contains(&identity.piece) {
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
