//! NVIDIA GPUs.

use candle_core::Device;

/// Opens a GPU with a stream of its own. Candle takes two openings of one GPU for two devices, and refuses operations
/// between their tensors.
pub(super) fn open(number: usize) -> Result<Device, String> {
    crate::cuda::load().map_err(|missing| missing.to_string())?;
    // Not the stream of the calling thread, as `new_cuda` has it: one thread loads, another computes.
    let device = Device::new_cuda_with_stream(number)
        .map_err(|error| format!("no NVIDIA GPU of this number can be used: {error}"))?;
    if let Device::Cuda(device) = &device {
        // SAFETY: its tensors are used in this one stream only, which keeps the order in which they are written, read and
        // freed; candle refuses those of another opening. Events for that order cannot be recorded in a graph.
        unsafe { device.disable_event_tracking() };
    }
    Ok(device)
}
