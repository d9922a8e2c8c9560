//! The table and the hand at the start of an episode.

use nalgebra::Vector3;
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::arm::{self, ToolPose};
use crate::object::{COLOURS, Colour, Object, Shape};
use crate::variety::{Span, Variety};
use crate::world::{WORKSPACE_M, World};

/// Start positions of objects: x and y, metres, all in view and within reach.
const PLACES_M: [Span; 2] = [Span::new(0.20, 0.34), Span::new(-0.085, 0.115)];
/// Minimum gap between objects, metres.
const GAP_M: f64 = 0.02;

/// Draws objects and mats of different colours that do not touch, and a hand over them.
pub fn lay_table(variety: &Variety, rng: &mut ChaCha8Rng) -> World {
    let mats = if rng.random_bool(variety.mat_share) {
        1 + usize::from(rng.random_bool(variety.second_mat_share))
    } else {
        0
    };
    let count = variety.object_count(rng);
    let mut colours = COLOURS;
    colours.shuffle(rng);
    let mut objects: Vec<Object> = Vec::with_capacity(count + mats);
    for (index, colour) in colours.into_iter().take(count + mats).enumerate() {
        let shape = if index < count {
            let bowl_allowed = count > 1
                && !objects
                    .iter()
                    .any(|object| matches!(object.shape, Shape::Bowl { .. }));
            let size = variety.object_size.pick(rng);
            draw_shape(rng, bowl_allowed, size)
        } else {
            Shape::Mat {
                radius: rng.random_range(0.034..0.042),
            }
        };
        let colour = tint(colour, variety, rng);
        // A full table gets one object fewer.
        objects.extend(stand(shape, colour, &objects, rng));
    }
    let opening = if rng.random_bool(0.75) { 1.0 } else { 0.0 };
    World::new(objects, draw_tool(rng), opening)
}

/// The table of `world` with up to `count` more objects, of other colours than those there; fewer if no place is free.
pub fn add_distractors(
    world: &World,
    count: usize,
    variety: &Variety,
    rng: &mut ChaCha8Rng,
) -> World {
    let mut objects = world.objects().to_vec();
    let is_new = |colour: &Colour| {
        let mut there = world.objects().iter();
        there.all(|object| object.colour.name != colour.name)
    };
    let mut colours: Vec<Colour> = COLOURS.into_iter().filter(is_new).collect();
    colours.shuffle(rng);
    for colour in colours.into_iter().take(count) {
        let size = variety.object_size.pick(rng);
        let shape = draw_shape(rng, false, size);
        let colour = tint(colour, variety, rng);
        objects.extend(stand(shape, colour, &objects, rng));
    }
    World::new(objects, *world.tool(), world.opening())
}

/// An object at a random place that touches none of `others`; `None` if 60 draws find no place.
fn stand(shape: Shape, colour: Colour, others: &[Object], rng: &mut ChaCha8Rng) -> Option<Object> {
    (0..60).find_map(|_| {
        let [x, y] = PLACES_M.map(|span| span.pick(rng));
        // A box's long sides run away from the viewer, across the hand's opening.
        let yaw = std::f64::consts::FRAC_PI_2 + rng.random_range(-1.1..1.1);
        let object = Object::standing(shape, colour, x, y, yaw);
        let is_free = others.iter().all(|other| {
            (other.position() - object.position()).norm()
                > other.shape.bounding_radius() + object.shape.bounding_radius() + GAP_M
        });
        is_free.then_some(object)
    })
}

/// Draws a hand above all objects and mats.
fn draw_tool(rng: &mut ChaCha8Rng) -> ToolPose {
    let [low, high] = WORKSPACE_M;
    loop {
        let mut position = Vector3::from_fn(|axis, _| rng.random_range(low[axis]..high[axis]));
        position.z = position.z.max(0.09);
        let rpy = Vector3::new(
            rng.random_range(-0.3..0.3),
            rng.random_range(-0.3..0.3),
            rng.random_range(-0.9..0.9),
        );
        let tool = ToolPose { position, rpy };
        if arm::inverse(&tool.frame()).is_some() {
            return tool;
        }
    }
}

fn tint(colour: Colour, variety: &Variety, rng: &mut ChaCha8Rng) -> Colour {
    let srgb = colour
        .srgb
        .map(|v| (v + variety.object_tint.pick_f32(rng)).clamp(0.0, 1.0));
    Colour { srgb, ..colour }
}

/// Draws a shape with lengths `size` times the usual ones; all except the bowl fit between the open fingers.
fn draw_shape(rng: &mut ChaCha8Rng, bowl_allowed: bool, size: f64) -> Shape {
    let kind = rng.random_range(0.0..1.0);
    if kind < 0.13 && bowl_allowed {
        Shape::Bowl {
            radius: rng.random_range(0.048..0.056),
            height: rng.random_range(0.026..0.034),
        }
    } else if kind < 0.40 {
        let half_x = size * rng.random_range(0.018..0.030);
        let half_y = size * rng.random_range(0.015..0.023_f64);
        Shape::Box {
            half_x: half_x.max(half_y),
            half_y: half_y.min(half_x),
            height: size * rng.random_range(0.028..0.052),
        }
    } else if kind < 0.64 {
        Shape::Cylinder {
            radius: size * rng.random_range(0.017..0.026),
            height: size * rng.random_range(0.035..0.062),
        }
    } else if kind < 0.82 {
        Shape::Ball {
            radius: size * rng.random_range(0.020..0.027),
        }
    } else {
        Shape::Cone {
            radius: size * rng.random_range(0.023..0.029),
            height: size * rng.random_range(0.045..0.062),
        }
    }
}
