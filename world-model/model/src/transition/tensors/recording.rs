//! Kernel launches that a device has recorded: a CUDA graph.

use candle_core::Device;
#[cfg(feature = "cuda")]
use candle_core::cuda_backend::cudarc::driver::{CudaGraph, sys};

use crate::Result;

/// What a device has recorded.
#[derive(Debug)]
pub(super) enum Recording {
    /// Nothing: it is no device that can.
    Nothing,
    /// A graph of launches.
    #[cfg(feature = "cuda")]
    Graph(Graph),
}

impl Recording {
    /// Has `device` record what `compute` launches there; it is called more than once. Nobody else may use the device's
    /// stream meanwhile.
    ///
    /// # Errors
    /// Those of `compute`, or that the device cannot record an operation of it.
    #[cfg(feature = "cuda")]
    pub(super) fn of(device: &Device, compute: impl Fn() -> Result<()>) -> Result<Self> {
        let Device::Cuda(device) = device else {
            return Ok(Self::Nothing);
        };
        let stream = device.cuda_stream();
        // What operations upload of sizes and strides is kept, because a recording can upload nothing; all of it is there
        // after one run.
        let _kept = device.enable_cuda_graph_htod_cache();
        compute()?;
        let mode = sys::CUstreamCaptureMode::CU_STREAM_CAPTURE_MODE_THREAD_LOCAL;
        stream.begin_capture(mode).map_err(refused)?;
        let computed = compute();
        let flags = sys::CUgraphInstantiate_flags::CUDA_GRAPH_INSTANTIATE_FLAG_AUTO_FREE_ON_LAUNCH;
        // Ended in any case: else the stream would be of no further use.
        let graph = stream.end_capture(flags);
        computed?;
        match graph.map_err(refused)? {
            Some(graph) => Ok(Self::Graph(Graph(graph))),
            None => Err(refused("there is no graph")),
        }
    }

    /// Has `device` record what `compute` launches there: no device of this build can.
    #[cfg(not(feature = "cuda"))]
    #[allow(clippy::unnecessary_wraps)] // as with the feature
    pub(super) fn of(_: &Device, _: impl Fn() -> Result<()>) -> Result<Self> {
        Ok(Self::Nothing)
    }

    /// Repeats what was recorded, or does it by `compute` where nothing was.
    pub(super) fn replay(&self, compute: impl FnOnce() -> Result<()>) -> Result<()> {
        match self {
            Self::Nothing => compute(),
            #[cfg(feature = "cuda")]
            Self::Graph(Graph(graph)) => graph.launch().map_err(refused),
        }
    }
}

/// A graph, for one thread at a time.
#[cfg(feature = "cuda")]
pub(super) struct Graph(CudaGraph);

// SAFETY: a graph is bound to no thread, but must not be used by two at once. It is reached through the lock of a model's
// `Replays` only.
#[cfg(feature = "cuda")]
unsafe impl Send for Graph {}

#[cfg(feature = "cuda")]
impl std::fmt::Debug for Graph {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Graph")
    }
}

#[cfg(feature = "cuda")]
fn refused(reason: impl std::fmt::Display) -> crate::Error {
    let reason = format!("a pass cannot be recorded or repeated ({reason}); set it to false");
    crate::Error::config("cuda_graphs", reason)
}
