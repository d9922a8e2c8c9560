//! Runs every target on its corpus and on reproducible mutations.

#![allow(clippy::unwrap_used, reason = "the helpers of a test may panic")]

use rand::{Rng as _, SeedableRng as _, seq::IndexedRandom as _};
use rand_chacha::ChaCha8Rng;
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

/// Number of mutations per target: a few seconds in total.
const MUTATIONS: usize = 3000;

/// Typical invalid lengths and offsets.
const NUMBERS: [u64; 8] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff_ffff,
    0xffff_ffff,
    u64::MAX >> 1,
    u64::MAX,
];

#[test]
fn every_target_survives_its_corpus_and_mutations() {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (name, target) in wm_fuzz::TARGETS {
        let mut folders = vec![fuzz.join("corpus").join(name)];
        // The users' templates are the best seeds.
        match name {
            "launch" => folders.push(fuzz.join("../launch-configs")),
            "parameters" => folders.push(fuzz.join("../launch-configs/config")),
            _ => {}
        }
        let seeds: Vec<(PathBuf, Vec<u8>)> =
            folders.iter().flat_map(|folder| files(folder)).collect();
        assert!(!seeds.is_empty(), "no seeds for {name}");
        for (path, seed) in &seeds {
            check(name, target, seed, &path.display().to_string());
        }
        let mut random = ChaCha8Rng::seed_from_u64(7);
        for number in 0..MUTATIONS {
            let (Some((path, seed)), Some((_, other))) =
                (seeds.choose(&mut random), seeds.choose(&mut random))
            else {
                continue;
            };
            let input = mutate(seed, other, &mut random);
            check(
                name,
                target,
                &input,
                &format!("mutation {number} of {}", path.display()),
            );
        }
    }
}

fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries =
        std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.is_file());
    paths.sort();
    let read = |path: PathBuf| {
        let bytes = std::fs::read(&path).unwrap();
        (path, bytes)
    };
    paths.into_iter().map(read).collect()
}

/// Runs a target; on a panic, keeps the input, which can become a seed and a test.
fn check(name: &str, target: wm_fuzz::Target, input: &[u8], what: &str) {
    if catch_unwind(AssertUnwindSafe(|| target(input))).is_err() {
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz_{name}"));
        std::fs::write(&kept, input).unwrap();
        panic!(
            "{name} does not survive {what}; the input is kept in {}",
            kept.display()
        );
    }
}

/// Makes one to four changes.
fn mutate(seed: &[u8], other: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..random.random_range(1..=4) {
        let at = random.random_range(0..=bytes.len());
        let len = random.random_range(0..=16.min(bytes.len() - at));
        match random.random_range(0..7) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..at + len)),
            2 => {
                let copy = bytes[at..at + len].to_vec();
                bytes.splice(at..at, copy);
            }
            3 => bytes.insert(at, random.random()),
            4 => {
                let number = NUMBERS[random.random_range(0..NUMBERS.len())].to_le_bytes();
                let width = [1, 2, 4, 8][random.random_range(0..4)].min(bytes.len() - at);
                bytes[at..at + width].copy_from_slice(&number[..width]);
            }
            5 => {
                let from = random.random_range(0..=other.len());
                let until = random.random_range(from..=other.len().min(from + 64));
                bytes.splice(at..at + len, other[from..until].iter().copied());
            }
            _ => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << random.random_range(0..8);
                }
            }
        }
    }
    bytes
}
