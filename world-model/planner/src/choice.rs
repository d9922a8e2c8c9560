//! Planners by name.

use std::{fmt, str::FromStr, sync::Arc};

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_zoo::idm::TrainedIdm;

use crate::{
    Cem, CemSettings, Icem, IcemSettings, InversePlanner, InverseSettings, Mppi, MppiSettings,
    PlanError, Planner, SeededSearch,
};

/// A planner, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PlannerChoice {
    /// The cross-entropy method.
    Cem,
    /// The improved cross-entropy method.
    Icem,
    /// Model predictive path integral control.
    Mppi,
    /// The actions of an inverse dynamics model, without search.
    Idm,
    /// CEM, from the actions of an inverse dynamics model.
    IdmCem,
    /// iCEM, from the actions of an inverse dynamics model.
    IdmIcem,
    /// MPPI, from the actions of an inverse dynamics model.
    IdmMppi,
    /// The actions of an inverse dynamics model along subgoals.
    SubgoalsIdm,
    /// iCEM along subgoals, from the actions of an inverse dynamics model.
    SubgoalsIcem,
}

/// Settings of all planners; each uses its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerSettings {
    /// Cross-entropy method.
    pub cem: CemSettings,
    /// Improved cross-entropy method.
    pub icem: IcemSettings,
    /// Model predictive path integral control.
    pub mppi: MppiSettings,
    /// Inverse dynamics model.
    pub idm: InverseSettings,
}

impl PlannerSettings {
    /// Settings with which `choice` plans in about a second or less on two cores: few candidates near the actions of
    /// an inverse dynamics model, more and wider ones without it.
    pub fn quick(choice: PlannerChoice) -> Self {
        let (population, iterations, elites, initial_std, std) = match choice.needs_idm() {
            true => (12, 1, 4, 0.08, 0.05),
            false => (40, 3, 8, 0.25, 0.25),
        };
        Self {
            cem: CemSettings {
                population,
                iterations,
                elites,
                initial_std,
                try_proposals: true,
                ..CemSettings::default()
            },
            icem: IcemSettings {
                population,
                iterations,
                elites,
                initial_std,
                ..IcemSettings::default()
            },
            mppi: MppiSettings {
                population,
                iterations,
                std,
                ..MppiSettings::default()
            },
            idm: InverseSettings::default(),
        }
    }
}

impl PlannerChoice {
    /// All planners.
    pub const ALL: [Self; 9] = [
        Self::Cem,
        Self::Icem,
        Self::Mppi,
        Self::Idm,
        Self::IdmCem,
        Self::IdmIcem,
        Self::IdmMppi,
        Self::SubgoalsIdm,
        Self::SubgoalsIcem,
    ];

    /// Name, as in parameters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cem => "cem",
            Self::Icem => "icem",
            Self::Mppi => "mppi",
            Self::Idm => "idm",
            Self::IdmCem => "idm+cem",
            Self::IdmIcem => "idm+icem",
            Self::IdmMppi => "idm+mppi",
            Self::SubgoalsIdm => "subgoals+idm",
            Self::SubgoalsIcem => "subgoals+icem",
        }
    }

    /// Whether it needs an inverse dynamics model.
    pub fn needs_idm(self) -> bool {
        !matches!(self, Self::Cem | Self::Icem | Self::Mppi)
    }

    /// Whether its goals are subgoals on the way to the given one, which a model of subgoals proposes: see
    /// [`Subgoals`](crate::Subgoals).
    pub fn needs_subgoals(self) -> bool {
        matches!(self, Self::SubgoalsIdm | Self::SubgoalsIcem)
    }

    /// The search without an inverse dynamics model, for goals that are not latents; `None` for planners that do not
    /// search.
    pub fn unseeded(self) -> Option<Self> {
        match self {
            Self::Idm | Self::SubgoalsIdm => None,
            Self::Cem | Self::IdmCem => Some(Self::Cem),
            Self::Icem | Self::IdmIcem | Self::SubgoalsIcem => Some(Self::Icem),
            Self::Mppi | Self::IdmMppi => Some(Self::Mppi),
        }
    }

    /// The planner, with the goals' latents (h, w, C) in order for an inverse dynamics model.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names an invalid setting or the missing inverse dynamics model.
    pub fn build(
        self,
        settings: &PlannerSettings,
        idm: Option<&Arc<TrainedIdm>>,
        goals: &[Tensor],
    ) -> Result<Box<dyn Planner>, PlanError> {
        let inverse = || {
            let idm = idm.ok_or_else(|| {
                PlanError::Setting(format!(
                    "the planner {self} needs an inverse dynamics model; train one with wm train idm"
                ))
            })?;
            InversePlanner::new(Arc::clone(idm), settings.idm.clone(), goals.to_vec())
        };
        let search: Box<dyn Planner> = match self {
            Self::Idm | Self::SubgoalsIdm => return Ok(Box::new(inverse()?)),
            Self::Cem | Self::IdmCem => Box::new(Cem::new(settings.cem.clone())?),
            Self::Icem | Self::IdmIcem | Self::SubgoalsIcem => {
                Box::new(Icem::new(settings.icem.clone())?)
            }
            Self::Mppi | Self::IdmMppi => Box::new(Mppi::new(settings.mppi.clone())?),
        };
        if self.needs_idm() {
            return Ok(Box::new(SeededSearch::new(self.name(), inverse()?, search)));
        }
        Ok(search)
    }
}

impl fmt::Display for PlannerChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for PlannerChoice {
    type Err = PlanError;

    fn from_str(name: &str) -> Result<Self, PlanError> {
        let found = Self::ALL.into_iter().find(|choice| choice.name() == name);
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            PlanError::Setting(format!("unknown planner {name:?}; expected one of {names}"))
        })
    }
}
