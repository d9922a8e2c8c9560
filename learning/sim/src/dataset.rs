//! Makes many episodes.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use wm_bag::Shard;

use crate::bag::write_bag;
use crate::episode::Episode;
use crate::episode_options::EpisodeOptions;
use crate::error::Error;

/// Makes a shard of `episodes` episodes with seeds from `first_seed`, each as a bag `episode_000012` (the number is the
/// seed) in `out`, on all of rayon's threads. Calls `finished` after each. Returns the bags' folders in the order of their
/// seeds.
///
/// # Errors
/// The first error of any episode; see [`Episode::generate`] and `write_bag`; or of `finished`.
/// [`Error::Seeds`] if a seed exceeds the largest number.
pub fn generate_bags(
    out: &Path,
    (episodes, shard): (u64, Shard),
    first_seed: u64,
    options: &EpisodeOptions,
    finished: impl Fn(&Episode) -> Result<(), Error> + Sync,
) -> Result<Vec<PathBuf>, Error> {
    let end = first_seed.checked_add(episodes).ok_or(Error::Seeds {
        first_seed,
        episodes,
    })?;
    let seeds: Vec<u64> = (0..)
        .zip(first_seed..end)
        .filter(|(n, _)| shard.has(*n))
        .map(|(_, seed)| seed)
        .collect();
    seeds
        .into_par_iter()
        .map(|seed| {
            let episode = Episode::generate(seed, options)?;
            let dir = out.join(episode.name());
            write_bag(&episode, &dir)?;
            finished(&episode)?;
            Ok(dir)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_seeds_give_the_same_files() {
        let scratch = tempfile::tempdir().expect("a temporary directory");
        let options = EpisodeOptions {
            frames: 2,
            masks: false,
            ..EpisodeOptions::default()
        };
        let read = |name: &str| {
            let dirs = generate_bags(
                &scratch.path().join(name),
                (2, Shard::WHOLE),
                7,
                &options,
                |_| Ok(()),
            )
            .expect("bags");
            let mut all = Vec::new();
            for dir in &dirs {
                assert!(dir.join("metadata.yaml").is_file());
                for entry in std::fs::read_dir(dir).expect("a directory") {
                    let path = entry.expect("an entry").path();
                    if path
                        .extension()
                        .is_some_and(|extension| extension == "mcap")
                    {
                        all.push(std::fs::read(path).expect("a file"));
                    }
                }
            }
            all
        };
        let first = read("first");
        assert_eq!(first.len(), 2);
        assert!(first == read("second"));
        assert!(first[0] != first[1]);
    }

    #[test]
    fn seeds_past_the_largest_are_an_error() {
        let options = EpisodeOptions::default();
        let result = generate_bags(
            Path::new("unused"),
            (2, Shard::WHOLE),
            u64::MAX,
            &options,
            |_| Ok(()),
        );
        assert!(matches!(result, Err(Error::Seeds { .. })));
    }
}
