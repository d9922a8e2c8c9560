//! Other first frames of episodes.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use image::RgbImage;
use sha2::{Digest as _, Sha256};
use wm_camera::image_message::decode_picture;
use wm_model::Framing;

/// File extensions of pictures.
const ENDS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Pictures by episode name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct StartImages {
    paths: BTreeMap<String, PathBuf>,
    digest: String,
}

impl StartImages {
    /// Opens the pictures of a folder.
    ///
    /// # Errors
    /// If there are none, two belong to one episode, or one cannot be read.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        let name = || folder.display().to_string();
        let mut paths = BTreeMap::new();
        for entry in fs::read_dir(folder).with_context(name)? {
            let path = entry.with_context(name)?.path();
            let end = path
                .extension()
                .map(|end| end.to_string_lossy().to_lowercase());
            if !end.is_some_and(|end| ENDS.contains(&&*end)) {
                continue;
            }
            let Some(episode) = path
                .file_stem()
                .map(|stem| stem.to_string_lossy().into_owned())
            else {
                continue;
            };
            let before = paths.insert(episode.clone(), path);
            ensure!(before.is_none(), "{}: two pictures of {episode}", name());
        }
        ensure!(
            !paths.is_empty(),
            "{}: no picture; expected PNG or JPEG files named as their episode",
            name()
        );
        let mut hash = Sha256::new();
        for (episode, path) in &paths {
            let bytes = fs::read(path).with_context(|| path.display().to_string())?;
            hash.update((episode.len() as u64).to_le_bytes());
            hash.update(episode);
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        }
        let digest = format!("{:x}", hash.finalize());
        Ok(Self { paths, digest })
    }

    /// SHA-256 of names and contents.
    pub(super) fn digest(&self) -> &str {
        &self.digest
    }

    /// Names of the episodes.
    pub(super) fn episodes(&self) -> impl Iterator<Item = &str> {
        self.paths.keys().map(String::as_str)
    }

    /// Whether an episode has one.
    pub(super) fn has(&self, episode: &str) -> bool {
        self.paths.contains_key(episode)
    }

    /// The picture of an episode, framed as the episode's frames.
    ///
    /// # Errors
    /// For an invalid or incomplete picture.
    pub(super) fn picture(&self, episode: &str, framing: Framing) -> Result<RgbImage> {
        let path = self.paths.get(episode);
        let path = path.with_context(|| format!("no first frame of {episode}"))?;
        let named = || path.display().to_string();
        let bytes = fs::read(path).with_context(named)?;
        let picture = decode_picture(bytes).with_context(named)?;
        Ok(framing.apply(&picture)?)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn pictures_are_found_by_episode_and_digested_by_content() {
        let dir = tempfile::tempdir().unwrap();
        let none = StartImages::open(dir.path()).unwrap_err().to_string();
        assert!(none.contains("named as their episode"), "{none}");
        let save = |name: &str, red| {
            let picture = RgbImage::from_pixel(6, 4, image::Rgb([red, 0, 0]));
            picture.save(dir.path().join(name)).unwrap();
        };
        save("bag_1.png", 10);
        fs::write(dir.path().join("README.md"), "no picture").unwrap();
        let found = StartImages::open(dir.path()).unwrap();
        assert!(found.has("bag_1") && !found.has("bag_2"));
        let framing = Framing::new((8, 16), wm_model::Fit::Pad);
        let picture = found.picture("bag_1", framing).unwrap();
        assert_eq!(picture.dimensions(), (16, 8));
        // 6x4 becomes 12x8, between bars of two columns.
        let columns = [0, 2, 14].map(|x| picture.get_pixel(x, 0).0[0]);
        assert_eq!(columns, [0, 10, 0]);
        let whole = fs::read(dir.path().join("bag_1.png")).unwrap();
        fs::write(dir.path().join("cut.png"), &whole[..whole.len() - 20]).unwrap();
        let cut = StartImages::open(dir.path()).unwrap();
        assert!(cut.picture("cut", framing).is_err());
        fs::remove_file(dir.path().join("cut.png")).unwrap();
        let error = found.picture("bag_2", framing).unwrap_err().to_string();
        assert!(error.contains("bag_2"), "{error}");
        save("bag_1.png", 11);
        assert_ne!(
            found.digest(),
            StartImages::open(dir.path()).unwrap().digest()
        );
        save("bag_1.jpg", 11);
        let twice = StartImages::open(dir.path()).unwrap_err().to_string();
        assert!(twice.contains("two pictures of bag_1"), "{twice}");
    }
}
