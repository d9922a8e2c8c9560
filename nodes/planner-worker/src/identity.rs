//! Which costs a process would find.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wm_model::WorldModel;
use wm_planner::{PlanError, fingerprint};

use crate::message::quoted;

/// What two processes must have in common to find the same costs, bit for bit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Of this crate.
    pub version: String,
    /// [`WorldModel::hash`].
    pub model_hash: String,
    /// Architecture, and the instructions that the kernels compute with, or a device.
    pub kernels: String,
    /// [`wm_planner::fingerprint`], which also tells builds and processors apart that the rest does not.
    pub fingerprint: [u8; 32],
}

/// How two processes differ.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum IdentityError {
    /// Another release.
    #[error("its version is {found}, expected {expected}")]
    Version {
        /// Of this process.
        expected: String,
        /// Of the other.
        found: String,
    },
    /// Another model.
    #[error("its model has the hash {found}, expected {expected}")]
    Model {
        /// Of this process.
        expected: String,
        /// Of the other.
        found: String,
    },
    /// Another processor.
    #[error("it computes with {found}, expected {expected}: sums would be rounded otherwise")]
    Kernels {
        /// Of this process.
        expected: String,
        /// Of the other.
        found: String,
    },
    /// Another build, or a processor that is unlike in something else.
    #[error("its result of the trial differs: it rounds otherwise")]
    Fingerprint,
}

impl Identity {
    /// Of this process with a model, which takes about as long as costing a handful of candidates.
    ///
    /// # Errors
    /// Where the model fails.
    pub fn of(model: &WorldModel) -> Result<Self, PlanError> {
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").into(),
            model_hash: model.hash.clone(),
            kernels: format!("{}, {}", std::env::consts::ARCH, model.transition.place()),
            fingerprint: fingerprint(&model.transition)?,
        })
    }

    /// Whether `other` finds the same costs.
    ///
    /// # Errors
    /// [`IdentityError`] says how it differs.
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
    fn whatever_differs_is_named() {
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
