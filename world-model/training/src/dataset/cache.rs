use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use memmap2::Mmap;

use super::{DatasetError, Episode, episode::Decoded};

/// The files of one dataset: `frames`, `masks` (where the bags have them) and `episodes.json`, which is written last.
pub(super) struct Cache {
    dir: PathBuf,
}

impl Cache {
    pub(super) fn at(cache_dir: &Path, digest: &str) -> Self {
        let key: String = digest.chars().take(16).collect();
        Self {
            dir: cache_dir.join(format!("frames-{key}")),
        }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    pub(super) fn is_complete(&self) -> bool {
        self.file("episodes.json").is_file()
    }

    pub(super) fn create(&self) -> Result<CacheWriter<'_>, DatasetError> {
        fs::create_dir_all(&self.dir).map_err(at(&self.dir))?;
        let open = |name: &str| {
            let path = self.file(name);
            File::create(&path).map(BufWriter::new).map_err(at(&path))
        };
        Ok(CacheWriter {
            cache: self,
            frames: open("frames")?,
            masks: open("masks")?,
            episodes: Vec::new(),
            masked: None,
        })
    }

    pub(super) fn open(&self) -> Result<(Vec<Episode>, Mmap, Option<Mmap>), DatasetError> {
        let path = self.file("episodes.json");
        let text = fs::read(&path).map_err(at(&path))?;
        let episodes = serde_json::from_slice(&text)
            .map_err(|error| at(&path)(std::io::Error::other(error)))?;
        let masks = self.file("masks");
        let has_masks = fs::metadata(&masks).map_err(at(&masks))?.len() > 0;
        Ok((
            episodes,
            map(&self.file("frames"))?,
            has_masks.then(|| map(&masks)).transpose()?,
        ))
    }
}

pub(super) struct CacheWriter<'a> {
    cache: &'a Cache,
    frames: BufWriter<File>,
    masks: BufWriter<File>,
    episodes: Vec<Episode>,
    masked: Option<bool>,
}

impl CacheWriter<'_> {
    pub(super) fn push(&mut self, bag: &Path, decoded: Decoded) -> Result<(), DatasetError> {
        let masked = !decoded.masks.is_empty();
        if *self.masked.get_or_insert(masked) != masked {
            return Err(DatasetError::Episode {
                bag: bag.to_owned(),
                what: "some bags have masks and some do not; expected all or none".to_owned(),
            });
        }
        let write = |file: &mut BufWriter<File>, name: &str, bytes: &[u8]| {
            file.write_all(bytes).map_err(at(&self.cache.file(name)))
        };
        write(&mut self.frames, "frames", &decoded.frames)?;
        write(&mut self.masks, "masks", &decoded.masks)?;
        let first_frame = self
            .episodes
            .last()
            .map_or(0, |last| last.first_frame + last.frame_count);
        let name = bag.file_name().unwrap_or_default();
        self.episodes.push(Episode {
            name: name.to_string_lossy().into_owned(),
            first_frame,
            frame_count: decoded.actions.len(),
            actions: decoded.actions,
        });
        Ok(())
    }

    pub(super) fn finish(mut self) -> Result<(), DatasetError> {
        self.frames
            .flush()
            .map_err(at(&self.cache.file("frames")))?;
        self.masks.flush().map_err(at(&self.cache.file("masks")))?;
        let path = self.cache.file("episodes.json");
        let text = serde_json::to_vec(&self.episodes)
            .map_err(|error| at(&path)(std::io::Error::other(error)))?;
        // In one move, since its presence says that the rest is whole.
        let partial = path.with_extension("partial");
        fs::write(&partial, text).map_err(at(&partial))?;
        fs::rename(&partial, &path).map_err(at(&path))
    }
}

fn map(path: &Path) -> Result<Mmap, DatasetError> {
    let file = File::open(path).map_err(at(path))?;
    // SAFETY: the cache is this program's own; whoever changes it during a training breaks only their own run.
    unsafe { Mmap::map(&file) }.map_err(at(path))
}

fn at(path: &Path) -> impl FnOnce(std::io::Error) -> DatasetError + use<> {
    let path = path.to_owned();
    move |source| DatasetError::Io { path, source }
}
