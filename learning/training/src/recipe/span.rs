use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// A length of training: `1400 steps`, or `100 epochs`; an epoch is one random sample of each episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Span {
    /// Optimiser steps.
    Steps(u64),
    /// Passes over the episodes.
    Epochs(f64),
}

impl Span {
    /// Number of optimiser steps, with `per_epoch` steps per epoch.
    #[must_use]
    pub fn steps(&self, per_epoch: f64) -> u64 {
        match self {
            Self::Steps(steps) => *steps,
            Self::Epochs(epochs) => (epochs * per_epoch).ceil() as u64,
        }
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Steps(steps) => write!(f, "{steps} steps"),
            Self::Epochs(epochs) => write!(f, "{epochs} epochs"),
        }
    }
}

impl FromStr for Span {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}`, expected a number of steps or epochs, as `100 epochs`");
        let mut words = text.split_whitespace();
        let (number, unit) = (words.next().ok_or_else(wrong)?, words.next());
        let span = match unit {
            Some("steps" | "step") => Self::Steps(number.parse().map_err(|_| wrong())?),
            Some("epochs" | "epoch") => {
                let epochs: f64 = number.parse().map_err(|_| wrong())?;
                if !epochs.is_finite() || epochs < 0.0 {
                    return Err(wrong());
                }
                Self::Epochs(epochs)
            }
            _ => return Err(wrong()),
        };
        match words.next() {
            None => Ok(span),
            Some(_) => Err(wrong()),
        }
    }
}

impl Serialize for Span {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Span {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::Span;

    #[test]
    fn steps_and_epochs_are_parsed() {
        assert_eq!("1400 steps".parse(), Ok(Span::Steps(1400)));
        assert_eq!("0.5 epochs".parse(), Ok(Span::Epochs(0.5)));
        assert_eq!(Span::Epochs(3.0).steps(12.5), 38);
        for wrong in [
            "",
            "12",
            "12 years",
            "-1 epochs",
            "inf epochs",
            "1 steps more",
            "x steps",
        ] {
            let error = wrong.parse::<Span>().unwrap_err();
            assert!(error.contains("100 epochs"), "{error}");
        }
        let text = Span::Epochs(100.0).to_string();
        assert_eq!(text.parse(), Ok(Span::Epochs(100.0)));
    }
}
