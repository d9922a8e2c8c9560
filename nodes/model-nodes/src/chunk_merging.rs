//! The parameter `chunk_merging`.

use wm_ros::{Field, Parameter};

use crate::timeline::ChunkMerging;

impl Field for ChunkMerging {
    type Ros = String;
    const CHOICES: &'static [&'static str] = &["latest", "weighted", "average"];

    fn read(parameter: Parameter<String>) -> Option<Self> {
        Self::parse(&parameter.get())
    }
}
