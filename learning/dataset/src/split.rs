use std::collections::BTreeSet;

use sha2::{Digest as _, Sha256};

use super::{SplitRule, manifest::Split};

/// Identity of a piece of a recording, independent of the bag's location and of other bags.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub piece: String,
    /// Of all pieces into which gaps divide an episode.
    pub episode: String,
}

impl Identity {
    /// Identity of an undivided episode.
    pub fn of(episode: String) -> Self {
        Self {
            piece: episode.clone(),
            episode,
        }
    }
}

/// Assigns episodes to training and validation by identity.
///
/// Each identity decides alone, so adding episodes moves no others. All pieces of an episode are on one side. Only if a
/// side would be empty, the nearest episode moves. Of a single episode, the pieces decide; a single piece is for training.
pub(super) fn split(identities: &[Identity], rule: SplitRule) -> Vec<Split> {
    let episodes: BTreeSet<&str> = identities.iter().map(|id| id.episode.as_str()).collect();
    let decisive = |identity: &Identity| match episodes.len() {
        1 => draw(&identity.piece, rule.seed),
        _ => draw(&identity.episode, rule.seed),
    };
    let draws: Vec<f64> = identities.iter().map(decisive).collect();
    let mut splits: Vec<Split> = draws
        .iter()
        .map(|draw| {
            if *draw < rule.validation {
                Split::Validation
            } else {
                Split::Training
            }
        })
        .collect();
    let nearest = |to: Split| match to {
        Split::Validation => draws.iter().copied().min_by(f64::total_cmp),
        Split::Training => draws.iter().copied().max_by(f64::total_cmp),
    };
    if rule.validation > 0.0 && identities.len() > 1 {
        for side in [Split::Validation, Split::Training] {
            if splits.contains(&side) {
                continue;
            }
            // Pieces of an episode have the same draw.
            let moved = nearest(side);
            for (split, draw) in splits.iter_mut().zip(&draws) {
                if Some(*draw) == moved {
                    *split = side;
                }
            }
        }
    } else {
        splits.fill(Split::Training);
    }
    splits
}

/// A number in 0..1 from identity and seed.
fn draw(identity: &str, seed: u64) -> f64 {
    let hash = Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(identity)
        .finalize();
    // SHA-256 has 32 bytes.
    let first = hash.first_chunk::<8>().copied().unwrap_or_default();
    // The highest 53 bits are exact.
    (u64::from_le_bytes(first) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identities(count: usize) -> Vec<Identity> {
        let identity = |index| Identity::of(format!("bag {index}"));
        (0..count).map(identity).collect()
    }

    /// Episodes of three pieces each.
    fn pieces(episodes: usize) -> Vec<Identity> {
        let piece = |index: usize| Identity {
            piece: format!("piece {index}"),
            episode: format!("bag {}", index / 3),
        };
        (0..3 * episodes).map(piece).collect()
    }

    fn validation_count(count: usize, validation: f64, seed: u64) -> usize {
        let splits = split(&identities(count), SplitRule { validation, seed });
        let is_chosen = |split: &&Split| **split == Split::Validation;
        splits.iter().filter(is_chosen).count()
    }

    #[test]
    fn share_is_met_and_no_side_is_empty() {
        let count = validation_count(2000, 0.1, 0);
        assert!((150..250).contains(&count), "{count}");
        for seed in 0..20 {
            for count in 2..6 {
                assert!(validation_count(count, 0.01, seed) == 1, "{count} {seed}");
                assert!(
                    validation_count(count, 1.0, seed) == count - 1,
                    "{count} {seed}"
                );
            }
        }
        assert_eq!(
            (validation_count(1, 0.9, 0), validation_count(50, 0.0, 0)),
            (0, 0)
        );
    }

    #[test]
    fn assignment_does_not_depend_on_other_episodes() {
        let rule = SplitRule {
            validation: 0.3,
            seed: 7,
        };
        let all = identities(50);
        let splits = split(&all, rule);
        let reversed: Vec<Identity> = all.iter().rev().cloned().collect();
        let mut back = split(&reversed, rule);
        back.reverse();
        assert_eq!(back, splits);
        assert_eq!(split(&all[..30], rule), splits[..30]);
    }

    #[test]
    fn pieces_of_an_episode_are_on_one_side() {
        for (episodes, validation) in [(2, 0.01), (2, 1.0), (7, 0.3), (40, 0.1)] {
            for seed in 0..20 {
                let rule = SplitRule { validation, seed };
                let splits = split(&pieces(episodes), rule);
                let whole = split(&identities(episodes), rule);
                for (pieces, expected) in splits.chunks(3).zip(whole) {
                    assert_eq!(pieces, [expected; 3], "{episodes} {validation} {seed}");
                }
            }
        }
        // Without another episode, the pieces decide.
        let rule = SplitRule {
            validation: 0.4,
            seed: 1,
        };
        let splits = split(&pieces(1), rule);
        assert!(splits.contains(&Split::Validation) && splits.contains(&Split::Training));
    }
}
