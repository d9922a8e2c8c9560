//! Policies of graded quality, by name.

use std::{fmt, str::FromStr};

use crate::error::Error;

/// The simulator's own controller (the oracle) with a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScriptedPolicy {
    /// The oracle.
    Oracle,
    /// Normal noise of this standard deviation \[mm\] on each axis of each action.
    Noise(u32),
    /// A uniformly random action instead of the oracle's, with this probability \[%\].
    Distracted(u32),
    /// Goal displaced by this distance \[mm\] to a side drawn for the episode.
    Beside(u32),
    /// This share \[%\] of the oracle's motion.
    Slow(u32),
    /// Stops after this share \[%\] of the oracle's actions.
    Stop(u32),
    /// The gripper stays as it was.
    FrozenGripper,
    /// Uniformly random actions.
    Random,
    /// No motion.
    Hold,
}

impl ScriptedPolicy {
    /// From the best to none, with grades that cover all success rates on the arm.
    pub const ALL: [Self; 16] = [
        Self::Oracle,
        Self::Noise(10),
        Self::Noise(20),
        Self::Noise(40),
        Self::Distracted(20),
        Self::Distracted(40),
        Self::Distracted(70),
        Self::Beside(20),
        Self::Beside(40),
        Self::Beside(80),
        Self::Slow(50),
        Self::Stop(80),
        Self::Stop(50),
        Self::FrozenGripper,
        Self::Random,
        Self::Hold,
    ];

    const WITHOUT_GRADE: [Self; 4] = [Self::Oracle, Self::FrozenGripper, Self::Random, Self::Hold];
}

impl fmt::Display for ScriptedPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Oracle => f.write_str("oracle"),
            Self::Noise(mm) => write!(f, "noise-{mm}"),
            Self::Distracted(percent) => write!(f, "distracted-{percent}"),
            Self::Beside(mm) => write!(f, "beside-{mm}"),
            Self::Slow(percent) => write!(f, "slow-{percent}"),
            Self::Stop(percent) => write!(f, "stop-{percent}"),
            Self::FrozenGripper => f.write_str("frozen-gripper"),
            Self::Random => f.write_str("random"),
            Self::Hold => f.write_str("hold"),
        }
    }
}

impl FromStr for ScriptedPolicy {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        let alone = Self::WITHOUT_GRADE.into_iter();
        if let Some(found) = alone.clone().find(|known| known.to_string() == name) {
            return Ok(found);
        }
        let graded = name.split_once('-');
        let graded = graded.and_then(|(kind, grade)| Some((kind, grade.parse().ok()?)));
        Ok(match graded {
            Some(("noise", mm @ 1..=200)) => Self::Noise(mm),
            Some(("beside", mm @ 1..=200)) => Self::Beside(mm),
            Some(("distracted", percent @ 1..=99)) => Self::Distracted(percent),
            Some(("slow", percent @ 1..=99)) => Self::Slow(percent),
            Some(("stop", percent @ 1..=99)) => Self::Stop(percent),
            _ => {
                return Err(Error::Policy {
                    got: name.to_owned(),
                });
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_others_are_rejected() {
        for policy in ScriptedPolicy::ALL {
            let name = policy.to_string();
            assert_eq!(name.parse::<ScriptedPolicy>().expect("a name"), policy);
        }
        let read: ScriptedPolicy = "noise-33".parse().expect("a name");
        assert_eq!(read, ScriptedPolicy::Noise(33));
        for wrong in ["noise", "noise-0", "noise--5", "slow-100", "beside-x", ""] {
            let error = wrong.parse::<ScriptedPolicy>().expect_err("no name");
            let message = error.to_string();
            assert!(
                message.contains(&format!("{wrong:?}")) && message.contains("oracle"),
                "{message}"
            );
        }
    }
}
