//! Engine, device and number format together.

use candle_core::{DType, Device, DeviceLocation};

use wm_model::Place;

use crate::{Engine, Error, Result};

/// What computes a model, where, and in which format its weights are.
#[derive(Clone, Debug)]
pub struct Compute {
    engine: Engine,
    device: Device,
    precision: DType,
}

impl Compute {
    /// `engine` on `device`, with weights that are rounded to `precision` (F32 or BF16), as
    /// [`Loader`](crate::Loader) does it.
    ///
    /// # Errors
    /// [`Error::EngineDevice`] if the engine does not compute on that device.
    pub fn new(engine: Engine, device: Device, precision: DType) -> Result<Self> {
        check(engine, device.location())?;
        Ok(Self {
            engine,
            device,
            precision,
        })
    }

    /// `engine` on the CPU, which every engine computes on.
    pub fn on_cpu(engine: Engine, precision: DType) -> Self {
        Self {
            engine,
            device: Device::Cpu,
            precision,
        }
    }

    /// As a loaded model's `place` says it.
    pub fn at(place: &Place, precision: DType) -> Self {
        Self {
            engine: place.engine(),
            device: place.device().clone(),
            precision,
        }
    }

    /// The place of a model that is loaded for it.
    pub fn place(&self) -> Place {
        match self.engine {
            Engine::Cpu => Place::default(),
            Engine::Candle => Place::tensors(self.device.clone(), false),
        }
    }

    /// What computes.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Where.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Format that weights are rounded to.
    pub fn precision(&self) -> DType {
        self.precision
    }
}

fn check(engine: Engine, device: DeviceLocation) -> Result<()> {
    let device = match (engine, device) {
        (Engine::Candle, _) | (Engine::Cpu, DeviceLocation::Cpu) => return Ok(()),
        (Engine::Cpu, DeviceLocation::Cuda { gpu_id }) => format!("cuda:{gpu_id}"),
        (Engine::Cpu, DeviceLocation::Metal { gpu_id }) => format!("metal:{gpu_id}"),
    };
    Err(Error::EngineDevice { engine, device })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_compute_on_the_cpu_only() {
        let gpu = DeviceLocation::Cuda { gpu_id: 1 };
        check(Engine::Candle, gpu).unwrap();
        for engine in [Engine::Candle, Engine::Cpu] {
            Compute::new(engine, Device::Cpu, DType::F32).unwrap();
        }
        let error = check(Engine::Cpu, gpu).unwrap_err();
        assert!(matches!(error, Error::EngineDevice { .. }));
        let message = error.to_string();
        assert!(
            message.contains("cuda:1") && message.contains("--engine candle"),
            "{message}"
        );
    }
}
