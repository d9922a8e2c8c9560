//! Controllers by name.

use std::{fmt, str::FromStr};

use anyhow::{Error, bail};
use wm_planner::PlannerChoice;

/// A controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Controller {
    /// A planner, from pictures.
    Planner(PlannerChoice),
    /// The simulator's own controller, which knows the state.
    Oracle,
    /// No motion.
    Hold,
    /// Uniformly random actions within the model's bounds.
    Random,
}

impl Controller {
    const ALONE: [Self; 3] = [Self::Oracle, Self::Hold, Self::Random];

    fn all() -> impl Iterator<Item = Self> {
        let planners = PlannerChoice::ALL.into_iter().map(Self::Planner);
        planners.chain(Self::ALONE)
    }
}

impl fmt::Display for Controller {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Planner(choice) => choice.fmt(f),
            Self::Oracle => f.write_str("oracle"),
            Self::Hold => f.write_str("hold"),
            Self::Random => f.write_str("random"),
        }
    }
}

impl FromStr for Controller {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match Self::all().find(|controller| controller.to_string() == name) {
            Some(controller) => Ok(controller),
            None => {
                let names: Vec<String> = Self::all().map(|known| known.to_string()).collect();
                bail!(
                    "unknown planner {name:?}; expected one of {}",
                    names.join(", ")
                )
            }
        }
    }
}
