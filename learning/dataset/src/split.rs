use sha2::{Digest as _, Sha256};

use super::{SplitRule, manifest::Split};

/// Assigns episodes to training and validation by identity.
///
/// Each identity decides alone, so adding episodes moves no others. Only if a side would be empty, the nearest episode
/// moves.
pub(super) fn split(identities: &[String], rule: SplitRule) -> Vec<Split> {
    let draws: Vec<f64> = identities.iter().map(|id| draw(id, rule.seed)).collect();
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
    let nearest = |to: Split| {
        let order = |a: &usize, b: &usize| match (draws.get(*a), draws.get(*b)) {
            (Some(a), Some(b)) => a.total_cmp(b),
            _ => std::cmp::Ordering::Equal,
        };
        match to {
            Split::Validation => (0..draws.len()).min_by(order),
            Split::Training => (0..draws.len()).max_by(order),
        }
    };
    if rule.validation > 0.0 && identities.len() > 1 {
        for side in [Split::Validation, Split::Training] {
            if !splits.contains(&side)
                && let Some(split) = nearest(side).and_then(|index| splits.get_mut(index))
            {
                *split = side;
            }
        }
    } else {
        // A single episode is for training.
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

    fn identities(count: usize) -> Vec<String> {
        (0..count).map(|index| format!("bag {index}")).collect()
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
        let reversed: Vec<String> = all.iter().rev().cloned().collect();
        let mut back = split(&reversed, rule);
        back.reverse();
        assert_eq!(back, splits);
        assert_eq!(split(&all[..30], rule), splits[..30]);
    }
}
