//! Where a model computes.

#[cfg(feature = "cuda")]
mod cuda;
#[cfg(not(feature = "cuda"))]
mod cuda {
    //! No GPU was built for.

    use candle_core::Device;

    pub(super) use shared as apart;

    pub(super) fn shared(_: usize) -> Result<Device, String> {
        let reason = "this was built without the cargo feature `cuda` (cargo build --release --features cuda)";
        Err(reason.to_owned())
    }
}

use std::fmt;
use std::str::FromStr;

use candle_core::Device;

use crate::{Error, Result};

/// A device, as the command line names it: `cpu`, `cuda` (the first NVIDIA GPU) or `cuda:N`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceName {
    /// This machine's processor.
    #[default]
    Cpu,
    /// The NVIDIA GPU of this number, as the driver counts them.
    Cuda(usize),
}

impl DeviceName {
    /// Opens the device, the same one each time.
    ///
    /// # Errors
    /// [`Error::Device`] if the library was built without the feature `cuda`, a library of CUDA is missing, or there is
    /// no such device.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda(number) => cuda::shared(number).map_err(|reason| self.error(reason)),
        }
    }

    /// Opens the device with a stream of its own: what is computed there waits for nothing that is computed by other
    /// openings, and takes no tensor of theirs.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_apart(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda(number) => cuda::apart(number).map_err(|reason| self.error(reason)),
        }
    }

    fn error(self, reason: String) -> Error {
        Error::Device {
            device: self,
            reason,
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(number) => write!(f, "cuda:{number}"),
        }
    }
}

impl FromStr for DeviceName {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let number = match name {
            "cpu" => return Ok(Self::Cpu),
            "cuda" => Some(0),
            _ => name.strip_prefix("cuda:").and_then(|n| n.parse().ok()),
        };
        number.map(Self::Cuda).ok_or_else(|| {
            let reason = format!("`{name}`, expected cpu, cuda or cuda:N");
            wm_model::Error::config("device", reason).into()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for device in [DeviceName::Cpu, DeviceName::Cuda(0), DeviceName::Cuda(3)] {
            assert_eq!(device.to_string().parse::<DeviceName>().unwrap(), device);
        }
        assert_eq!("cuda".parse::<DeviceName>().unwrap(), DeviceName::Cuda(0));
        for wrong in ["gpu", "cuda:", "cuda:-1", "cuda:x", "cuda0"] {
            let message = wrong.parse::<DeviceName>().unwrap_err().to_string();
            let expected = format!("`{wrong}`, expected cpu, cuda or cuda:N");
            assert!(message.contains(&expected), "{message}");
        }
    }

    #[test]
    fn the_cpu_is_always_there() {
        assert!(DeviceName::Cpu.open().unwrap().is_cpu());
    }

    #[test]
    #[cfg(not(feature = "cuda"))]
    fn what_it_takes_to_have_another_is_said() {
        let message = DeviceName::Cuda(1).open().unwrap_err().to_string();
        assert!(
            message.contains("cuda:1") && message.contains("feature `cuda`"),
            "{message}"
        );
    }
}
