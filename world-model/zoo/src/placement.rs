//! Where a model is to compute.

use wm_model::Place;

use crate::{DeviceName, Engine, Result};

/// What is to compute a model's parts, before a device is opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Placement {
    engine: Engine,
    device: DeviceName,
    recorded: bool,
}

impl Placement {
    /// On `device`: the CPU's kernels, or tensor operations on a GPU; with `recorded`, as [`Place::tensors`] has it.
    pub fn on(device: DeviceName, recorded: bool) -> Self {
        Self {
            engine: match device {
                DeviceName::Cpu => Engine::Cpu,
                DeviceName::Cuda(_) => Engine::Candle,
            },
            device,
            recorded,
        }
    }

    /// What a GPU would compute, on the CPU: the same code, as far as it can be held to anything without a GPU.
    pub fn rehearsed() -> Self {
        Self {
            engine: Engine::Candle,
            device: DeviceName::Cpu,
            recorded: true,
        }
    }

    /// Opens the device for one part of a model: each has a stream of its own, so that parts that compute in several
    /// threads do not wait for each other, nor see what another launches.
    ///
    /// # Errors
    /// [`Error::Device`](crate::Error::Device).
    pub fn open(self) -> Result<Place> {
        Ok(match self.engine {
            Engine::Cpu => Place::default(),
            Engine::Candle => Place::tensors(self.device.open_apart()?, self.recorded),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_device_decides_what_computes() {
        let opened = |placement: Placement| placement.open().unwrap().engine();
        assert_eq!(opened(Placement::on(DeviceName::Cpu, true)), Engine::Cpu);
        assert_eq!(opened(Placement::default()), Engine::Cpu);
        assert_eq!(opened(Placement::rehearsed()), Engine::Candle);
        // Whatever this build and this machine have: no other device stands in for it.
        let on_gpu = Placement::on(DeviceName::Cuda(77), false).open();
        assert!(on_gpu.unwrap_err().to_string().contains("cuda:77"));
    }
}
