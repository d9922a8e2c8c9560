//! The parameter `chunk_merging`.

use wm_motion::motion::ChunkMerging;
use wm_ros::{Field, Parameter};

/// How overlapping chunks join: the values of the parameter.
#[derive(Clone, Copy, Debug)]
pub struct Merging(pub ChunkMerging);

impl Field for Merging {
    type Ros = String;
    const CHOICES: &'static [&'static str] = &["latest", "weighted", "average"];

    fn read(parameter: Parameter<String>) -> Option<Self> {
        ChunkMerging::parse(&parameter.get()).map(Self)
    }
}
