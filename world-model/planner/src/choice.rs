//! Which planner, by its name.

use std::{fmt, str::FromStr, sync::Arc};

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_zoo::idm::TrainedIdm;

use crate::{
    Cem, CemSettings, Icem, IcemSettings, Inverse, InverseSettings, Mppi, MppiSettings, PlanError,
    Planner, Seeded,
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
    /// What the inverse dynamics model tells.
    Idm,
    /// CEM from there.
    IdmCem,
    /// iCEM from there.
    IdmIcem,
    /// MPPI from there.
    IdmMppi,
}

/// Settings of all planners, of which one uses its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerSettings {
    /// Of CEM.
    pub cem: CemSettings,
    /// Of iCEM.
    pub icem: IcemSettings,
    /// Of MPPI.
    pub mppi: MppiSettings,
    /// Of the inverse dynamics model.
    pub idm: InverseSettings,
}

impl PlannerChoice {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Cem,
        Self::Icem,
        Self::Mppi,
        Self::Idm,
        Self::IdmCem,
        Self::IdmIcem,
        Self::IdmMppi,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cem => "cem",
            Self::Icem => "icem",
            Self::Mppi => "mppi",
            Self::Idm => "idm",
            Self::IdmCem => "idm+cem",
            Self::IdmIcem => "idm+icem",
            Self::IdmMppi => "idm+mppi",
        }
    }

    /// Whether it asks an inverse dynamics model.
    pub fn needs_idm(self) -> bool {
        matches!(
            self,
            Self::Idm | Self::IdmCem | Self::IdmIcem | Self::IdmMppi
        )
    }

    /// The planner that searches from nothing instead of from what the inverse dynamics model tells: for goals that are
    /// no latents. None for the one that tells and does not search.
    pub fn unseeded(self) -> Option<Self> {
        match self {
            Self::Idm => None,
            Self::Cem | Self::IdmCem => Some(Self::Cem),
            Self::Icem | Self::IdmIcem => Some(Self::Icem),
            Self::Mppi | Self::IdmMppi => Some(Self::Mppi),
        }
    }

    /// The planner, for the latents (h, w, C) of `goals` in their order where it asks an inverse dynamics model.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names a setting that cannot serve, or that there is no inverse dynamics model.
    pub fn build(
        self,
        settings: &PlannerSettings,
        idm: Option<&Arc<TrainedIdm>>,
        goals: &[Tensor],
    ) -> Result<Box<dyn Planner>, PlanError> {
        let inverse = || {
            let idm = idm.ok_or_else(|| {
                PlanError::Setting(format!(
                    "the planner {self} needs an inverse dynamics model, which the model has not (wm train idm)"
                ))
            })?;
            Inverse::new(Arc::clone(idm), settings.idm.clone(), goals.to_vec())
        };
        let search: Box<dyn Planner> = match self {
            Self::Idm => return Ok(Box::new(inverse()?)),
            Self::Cem | Self::IdmCem => Box::new(Cem::new(settings.cem.clone())?),
            Self::Icem | Self::IdmIcem => Box::new(Icem::new(settings.icem.clone())?),
            Self::Mppi | Self::IdmMppi => Box::new(Mppi::new(settings.mppi.clone())?),
        };
        if self.needs_idm() {
            return Ok(Box::new(Seeded::new(self.name(), inverse()?, search)));
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
            PlanError::Setting(format!(
                "there is no planner {name:?}; expected one of {names}"
            ))
        })
    }
}
