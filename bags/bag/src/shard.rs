use std::{fmt, str::FromStr};

/// One of several processes or machines that share the work on many recordings: every Nth is its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// The only one.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Whether the recording, or unit of work, of this number is this one's.
    #[must_use]
    pub fn has(self, unit: usize) -> bool {
        unit % self.count == self.index
    }

    /// How many of `count` are its own.
    #[must_use]
    pub fn share_of(self, count: u64) -> u64 {
        let (index, shards) = (self.index as u64, self.count as u64);
        count.saturating_sub(index).div_ceil(shards)
    }

    /// Whether there are others.
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

    /// `I/N`, I from 0.
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
    fn every_unit_is_in_one_shard() {
        let shards: Vec<Shard> = ["0/3", "1/3", "2/3"].map(|s| s.parse().unwrap()).into();
        for unit in 0..10 {
            assert_eq!(shards.iter().filter(|shard| shard.has(unit)).count(), 1);
            let shares: u64 = shards.iter().map(|shard| shard.share_of(unit as u64)).sum();
            assert_eq!(shares, unit as u64);
        }
        for wrong in ["3/3", "1", "-1/2", "0/0", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
