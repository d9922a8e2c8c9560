//! The configuration of a pooled probe of any kind, as model folders have it.

use super::{
    LinearProbe, LinearProbeConfig, PooledProbe, ProgressProbe, ProgressProbeConfig, TemporalProbe,
    TemporalProbeConfig,
};
use crate::kinds::kind::Kind;
use crate::kinds::parse::parse;
use crate::{Loader, Result};

/// The configuration of a [`PooledProbe`].
#[derive(Clone, Debug)]
pub(crate) enum PooledProbeConfig {
    Linear(LinearProbeConfig),
    Temporal(TemporalProbeConfig),
    Progress(ProgressProbeConfig),
}

impl PooledProbeConfig {
    pub(crate) fn parse(kind: Kind, config: &str) -> Result<Self> {
        Ok(match kind {
            Kind::LinearProbe => Self::Linear(parse(config)?),
            Kind::TemporalProbe => Self::Temporal(parse(config)?),
            Kind::ProgressProbe => Self::Progress(parse(config)?),
            other => {
                let reason = format!(
                    "`{other}` is no probe, expected success-probe, linear-probe, temporal-probe or progress-probe"
                );
                return Err(wm_model::Error::config("kind", reason).into());
            }
        })
    }

    pub(crate) fn load(&self, loader: &Loader<'_>) -> Result<PooledProbe> {
        Ok(match self {
            Self::Linear(config) => PooledProbe::Linear(LinearProbe::load(config, loader)?),
            Self::Temporal(config) => {
                PooledProbe::Temporal(Box::new(TemporalProbe::load(config, loader)?))
            }
            Self::Progress(config) => PooledProbe::Progress(ProgressProbe::load(config, loader)?),
        })
    }

    /// Channels of the latents that it reads.
    pub(crate) fn features(&self) -> usize {
        match self {
            Self::Linear(config) => config.features,
            Self::Temporal(config) => config.features,
            Self::Progress(config) => config.features,
        }
    }
}
