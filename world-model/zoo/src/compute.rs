//! Engine, device and number format together.

use candle_core::{DType, Device, DeviceLocation};

use wm_model::Place;

use crate::{Engine, Error, Precision, Result};

/// What computes a model, where, and in which format its weights are.
#[derive(Clone, Debug)]
pub struct Compute {
    engine: Engine,
    device: Device,
    precision: Precision,
}

impl Compute {
    /// `engine` on `device`, with weights that are rounded to `precision`, as [`Loader`](crate::Loader) does it.
    ///
    /// # Errors
    /// If the engine does not compute on that device, or not in that precision.
    pub fn new(engine: Engine, device: Device, precision: Precision) -> Result<Self> {
        check(engine, device.location())?;
        if engine == Engine::Candle && precision == Precision::Int8 {
            return Err(Error::EnginePrecision { engine, precision });
        }
        Ok(Self {
            engine,
            device,
            precision,
        })
    }

    /// `engine` on the CPU, which every engine computes on.
    ///
    /// # Errors
    /// If the engine does not compute in that precision.
    pub fn on_cpu(engine: Engine, precision: Precision) -> Result<Self> {
        Self::new(engine, Device::Cpu, precision)
    }

    /// As a loaded model's `place` says it.
    ///
    /// # Errors
    /// If its engine does not compute in that precision.
    pub fn at(place: &Place, precision: Precision) -> Result<Self> {
        Self::new(place.engine(), place.device().clone(), precision)
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
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Format of tensors of weights.
    pub fn dtype(&self) -> DType {
        self.precision.dtype()
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
            Compute::new(engine, Device::Cpu, Precision::F32).unwrap();
        }
        let error = check(Engine::Cpu, gpu).unwrap_err();
        assert!(matches!(error, Error::EngineDevice { .. }));
        let message = error.to_string();
        assert!(
            message.contains("cuda:1") && message.contains("--engine candle"),
            "{message}"
        );
    }

    #[test]
    fn eight_bits_are_for_the_kernels() {
        Compute::on_cpu(Engine::Cpu, Precision::Int8).unwrap();
        let error = Compute::on_cpu(Engine::Candle, Precision::Int8).unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains("int8") && message.contains("--engine cpu"),
            "{message}"
        );
    }
}
