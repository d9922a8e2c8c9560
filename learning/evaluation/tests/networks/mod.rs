//! Descriptions of networks, and runs of networks: those of `fixtures/`, damaged ones, and real ones if available.

// Clippy allows unwrap in tests, but not in their helpers.
#[cfg(feature = "onnx")]
mod damaged;
mod description;
#[cfg(feature = "onnx")]
mod fitting;
#[cfg(feature = "onnx")]
mod parity;
#[cfg(feature = "onnx")]
mod pictures;
#[cfg(feature = "onnx")]
mod real;
