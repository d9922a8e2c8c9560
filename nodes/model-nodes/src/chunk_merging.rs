//! The parameter `chunk_merging`.

use anyhow::{Context as _, Result};
use wm_ros::{Descriptor, Node};

use crate::history::ChunkMerging;

/// Declares the parameter and reads it.
///
/// # Errors
/// Names a value that is no rule; the parameter is of another type.
pub fn declare(node: &Node) -> Result<ChunkMerging> {
    let text = "how overlapping action chunks are merged: latest, weighted (0.3 older, 0.7 newer) or average";
    let name = node
        .declare(
            "chunk_merging",
            "latest".to_owned(),
            Descriptor::new(text).read_only(),
        )?
        .get();
    ChunkMerging::parse(&name).with_context(|| {
        format!("parameter chunk_merging is \"{name}\"; expected latest, weighted or average")
    })
}
