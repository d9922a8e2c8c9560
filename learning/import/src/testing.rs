#![allow(clippy::unwrap_used, reason = "a test that cannot import fails")]

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use wm_bag::Shard;

use crate::{ImportError, ImportOptions, ImportReport};

/// Asserts that two, three, and more shards than episodes write the same files as one import.
pub(crate) fn assert_shards_join(
    episodes: usize,
    import: impl Fn(&Path, &ImportOptions) -> Result<ImportReport, ImportError>,
) {
    let dir = tempfile::tempdir().unwrap();
    let run = |out: &Path, shard| {
        let options = ImportOptions {
            shard,
            ..ImportOptions::default()
        };
        import(out, &options).unwrap().bags
    };
    let one = dir.path().join("one");
    assert_eq!(run(&one, Shard::WHOLE).len(), episodes);
    for count in [2, 3, episodes + 1] {
        let out = dir.path().join(format!("of_{count}"));
        for index in 0..count {
            let own = (index..episodes).step_by(count);
            let own: Vec<_> = own.map(|n| out.join(format!("episode_{n:06}"))).collect();
            assert_eq!(run(&out, shard(index, count)), own);
        }
        assert!(files(&out) == files(&one), "of {count} shards");
    }
}

/// Options of the shard `index` of `count`.
pub(crate) fn of_shard(index: usize, count: usize) -> ImportOptions {
    ImportOptions {
        shard: shard(index, count),
        ..ImportOptions::default()
    }
}

pub(crate) fn shard(index: usize, count: usize) -> Shard {
    format!("{index}/{count}").parse().unwrap()
}

/// Contents of the bags' files in `dir`, by relative path.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let entries = |dir: &Path| {
        fs::read_dir(dir)
            .unwrap()
            .map(|entry| entry.unwrap().path())
    };
    let files = entries(dir).flat_map(|bag| entries(&bag));
    files
        .map(|file| {
            let below = file.strip_prefix(dir).unwrap().to_owned();
            (below, fs::read(file).unwrap())
        })
        .collect()
}
