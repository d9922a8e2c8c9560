//! Fuzz targets: a function for each format that a node receives from a peer, a file or the command line.
//!
//! A target accepts any bytes and must return without a panic, a hang, or memory out of proportion to its input. `fuzz/run`
//! runs the targets under libFuzzer; `cargo test` feeds them the corpus and a fixed set of mutations.

mod bags;
mod configuration;
mod messages;
mod scratch;
mod tensors;

pub use bags::{bag, definition, metadata, recover};
pub use configuration::{launch, parameters};
pub use messages::{message, part, picture, request};
pub use tensors::{actions, checkpoint, model, pickle, torch_file, weights};

/// A target.
pub type Target = fn(&[u8]);

/// All targets; their seeds are in `fuzz/corpus/NAME`.
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
