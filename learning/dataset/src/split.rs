use sha2::{Digest as _, Sha256};

use super::{SplitRule, manifest::Split};

/// What each of the episodes with these identities is for.
///
/// An identity decides by itself, so that episodes stay where they are when others are added; only where that would leave
/// either side empty, the episode nearest to it moves.
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
        // One episode alone is there to be learnt.
        splits.fill(Split::Training);
    }
    splits
}

/// A number in 0..1 that only identity and seed decide.
fn draw(identity: &str, seed: u64) -> f64 {
    let hash = Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(identity)
        .finalize();
    let first = hash.first_chunk::<8>().copied().unwrap_or_default();
    // The highest 53 bits: exact.
    (u64::from_le_bytes(first) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identities(count: usize) -> Vec<String> {
        (0..count).map(|index| format!("bag {index}")).collect()
    }

    fn chosen(count: usize, validation: f64, seed: u64) -> usize {
        let splits = split(&identities(count), SplitRule { validation, seed });
        let is_chosen = |split: &&Split| **split == Split::Validation;
        splits.iter().filter(is_chosen).count()
    }

    #[test]
    fn the_share_is_met_and_neither_side_is_empty() {
        let count = chosen(2000, 0.1, 0);
        assert!((150..250).contains(&count), "{count}");
        for seed in 0..20 {
            for count in 2..6 {
                assert!(chosen(count, 0.01, seed) == 1, "{count} {seed}");
                assert!(chosen(count, 1.0, seed) == count - 1, "{count} {seed}");
            }
        }
        assert_eq!((chosen(1, 0.9, 0), chosen(50, 0.0, 0)), (0, 0));
    }

    #[test]
    fn neither_order_nor_others_move_an_episode() {
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
