//! A software renderer: z-buffer with 2x2 supersampling, one key light with a soft shadow, soft ambient light. It draws
//! [`Part`]s over a table.

mod camera;
mod mesh;
mod pattern;
mod raster;
mod shading;

pub use camera::{Camera, IMAGE_SIZE};
pub use mesh::Mesh;
pub use pattern::{Pattern, PatternKind};
pub use shading::{Picture, Renderer, Surroundings};

use nalgebra::Isometry3;
use std::sync::Arc;

/// A mesh with a pose, a colour and a mask value.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its shape.
    pub mesh: Arc<Mesh>,
    /// Its frame in the base frame.
    pub pose: Isometry3<f32>,
    /// Colour in linear light, 0 to 1.
    pub albedo: [f32; 3],
    /// Strength of the highlight, 0 (dull) to about 0.5.
    pub gloss: f32,
    /// Value in the mask picture; 0 is background.
    pub mask: u8,
}

/// Converts a colour from sRGB (0 to 1) to linear light.
pub fn linear(srgb: [f32; 3]) -> [f32; 3] {
    srgb.map(|v| v.powf(2.2))
}
