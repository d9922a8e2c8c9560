//! The user's pretrained networks for metrics, from ONNX files.
//!
//! Some metrics need a network: the Fréchet inception distance needs Inception's features, the dynamic degree RAFT's
//! flow. This project contains none of them. The user lists networks in a `networks.yaml`, with the preparation of
//! pictures for each. This module reads it, prepares pictures as PyTorch does, runs the files, and checks their
//! outputs. A [`Role`] is the purpose of a network; missing roles have names, so that reports can list missing metrics.
//!
//! ```
//! use wm_evaluation::onnx::{Networks, Role};
//!
//! # fn main() -> wm_evaluation::onnx::Result<()> {
//! let text = "
//! flow:
//!   file: raft.onnx
//!   input: { resize: none, range: [-1, 1] }
//! ";
//! let networks = Networks::parse(text, "networks.yaml")?;
//! for role in networks.absent() {
//!     println!("{}", role.not_measured());
//! }
//! // Without the feature `onnx`, or without the file: an error with the reason.
//! assert!(networks.flow().is_err());
//! # Ok(())
//! # }
//! ```
//!
//! # Runtime
//!
//! [tract](https://github.com/sonos/tract), with the feature `onnx`; off by default, since it takes minutes to compile. Threads
//! may share a network. A run uses only the calling thread, so equal inputs give equal bits whatever the number of threads; on
//! another processor, or in a batch of another size, the last bits may differ. Panics of tract on a damaged file become errors,
//! but each still writes a line to stderr.
//!
//! Opsets 18 and 20 were tested. Convolution, pooling and sampling over time work; the operators `Attention` of opset 23 and
//! `Loop` are missing.
//!
//! # Limits
//!
//! - It computes no metric: no Fréchet distance, no means over time.
//! - It downloads nothing, and reads no weights outside the ONNX file.
//! - It does not limit the memory or time of a network: run only trusted files.
//! - It does not round to levels between resize and normalisation, unlike Pillow: with `antialias: true` it equals
//!   torchvision's `Resize` on float tensors, and differs from Pillow pictures by up to half a level per pass.

mod batches;
mod depth;
mod digest;
mod error;
mod features;
mod field;
mod flow;
mod input;
mod network;
mod networks;
mod pooling;
mod resample;
mod role;
mod runtime;
mod scores;
mod spec;
mod tensor;
mod tracks;

pub use depth::{Depth, DepthMap};
pub use digest::Digest;
pub use error::{Error, Result};
pub use features::{ClipFeatures, Features};
pub use flow::{Flow, FlowField};
pub use network::{Network, Port};
pub use networks::Networks;
pub use role::{InputKind, OutputKind, Role};
pub use scores::{Distance, Score, Scores};
pub use spec::{Channels, Input, Layout, Output, Pooling, Resize, Size, Spec};
pub use tensor::Tensor;
pub use tracks::{Query, TrackPoint, Tracks};

// Metrics share a network among threads.
const _: () = {
    const fn is_shared<T: Send + Sync>() {}
    is_shared::<Features>();
    is_shared::<ClipFeatures>();
    is_shared::<Scores>();
    is_shared::<Distance>();
    is_shared::<Flow>();
    is_shared::<Depth>();
    is_shared::<Tracks>();
};
