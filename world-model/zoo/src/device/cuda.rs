//! NVIDIA GPUs.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use candle_core::Device;

/// Opens each GPU once: candle takes what is opened twice for two devices, and refuses operations between them.
pub(super) fn shared(number: usize) -> Result<Device, String> {
    static OPEN: Mutex<BTreeMap<usize, Device>> = Mutex::new(BTreeMap::new());
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(device) = open.get(&number) {
        return Ok(device.clone());
    }
    let device = apart(number)?;
    open.insert(number, device.clone());
    Ok(device)
}

/// Opens a GPU with a stream of its own.
pub(super) fn apart(number: usize) -> Result<Device, String> {
    wm_model::load_cuda().map_err(|missing| missing.to_string())?;
    // Not the stream of the calling thread, as `new_cuda` has it: what one thread loads, another uses.
    let device = Device::new_cuda_with_stream(number)
        .map_err(|error| format!("no NVIDIA GPU of this number can be used: {error}"))?;
    if let Device::Cuda(device) = &device {
        // SAFETY: its tensors are used in this one stream only, which keeps the order in which they are written, read and
        // freed; candle refuses those of another opening. Events that say so could not be recorded in a graph.
        unsafe { device.disable_event_tracking() };
    }
    Ok(device)
}
