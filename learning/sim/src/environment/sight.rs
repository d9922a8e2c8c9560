//! How much of an object the camera sees.

use crate::render::{Picture, Renderer};
use crate::scene::{FIRST_OBJECT_MASK, Scene};
use crate::world::World;

/// The share of object `index` that neither the arm nor another object hides from the camera, 0 to 1.
pub fn share_in_sight(renderer: &mut Renderer, scene: &Scene, world: &World, index: usize) -> f64 {
    // A scene has at most four objects and two mats.
    let value = FIRST_OBJECT_MASK + index as u8;
    let count = |picture: Picture| {
        let pixels = picture.mask.iter().flat_map(|mask| mask.pixels());
        pixels.filter(|pixel| pixel.0 == [value]).count()
    };
    let mut parts = scene.parts(world);
    let seen = count(renderer.render(&parts, true));
    parts.retain(|part| part.mask == value);
    let whole = count(renderer.render(&parts, true));
    // Pictures have some ten thousand pixels. An object out of view has none.
    seen as f64 / whole.max(1) as f64
}
