//! The runtime of ONNX files, if built in.

#[cfg(not(feature = "onnx"))]
mod absent;
#[cfg(feature = "onnx")]
mod tract;

#[cfg(not(feature = "onnx"))]
pub(crate) use absent::Session;
#[cfg(feature = "onnx")]
pub(crate) use tract::Session;
