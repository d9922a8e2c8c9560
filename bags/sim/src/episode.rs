//! One episode, from one seed.

use image::{GrayImage, RgbImage};
use nalgebra::Vector3;
use rand::Rng;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::arm::{self, ToolPose};
use crate::error::Error;
use crate::object::{COLOURS, Object, Shape};
use crate::render::{Camera, Renderer, Surroundings};
use crate::scene::Scene;
use crate::teleop::Operator;
use crate::world::{WORKSPACE_M, World};

/// Fewest and most frames of an episode: two make an action visible, and the upper bound is 20 minutes.
pub const FRAMES: std::ops::RangeInclusive<usize> = 2..=6000;

/// What kind of episode to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeOptions {
    /// How many frames, at 5 Hz.
    pub frames: usize,
    /// Whether to render object and gripper masks.
    pub masks: bool,
}

impl Default for EpisodeOptions {
    fn default() -> Self {
        Self {
            frames: 50,
            masks: false,
        }
    }
}

/// What is observed at one time, and the action taken then.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The camera's picture, 256 by 256.
    pub image: RgbImage,
    /// 0 background, 1 gripper, 2 and up the objects; if requested.
    pub mask: Option<GrayImage>,
    /// The tool's pose.
    pub tool: ToolPose,
    /// How far the gripper is open, 0 to 1.
    pub opening: f64,
    /// The action that leads from this frame to the next: dx dy dz (m), droll dpitch dyaw (rad), gripper
    /// (0 closed to 1 open).
    pub action: [f32; 7],
    /// Middle of the foot of each object, metres.
    pub objects: Vec<Vector3<f64>>,
}

/// An episode: frames 0.2 s apart, and what was asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// The seed that it came from.
    pub seed: u64,
    /// The instruction in English.
    pub instruction: String,
    /// Whether what was asked for came about.
    pub success: bool,
    /// The frames.
    pub frames: Vec<Frame>,
}

impl Episode {
    /// Makes the episode of a seed: the same seed and options give the same episode.
    ///
    /// # Errors
    /// [`Error::Frames`] if the number of frames is outside [`FRAMES`].
    pub fn generate(seed: u64, options: &EpisodeOptions) -> Result<Self, Error> {
        if !FRAMES.contains(&options.frames) {
            return Err(Error::Frames {
                frames: options.frames,
                possible: FRAMES,
            });
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let surroundings = some_surroundings(&mut rng);
        let mut world = some_world(&mut rng);
        let scene = Scene::new(&world);
        let camera = Camera::beside_the_arm();
        let viewer = camera.viewer_axes().map(|axis| axis.cast());
        let mut renderer = Renderer::new(&surroundings, camera);
        let mut operator = Operator::new(rng, viewer, &world);
        let mut frames = Vec::with_capacity(options.frames);
        for index in 0..options.frames {
            let picture = renderer.render(&scene.parts(&world), options.masks);
            let (tool, opening) = (*world.tool(), world.opening());
            let objects = world.objects().iter().map(Object::position).collect();
            let command = operator.command(&world, options.frames - index);
            let action = world.step(&command).values();
            frames.push(Frame {
                image: picture.rgb,
                mask: picture.mask,
                tool,
                opening,
                action,
                objects,
            });
        }
        let (instruction, success) = operator.conclude(&world);
        Ok(Self {
            seed,
            instruction,
            success,
            frames,
        })
    }
}

/// Plain table and floor in one of a few tints, and a light that varies a little.
fn some_surroundings(rng: &mut ChaCha8Rng) -> Surroundings {
    const TABLES: [[f32; 3]; 4] = [
        [0.74, 0.66, 0.55],
        [0.68, 0.70, 0.70],
        [0.60, 0.66, 0.62],
        [0.72, 0.70, 0.62],
    ];
    let table = TABLES[rng.random_range(0..TABLES.len())];
    let brightness = rng.random_range(0.94..1.06);
    Surroundings {
        table_srgb: table.map(|v| v * brightness),
        floor_srgb: [0.30, 0.33, 0.38].map(|v| v * brightness),
        light: [
            1.0,
            rng.random_range(0.96..1.0),
            rng.random_range(0.92..1.0),
        ],
        light_direction: [
            0.12 + rng.random_range(-0.05..0.05),
            -0.24 + rng.random_range(-0.05..0.05),
            1.0,
        ],
    }
}

fn some_shape(rng: &mut ChaCha8Rng, bowl_allowed: bool) -> Shape {
    let kind = rng.random_range(0.0..1.0);
    if kind < 0.10 && bowl_allowed {
        Shape::Bowl {
            radius: rng.random_range(0.048..0.056),
            height: rng.random_range(0.026..0.034),
        }
    } else if kind < 0.40 {
        let half_x = rng.random_range(0.018..0.032);
        let half_y = rng.random_range(0.016..0.024_f64).min(half_x);
        Shape::Box {
            half_x,
            half_y,
            height: rng.random_range(0.028..0.052),
        }
    } else if kind < 0.64 {
        Shape::Cylinder {
            radius: rng.random_range(0.018..0.027),
            height: rng.random_range(0.035..0.062),
        }
    } else if kind < 0.82 {
        Shape::Ball {
            radius: rng.random_range(0.020..0.027),
        }
    } else {
        Shape::Cone {
            radius: rng.random_range(0.024..0.030),
            height: rng.random_range(0.045..0.062),
        }
    }
}

/// Two to four objects of different colours that do not touch, and a hand over them.
fn some_world(rng: &mut ChaCha8Rng) -> World {
    let count = rng.random_range(2..=4);
    let mut colours = COLOURS;
    colours.shuffle(rng);
    let mut objects: Vec<Object> = Vec::with_capacity(count);
    for colour in colours.into_iter().take(count) {
        let bowl_allowed = !objects
            .iter()
            .any(|object| matches!(object.shape, Shape::Bowl { .. }));
        let shape = some_shape(rng, bowl_allowed);
        // Four objects nearly always fit; a scene that is too full gets one fewer.
        for _ in 0..60 {
            let (x, y) = (rng.random_range(0.20..0.34), rng.random_range(-0.11..0.11));
            // A box's long sides run away from the viewer: across the way in which the hand opens.
            let yaw = std::f64::consts::FRAC_PI_2 + rng.random_range(-1.1..1.1);
            let object = Object::standing(shape, colour, x, y, yaw);
            let free = objects.iter().all(|other| {
                (other.position() - object.position()).norm()
                    > other.shape.bounding_radius() + object.shape.bounding_radius() + 0.02
            });
            if free {
                objects.push(object);
                break;
            }
        }
    }
    let [low, high] = WORKSPACE_M;
    let tool = loop {
        let mut position = Vector3::from_fn(|axis, _| rng.random_range(low[axis]..high[axis]));
        // Above all objects and their neighbours.
        position.z = position.z.max(0.09);
        let rpy = Vector3::new(
            rng.random_range(-0.2..0.2),
            rng.random_range(-0.2..0.2),
            rng.random_range(-0.9..0.9),
        );
        let tool = ToolPose { position, rpy };
        if arm::inverse(&tool.frame()).is_some() {
            break tool;
        }
    };
    let opening = if rng.random_bool(0.75) { 1.0 } else { 0.0 };
    World::new(objects, tool, opening)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FIRST_OBJECT_MASK, GRIPPER_MASK};
    use nalgebra::Point3;

    fn short(frames: usize) -> EpisodeOptions {
        EpisodeOptions {
            frames,
            masks: true,
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_episode() {
        let first = Episode::generate(5, &short(6)).expect("valid options");
        let second = Episode::generate(5, &short(6)).expect("valid options");
        assert!(first == second);
        let other = Episode::generate(6, &short(6)).expect("valid options");
        assert!(first.frames[0].image != other.frames[0].image);
    }

    #[test]
    fn actions_explain_the_change_of_pose() {
        for seed in 0..4 {
            let episode = Episode::generate(seed, &short(20)).expect("valid options");
            let mut largest = 0.0_f64;
            for pair in episode.frames.windows(2) {
                let change = pair[1].tool.position - pair[0].tool.position;
                let turn = pair[1].tool.rpy - pair[0].tool.rpy;
                for axis in 0..3 {
                    assert!((change[axis] - f64::from(pair[0].action[axis])).abs() < 1e-6);
                    assert!((turn[axis] - f64::from(pair[0].action[axis + 3])).abs() < 1e-6);
                    largest = largest.max(change[axis].abs());
                }
                let gripper = pair[0].action[6];
                assert!(gripper == 0.0 || gripper == 1.0);
            }
            assert!(largest > 0.01 && largest < 0.06, "{largest}");
        }
    }

    #[test]
    fn masks_are_where_the_gripper_and_the_objects_are() {
        let camera = Camera::beside_the_arm();
        let mut checked = 0;
        for seed in 0..6 {
            let episode = Episode::generate(seed, &short(2)).expect("valid options");
            let frame = &episode.frames[0];
            let mask = frame.mask.as_ref().expect("asked for");
            assert!(
                mask.pixels().any(|pixel| pixel.0 == [GRIPPER_MASK]),
                "seed {seed}"
            );
            for (index, position) in frame.objects.iter().enumerate() {
                let middle = Point3::from(position + Vector3::z() * 0.015);
                let [x, y] = camera.pixel(&middle).expect("in front of the camera");
                assert!((0.0..256.0).contains(&x) && (0.0..256.0).contains(&y));
                let value = mask.get_pixel(x as u32, y as u32).0[0];
                // The gripper, the arm or a nearer object may hide it.
                if value == FIRST_OBJECT_MASK + index as u8 {
                    checked += 1;
                }
            }
        }
        assert!(checked >= 10, "{checked}");
    }

    #[test]
    fn too_few_frames_are_an_error() {
        assert!(matches!(
            Episode::generate(0, &short(1)),
            Err(Error::Frames { frames: 1, .. })
        ));
    }
}
