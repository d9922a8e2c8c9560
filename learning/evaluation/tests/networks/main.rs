//! Descriptions of networks, and networks that are run: those of `fixtures/`, damaged ones, and real ones where there are any.

// Clippy lets tests unwrap, but not what they share.
#![allow(clippy::unwrap_used)]

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
