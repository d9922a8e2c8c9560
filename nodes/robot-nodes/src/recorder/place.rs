//! Rules for the folders of bags.
//!
//! The user chooses the path of the first bag, and what happens to an existing bag there. Every later bag is requested
//! by a peer and gets a new folder below the root, never through a symbolic link.

use anyhow::{Context as _, Result, bail, ensure};
use std::path::{Component, Path, PathBuf};
use std::time::SystemTime;
use tracing::{info, warn};
use wm_bag::{free_name, set_aside};

/// What happens to an existing bag at the first bag's path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Existing {
    /// The recorder refuses to start.
    Refused,
    /// It is renamed: its name gets its time.
    Renamed,
    /// It is removed once the new bag holds a message.
    Replaced,
}

/// The rules for the folders of bags.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// Folder of the first bag.
    output: PathBuf,
    /// All further bags are below this folder.
    root: PathBuf,
    existing: Existing,
}

/// Longest path that Linux allows \[byte\].
const LONGEST_URI: usize = 4096;

impl Place {
    /// Rules for a first bag at `output` and further bags below `root`, by default the folder that contains `output`.
    ///
    /// # Errors
    /// `output` does not end in a name.
    pub fn new(output: PathBuf, root: Option<PathBuf>, existing: Existing) -> Result<Self> {
        ensure!(
            output.file_name().is_some(),
            "parameter \"output\" is {output:?}: expected the name of a folder"
        );
        let parent = output.parent();
        // A bare name is in the working directory.
        let parent = parent.filter(|parent| !parent.as_os_str().is_empty());
        let parent = parent.unwrap_or(Path::new("."));
        Ok(Self {
            root: root.unwrap_or_else(|| parent.to_owned()),
            output,
            existing,
        })
    }

    /// Renames the existing bag at the path of the first one. Returns the folder of the first bag, and the old bag to
    /// remove once the new one holds a message.
    ///
    /// # Errors
    /// The folder holds anything but a bag, or cannot be renamed.
    pub fn first(&self) -> Result<(PathBuf, Option<OldBag>)> {
        let output = &self.output;
        if self.existing == Existing::Refused {
            // The writer refuses a folder that is not empty.
            return Ok((output.clone(), None));
        }
        let is_replaced = self.existing == Existing::Replaced && output.exists();
        if is_replaced {
            bag_files(output)?;
        }
        let aside = set_aside(output)?;
        if let Some(aside) = &aside {
            info!(
                "renamed the existing {} to {}",
                output.display(),
                aside.display()
            );
        }
        let old = aside
            .filter(|_| is_replaced)
            .map(|folder| OldBag { folder });
        Ok((output.clone(), old))
    }

    /// The folder of a further bag, which a peer requests by `uri`: a path below the root, absolute or relative to it.
    /// If it is empty, the folder has the first bag's name with the time.
    ///
    /// # Errors
    /// The path leads out of the root or through a symbolic link, or already exists.
    pub fn further(&self, uri: &str) -> Result<PathBuf> {
        if uri.is_empty() {
            let beside = match self.output.file_name() {
                Some(name) => self.root.join(name),
                None => self.output.clone(),
            };
            return Ok(free_name(&beside, SystemTime::now())?);
        }
        ensure!(
            uri.len() <= LONGEST_URI && !uri.chars().any(char::is_control),
            "uri: expected a path of at most {LONGEST_URI} bytes without control characters"
        );
        let root = std::path::absolute(&self.root).context("the working directory")?;
        let outside = || {
            format!(
                "uri {uri:?}: expected a path below {}, without \"..\"",
                root.display()
            )
        };
        let uri = Path::new(uri);
        let below = match uri.is_absolute() {
            true => uri.strip_prefix(&root).with_context(outside)?,
            false => uri,
        };
        let mut folder = self.root.clone();
        let mut names = below.components().peekable();
        if names.peek().is_none() {
            bail!(outside());
        }
        while let Some(name) = names.next() {
            let Component::Normal(name) = name else {
                bail!(outside());
            };
            folder.push(name);
            match std::fs::symlink_metadata(&folder) {
                Ok(found) if names.peek().is_some() && found.is_dir() => {}
                Ok(found) if found.is_symlink() => {
                    bail!("{} is a symbolic link", folder.display())
                }
                Ok(_) => bail!("{} already exists", folder.display()),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(error).with_context(|| folder.display().to_string()),
            }
        }
        Ok(folder)
    }
}

/// A renamed bag, which is removed once the new one holds a message.
#[derive(Debug)]
pub(super) struct OldBag {
    folder: PathBuf,
}

impl OldBag {
    /// Removes it if the new bag holds `messages`. A failure is only logged.
    pub fn give_way(self, messages: u64) {
        let folder = self.folder.display();
        if messages == 0 {
            warn!("nothing was recorded: the existing bag is kept as {folder}");
            return;
        }
        let remove = || -> Result<()> {
            for path in bag_files(&self.folder)? {
                std::fs::remove_file(path)?;
            }
            Ok(std::fs::remove_dir(&self.folder)?)
        };
        if let Err(error) = remove() {
            warn!("the replaced bag could not be removed and is kept as {folder}: {error:#}");
        }
    }
}

/// The files of the bag in `folder`.
///
/// # Errors
/// The path is no folder, holds anything but a bag, or cannot be read.
fn bag_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).and_then(|entries| {
        let paths = entries.map(|entry| entry.map(|entry| entry.path()));
        paths.collect::<std::io::Result<Vec<PathBuf>>>()
    });
    let paths = entries.with_context(|| format!("folder {}", folder.display()))?;
    let is_part_of_bag = |path: &PathBuf| {
        let is_mcap = path
            .extension()
            .is_some_and(|extension| extension == "mcap");
        let is_metadata = path.file_name().is_some_and(|name| name == "metadata.yaml");
        path.is_file() && (is_mcap || is_metadata)
    };
    if let Some(stranger) = paths.iter().find(|path| !is_part_of_bag(path)) {
        bail!(
            "will not overwrite {}: it contains {}, which is not part of a bag",
            folder.display(),
            stranger.display()
        );
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn place(folder: &Path, existing: Existing) -> Place {
        Place::new(folder.join("bag"), None, existing).unwrap()
    }

    /// Makes a folder with a file of a bag.
    fn recorded(folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join("a.mcap"), "recorded").unwrap();
    }

    fn is_kept(folder: &Path) -> bool {
        fs::read(folder.join("a.mcap")).is_ok_and(|bytes| bytes == b"recorded")
    }

    #[test]
    fn a_peer_gets_new_folders_below_the_root_only() {
        let scratch = tempfile::tempdir().unwrap();
        let (root, outside) = (scratch.path().join("root"), scratch.path().join("outside"));
        recorded(&root.join("bag"));
        recorded(&root.join("strangers"));
        recorded(&outside);
        std::os::unix::fs::symlink(&outside, root.join("link")).unwrap();
        std::os::unix::fs::symlink(outside.join("new"), root.join("dangling")).unwrap();
        fs::write(root.join("file"), "x").unwrap();
        // The rule for the first bag does not matter.
        for existing in [Existing::Refused, Existing::Renamed, Existing::Replaced] {
            let place = place(&root, existing);
            let refusal = |uri: &str| place.further(uri).unwrap_err().to_string();
            let whole = |path: PathBuf| path.to_str().unwrap().to_owned();
            for uri in [
                "../outside",
                "..",
                ".",
                "/",
                "/etc/cron.d/x",
                "a/../../outside",
                &whole(outside.join("new")),
                &whole(root.join("../outside/new")),
                &whole(root.clone()),
            ] {
                assert!(refusal(uri).contains("below"), "{uri}: {}", refusal(uri));
            }
            for uri in ["bag", "strangers", "file", &whole(root.join("bag")), "bag/"] {
                assert!(refusal(uri).contains("already exists"), "{uri}");
            }
            for uri in ["link", "link/new", "dangling", "dangling/new"] {
                assert!(refusal(uri).contains("symbolic link"), "{uri}");
            }
            assert!(refusal("a\nb").contains("control"));
            assert!(refusal(&"x".repeat(5000)).contains("4096"));

            assert_eq!(place.further("new").unwrap(), root.join("new"));
            let nested = root.join("new/deeper");
            assert_eq!(place.further("new/deeper").unwrap(), nested);
            assert_eq!(place.further(nested.to_str().unwrap()).unwrap(), nested);
            let named = place.further("").unwrap();
            assert!(named.starts_with(&root) && !named.exists(), "{named:?}");
            let name = named.file_name().unwrap().to_str().unwrap();
            assert!(name.starts_with("bag_2"), "{name}");
            fs::create_dir(&named).unwrap();
            assert_ne!(place.further("").unwrap(), named, "the same second");
        }
        assert!(is_kept(&root.join("bag")) && is_kept(&outside));
        assert_eq!(fs::read_dir(&outside).unwrap().count(), 1);
    }

    #[test]
    fn a_bare_name_is_in_the_working_directory() {
        let place = Place::new("bag".into(), None, Existing::Refused).unwrap();
        assert_eq!(place.further("new").unwrap(), Path::new("./new"));
        let here = std::env::current_dir().unwrap().join("new");
        assert_eq!(
            place.further(here.to_str().unwrap()).unwrap(),
            Path::new("./new")
        );
        assert!(Place::new("..".into(), None, Existing::Refused).is_err());
    }

    #[test]
    fn an_old_bag_is_renamed_or_goes_once_there_is_another() {
        let scratch = tempfile::tempdir().unwrap();
        let output = scratch.path().join("bag");
        let others = || {
            let paths = fs::read_dir(scratch.path()).unwrap();
            let paths = paths.map(|entry| entry.unwrap().path());
            paths.filter(|path| *path != output).collect::<Vec<_>>()
        };
        let renaming = place(scratch.path(), Existing::Renamed);
        assert!(renaming.first().unwrap().1.is_none(), "there is none yet");
        recorded(&output);
        // A folder without a bag is renamed too.
        fs::write(output.join("thesis.txt"), "x").unwrap();
        assert!(renaming.first().unwrap().1.is_none());
        let kept = others();
        assert!(kept.len() == 1 && is_kept(&kept[0]) && !output.exists());
        fs::remove_dir_all(&kept[0]).unwrap();

        let replacing = place(scratch.path(), Existing::Replaced);
        recorded(&output);
        let (_, old) = replacing.first().unwrap();
        old.unwrap().give_way(0);
        assert!(is_kept(&others()[0]), "nothing came in its place");
        recorded(&output);
        let (_, old) = replacing.first().unwrap();
        old.unwrap().give_way(1);
        assert_eq!(others().len(), 1);
        recorded(&output);
        fs::write(output.join("thesis.txt"), "x").unwrap();
        let refusal = replacing.first().unwrap_err().to_string();
        assert!(refusal.contains("thesis.txt"), "{refusal}");
        assert!(is_kept(&output));
    }
}
