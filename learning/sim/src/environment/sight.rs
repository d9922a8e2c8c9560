//! Visibility of objects.

use crate::render::{Picture, Renderer};
use crate::scene::{FIRST_OBJECT_MASK, Scene};
use crate::world::World;

/// The share of object `index` that is not hidden from the camera, 0 to 1.
pub fn share_in_sight(renderer: &mut Renderer, scene: &Scene, world: &World, index: usize) -> f64 {
    // Fits: a scene has at most four objects and two mats.
    let value = FIRST_OBJECT_MASK + index as u8;
    let count = |picture: Picture| {
        let pixels = picture.mask.iter().flat_map(|mask| mask.pixels());
        pixels.filter(|pixel| pixel.0 == [value]).count()
    };
    let mut parts = scene.parts(world);
    let seen = count(renderer.render(&parts, true));
    parts.retain(|part| part.mask == value);
    let whole = count(renderer.render(&parts, true));
    // Exact: far below 2^53. An object out of view has no pixels.
    seen as f64 / whole.max(1) as f64
}
