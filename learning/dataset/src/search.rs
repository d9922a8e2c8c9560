use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use super::{DatasetError, manifest::LeftOut, store};

/// Greatest depth of the search: nested folders, but not a whole disk.
const DEPTH: usize = 5;
const NO_BAG: &str = "no bag: expected metadata.yaml, or .mcap or .db3 files, compressed or not";

/// Bags under some paths, and folders without bags.
#[derive(Debug, Default)]
pub(super) struct FoundBags {
    pub bags: Vec<PathBuf>,
    pub left_out: Vec<LeftOut>,
}

/// All bags at or under `paths`, by name: folders with `metadata.yaml`, and MCAP or sqlite3 files in other folders.
pub(super) fn find(paths: &[PathBuf]) -> Result<FoundBags, DatasetError> {
    let mut found = FoundBags::default();
    for path in paths {
        let before = found.bags.len();
        if is_bag(path) {
            found.bags.push(path.clone());
        } else if path.is_dir() {
            search(path, DEPTH, &mut found)?;
        } else if !path.exists() {
            return Err(DatasetError::Missing(path.clone()));
        }
        if found.bags.len() == before {
            return Err(DatasetError::Empty(path.clone()));
        }
    }
    let mut seen = BTreeSet::new();
    let mut twice = Vec::new();
    found.bags.retain(|bag| {
        let is_new = seen.insert(whole(bag));
        if !is_new {
            twice.push(LeftOut::path(bag, "given twice"));
        }
        is_new
    });
    found.left_out.extend(twice);
    Ok(found)
}

/// The bags under `paths` that are not under `held_out`.
pub(super) fn find_others(
    paths: &[PathBuf],
    held_out: &[PathBuf],
) -> Result<FoundBags, DatasetError> {
    let mut found = find(paths)?;
    let held: BTreeSet<PathBuf> = find(held_out)?.bags.iter().map(|bag| whole(bag)).collect();
    found.bags.retain(|bag| !held.contains(&whole(bag)));
    if found.bags.is_empty() {
        return Err(DatasetError::Nothing(
            "    every bag is held out".to_owned(),
        ));
    }
    Ok(found)
}

/// A canonical path.
fn whole(bag: &Path) -> PathBuf {
    bag.canonicalize().unwrap_or_else(|_| bag.to_owned())
}

fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        path.join("metadata.yaml").is_file()
    } else {
        wm_bag::is_bag_file(path) && path.is_file()
    }
}

/// Whether the folder has a bag.
fn search(folder: &Path, depth: usize, found: &mut FoundBags) -> Result<bool, DatasetError> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).map_err(DatasetError::io(folder))? {
        entries.push(entry.map_err(DatasetError::io(folder))?.path());
    }
    entries.sort();
    let is_hidden = |path: &Path| {
        let name = path.file_name().unwrap_or_default().as_encoded_bytes();
        name.starts_with(b".")
    };
    let mut has_bags = false;
    for path in entries.iter().filter(|path| !is_hidden(path)) {
        let other_form = wm_bag::preferred_form(path);
        let reason = if let Some(other) = other_form.filter(|_| !path.is_dir()) {
            format!("the same file in another form: {} is read", other.display())
        } else if is_bag(path) {
            found.bags.push(path.clone());
            has_bags = true;
            continue;
        } else if !path.is_dir() {
            continue;
        } else if store::is_prepared(path) {
            "a prepared data set; give its own path to use it".to_owned()
        } else if depth == 0 {
            format!("the search for bags is limited to {DEPTH} folders")
        } else {
            let before = found.left_out.len();
            if search(path, depth - 1, found)? {
                has_bags = true;
                continue;
            }
            // One entry for all folders in it, except those with another reason.
            let mut inner = found.left_out.split_off(before);
            inner.retain(|left| left.reason != NO_BAG);
            found.left_out.append(&mut inner);
            if found.left_out.len() > before {
                continue;
            }
            NO_BAG.to_owned()
        };
        found.left_out.push(LeftOut::path(path, &reason));
    }
    Ok(has_bags)
}
