//! The identity of a cost computation.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wm_model::WorldModel;
use wm_planner::{PlanError, fingerprint};

use crate::message::quoted;

/// Two processes with equal identities compute the same costs, bit for bit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Version of this crate.
    pub version: String,
    /// [`WorldModel::hash`].
    pub model_hash: String,
    /// Architecture, and the instructions of the kernels, or a device.
    pub kernels: String,
    /// [`wm_planner::fingerprint`], which distinguishes further builds and processors.
    pub fingerprint: [u8; 32],
}

/// The difference between two processes.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
pub enum IdentityError {
    #[error("its version is {found}, expected {expected}")]
    Version { expected: String, found: String },
    #[error("its model has the hash {found}, expected {expected}")]
    Model { expected: String, found: String },
    #[error("it computes with {found}, expected {expected}: rounding would differ")]
    Kernels { expected: String, found: String },
    /// Another build, or another difference of the processors.
    #[error("its result of the trial differs: its rounding differs")]
    Fingerprint,
}

impl Identity {
    /// The identity of this process with a model. Takes about as long as costing a few candidates.
    ///
    /// # Errors
    /// The model fails.
    pub fn of(model: &WorldModel) -> Result<Self, PlanError> {
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").into(),
            model_hash: model.hash.clone(),
            kernels: format!("{}, {}", std::env::consts::ARCH, model.transition.place()),
            fingerprint: fingerprint(&model.transition)?,
        })
    }

    /// Checks that `other` computes the same costs.
    ///
    /// # Errors
    /// The difference.
    pub fn require(&self, other: &Self) -> Result<(), IdentityError> {
        let pair = |expected: &str, found: &str| (expected.to_owned(), quoted(found));
        if other.version != self.version {
            let (expected, found) = pair(&self.version, &other.version);
            return Err(IdentityError::Version { expected, found });
        }
        if other.model_hash != self.model_hash {
            let (expected, found) = pair(&self.model_hash, &other.model_hash);
            return Err(IdentityError::Model { expected, found });
        }
        if other.kernels != self.kernels {
            let (expected, found) = pair(&self.kernels, &other.kernels);
            return Err(IdentityError::Kernels { expected, found });
        }
        if other.fingerprint != self.fingerprint {
            return Err(IdentityError::Fingerprint);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named() {
        let own = Identity {
            version: "1".into(),
            model_hash: "abc".into(),
            kernels: "x86_64 avx2".into(),
            fingerprint: [7; 32],
        };
        assert_eq!(own.require(&own), Ok(()));
        let differs = |other: Identity| own.require(&other).unwrap_err().to_string();
        let other = |change: fn(&mut Identity)| {
            let mut other = own.clone();
            change(&mut other);
            differs(other)
        };
        let version = other(|other| other.version = "2".into());
        assert_eq!(version, "its version is 2, expected 1");
        assert!(other(|other| other.model_hash = "def".into()).contains("hash def, expected abc"));
        let kernels = other(|other| other.kernels = "aarch64 portable".into());
        assert!(kernels.contains("aarch64 portable, expected x86_64 avx2"));
        assert!(other(|other| other.fingerprint = [8; 32]).contains("trial"));
    }
}
