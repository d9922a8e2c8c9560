use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::ImportError;

/// An episode's annotation.
#[derive(Debug)]
pub(super) struct Located {
    /// The folder that `annotation/` is in; the videos are named relative to it.
    pub root: PathBuf,
    pub annotation: PathBuf,
}

/// The annotations below `src`, by folder, split and number.
pub(super) fn find(src: &Path) -> Result<Vec<Located>, ImportError> {
    let mut roots = vec![src.to_owned()];
    if !src.join("annotation").is_dir() {
        roots = entries(src)?;
        roots.retain(|root| root.join("annotation").is_dir());
    }
    let mut found = Vec::new();
    for root in roots {
        for split in entries(&root.join("annotation"))? {
            let mut files = if split.is_dir() {
                entries(&split)?
            } else {
                vec![split]
            };
            files.retain(|file| {
                file.extension()
                    .is_some_and(|extension| extension == "json")
            });
            files.sort_by_key(|file| {
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                (stem.parse::<u64>().ok(), stem.into_owned())
            });
            found.extend(files.into_iter().map(|annotation| Located {
                root: root.clone(),
                annotation,
            }));
        }
    }
    if found.is_empty() {
        return Err(ImportError::UnknownLayout {
            path: src.to_owned(),
            expected: "DROID's annotation/SPLIT/NAME.json and videos/",
        });
    }
    Ok(found)
}

/// What is in a folder, by name.
fn entries(dir: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).map_err(|source| ImportError::io(dir, source))? {
        found.push(entry.map_err(|source| ImportError::io(dir, source))?.path());
    }
    found.sort();
    Ok(found)
}
