use std::{fmt, ops::Range, str::FromStr};

/// The share of one process among several that divide many recordings: every Nth unit is its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// A single process with all units.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Whether this shard has the unit (a recording, for example) of this number.
    #[must_use]
    pub fn has(self, unit: usize) -> bool {
        unit % self.count == self.index
    }

    /// Number of this shard's units among `count`.
    #[must_use]
    pub fn share_of(self, count: u64) -> u64 {
        let (index, shards) = (self.index as u64, self.count as u64);
        count.saturating_sub(index).div_ceil(shards)
    }

    /// This shard's contiguous range among `count` units; the first shards may have one more.
    #[must_use]
    pub fn range_of(self, count: usize) -> Range<usize> {
        let (each, rest) = (count / self.count, count % self.count);
        let first = self.index * each + self.index.min(rest);
        first..first + each + usize::from(self.index < rest)
    }

    /// Whether there are other shards.
    #[must_use]
    pub fn is_part(self) -> bool {
        self.count > 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-of-{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    /// Parses `I/N`, with I from 0 to N - 1.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/');
        let numbers = numbers.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => Err(format!(
                "{text}: expected I/N with I from 0 to N - 1, as 0/4"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_unit_is_in_one_shard() {
        let shards: [Shard; 3] = ["0/3", "1/3", "2/3"].map(|s| s.parse().unwrap());
        for unit in 0..10 {
            assert_eq!(shards.iter().filter(|shard| shard.has(unit)).count(), 1);
            let shares: u64 = shards.iter().map(|shard| shard.share_of(unit as u64)).sum();
            assert_eq!(shares, unit as u64);
            let ranges = shards.iter().flat_map(|shard| shard.range_of(unit));
            assert!(ranges.eq(0..unit), "one after the other, without a gap");
        }
        let lengths = shards.map(|shard| shard.range_of(8).len());
        assert_eq!(lengths, [3, 3, 2]);
        for wrong in ["3/3", "1", "-1/2", "0/0", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
