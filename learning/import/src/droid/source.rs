use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::ImportError;

/// The path of an annotation.
#[derive(Debug)]
pub(super) struct AnnotationPath {
    /// The parent of `annotation/`; the paths of videos are relative to it.
    pub root: PathBuf,
    pub annotation: PathBuf,
}

/// Finds the annotations below `src`, sorted by folder, split and number.
pub(super) fn find(src: &Path) -> Result<Vec<AnnotationPath>, ImportError> {
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
                // Entries of a folder always have a name.
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                (stem.parse::<u64>().ok(), stem.into_owned())
            });
            found.extend(files.into_iter().map(|annotation| AnnotationPath {
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

/// The entries of a folder, sorted by name.
fn entries(dir: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).map_err(|source| ImportError::io(dir, source))? {
        found.push(entry.map_err(|source| ImportError::io(dir, source))?.path());
    }
    found.sort();
    Ok(found)
}
