//! The choice of bags that are deleted when the recordings exceed their share of the disk.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// The bags to delete, as indices into `sizes` (bytes, oldest first), until the others take at most `limit` bytes. The
/// newest `recent` bags stay as long as possible; of the older ones each is as likely to stay, so that what remains is a
/// sample of the whole time.
pub(super) fn superfluous(sizes: &[u64], limit: u64, recent: usize, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut kept: Vec<usize> = (0..sizes.len()).collect();
    let mut total: u64 = sizes.iter().sum();
    let mut deleted = Vec::new();
    while total > limit && !kept.is_empty() {
        let older = kept.len().saturating_sub(recent);
        // If only recent ones remain, the oldest of them goes.
        let place = match older {
            0 => 0,
            _ => rng.random_range(0..older),
        };
        let index = kept.remove(place);
        total -= sizes.get(index).copied().unwrap_or_default();
        deleted.push(index);
    }
    deleted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_deleted_below_the_limit() {
        assert!(superfluous(&[10, 20, 30], 60, 2, 0).is_empty());
        assert!(superfluous(&[], 0, 2, 0).is_empty());
    }

    #[test]
    fn newest_bags_stay_longest() {
        let deleted = superfluous(&[10; 10], 50, 4, 7);
        assert_eq!(deleted.len(), 5);
        assert!(deleted.iter().all(|index| *index < 6));
        assert_eq!(superfluous(&[10; 4], 15, 4, 0), [0, 1, 2]);
    }

    #[test]
    fn kept_bags_are_a_sample_of_the_whole_time() {
        // Bags arrive one by one, as they do live.
        let mut kept: Vec<usize> = Vec::new();
        let mut first_half = 0;
        for seed in 0..200 {
            kept.clear();
            for bag in 0..60 {
                kept.push(bag);
                let sizes = vec![1; kept.len()];
                for index in superfluous(&sizes, 20, 5, seed * 1000 + bag as u64) {
                    kept.remove(index);
                }
            }
            first_half += kept.iter().filter(|bag| **bag < 28).count();
        }
        // Of 15 older bags, about those of the first half of the older 55 remain, fewer the longer ago.
        let mean = first_half as f64 / 200.0;
        assert!((2.0..9.0).contains(&mean), "{mean}");
    }
}
