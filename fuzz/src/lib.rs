//! Fuzz targets: one function for each format that reaches a node from a peer, a file or the command line.
//!
//! A target takes any bytes and must return: it may not panic, hang, or take memory out of proportion to its input.
//! What it parses may be refused, and usually is. `fuzz/run` runs the targets under libFuzzer; `cargo test` feeds them
//! the corpus and a fixed set of mutations of it.

mod bags;
mod configuration;
mod messages;
mod scratch;
mod tensors;

pub use bags::{bag, definition, metadata, recover};
pub use configuration::{launch, parameters};
pub use messages::{message, part, picture, request};
pub use tensors::{actions, checkpoint, model, pickle, torch_file, weights};

/// A target takes the bytes of an input.
pub type Target = fn(&[u8]);

/// All targets. Their seeds lie in `fuzz/corpus/NAME`.
pub const TARGETS: [(&str, Target); 15] = [
    ("actions", actions),
    ("bag", bag),
    ("checkpoint", checkpoint),
    ("definition", definition),
    ("launch", launch),
    ("message", message),
    ("metadata", metadata),
    ("model", model),
    ("parameters", parameters),
    ("part", part),
    ("pickle", pickle),
    ("picture", picture),
    ("recover", recover),
    ("request", request),
    ("weights", weights),
];
