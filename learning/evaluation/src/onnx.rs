//! Pretrained networks of the user's that metrics need, from ONNX files.
//!
//! Some metrics are defined by a network: the Fréchet inception distance by Inception's features, the dynamic degree by RAFT's
//! flow. This project contains none of them. A user names those that he has in a `networks.yaml`, with what each does to a
//! picture before it sees it; this crate reads that, prepares pictures as PyTorch does, runs the files, and checks what comes
//! out. A [`Role`] says what a network is for; roles without one are known by name, so that a report can list what was not
//! measured.
//!
//! ```
//! use crate::onnx::{Networks, Role};
//!
//! # fn main() -> crate::onnx::Result<()> {
//! let text = "
//! flow:
//!   file: raft.onnx
//!   input: { resize: none, range: [-1, 1] }
//! ";
//! let networks = Networks::parse(text, "networks.yaml")?;
//! for role in networks.absent() {
//!     println!("{}", role.not_measured());
//! }
//! // Built without the feature `onnx`, or without the file: an error that says so.
//! assert!(networks.flow().is_err());
//! # Ok(())
//! # }
//! ```
//!
//! # Who runs the files
//!
//! [tract](https://github.com/sonos/tract), with the feature `onnx`; it is off by default, since it takes minutes to compile.
//! A network may be shared among threads. A run uses the thread that asks for it, so that the same inputs give the same bits whatever the number of threads; on
//! another processor, or in a batch of another size, the last bits may differ. A file that is damaged is an error, not a panic: tract's own panics are caught, though
//! each still writes its line to stderr.
//!
//! Opsets 18 and 20 were tried. Convolution, pooling and sampling over time work; the operators `Attention` of opset 23 and
//! `Loop` are missing.
//!
//! # What it does not do
//!
//! - It computes no metric: no Fréchet distance, no means over time.
//! - It downloads nothing, and reads no weights outside the ONNX file.
//! - It does not limit the memory or the time that a network takes: run only files that you trust that far.
//! - It does not round to levels between resize and normalisation, as Pillow does: with `antialias: true` it equals
//!   torchvision's `Resize` on float tensors, and differs from that on Pillow pictures by up to half a level per pass.

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

// Metrics open a network once and share it among their threads.
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
