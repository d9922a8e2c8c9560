//! An episode, made from a seed.

use image::{GrayImage, RgbImage};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand::seq::IndexedRandom as _;
use rand_chacha::ChaCha8Rng;

use crate::arm::ToolPose;
use crate::attempt::Attempt;
use crate::environment::Environment;
use crate::episode_options::EpisodeOptions;
use crate::error::Error;
use crate::layout;
use crate::object::Object;
use crate::render::{Camera, Renderer, Surroundings};
use crate::room;
use crate::scene::Scene;
use crate::teleop::Failure;
use crate::world::World;

/// Fewest and most frames of an episode: two make an action visible, and the upper bound is 20 minutes.
pub const FRAMES: std::ops::RangeInclusive<usize> = 2..=6000;

/// Random stream that draws the policy and its goal; operators, the oracle and goals use others.
const POLICY_STREAM: u64 = 48;
/// Random stream that draws distractors: they change nothing else.
const DISTRACTOR_STREAM: u64 = 56;

/// An observation, and the action taken there.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The camera's picture, 256 by 256.
    pub image: RgbImage,
    /// 0 background, 1 gripper, 2 and up the objects; if requested.
    pub mask: Option<GrayImage>,
    /// The tool's pose.
    pub tool: ToolPose,
    /// Opening of the gripper, 0 to 1.
    pub opening: f64,
    /// The action that leads from this frame to the next: dx dy dz (m), droll dpitch dyaw (rad), gripper
    /// (0 closed to 1 open).
    pub action: [f32; 7],
    /// Middle of the foot of each object, metres.
    pub objects: Vec<Vector3<f64>>,
}

/// An episode: frames 0.2 s apart, and its task.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// The seed.
    pub seed: u64,
    /// The instruction in English.
    pub instruction: String,
    /// Whether the task succeeded, by the world at the end.
    pub success: bool,
    /// The planned failure; rarely, the episode succeeds all the same.
    pub failure: Option<Failure>,
    /// Names of the objects, as in instructions, in the order of their mask values.
    pub objects: Vec<String>,
    /// The camera, which does not move.
    pub camera: Camera,
    /// The frames.
    pub frames: Vec<Frame>,
    /// The first frame's picture with distractors, if requested: objects that the task does not name.
    pub distracted: Option<RgbImage>,
}

impl Episode {
    /// Makes the episode of a seed: the same seed and options give the same episode.
    ///
    /// # Errors
    /// [`Error::Frames`] if the number of frames is outside `FRAMES`, [`Error::Share`] if the share of
    /// failures or of disturbed actions is outside 0 to 1, [`Error::NoGoal`] for policies without goals, and
    /// [`Error::Unsolvable`] if none of 40 tables allows their goal.
    pub fn generate(seed: u64, options: &EpisodeOptions) -> Result<Self, Error> {
        if !FRAMES.contains(&options.frames) {
            return Err(Error::Frames {
                frames: options.frames,
                possible: FRAMES,
            });
        }
        for (of, share) in [
            ("failures", options.failures),
            ("disturbed actions", options.disturbance),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::Share { of, share });
            }
        }
        let Stage {
            surroundings,
            camera,
            world,
            attempt,
        } = Stage::of(seed, options)?;
        let scene = Scene::new(&world);
        let objects = world.objects().iter().map(Object::name).collect();
        let mut renderer = Renderer::new(&surroundings, camera.clone());
        let frames = attempt
            .steps
            .iter()
            .map(|(world, action)| {
                let picture = renderer.render(&scene.parts(world), options.masks);
                Frame {
                    image: picture.rgb,
                    mask: picture.mask,
                    tool: *world.tool(),
                    opening: world.opening(),
                    action: *action,
                    objects: world.objects().iter().map(Object::position).collect(),
                }
            })
            .collect();
        let distracted = (options.distractors > 0).then(|| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(DISTRACTOR_STREAM);
            let (count, variety) = (options.distractors, &options.variety);
            let world = layout::add_distractors(&world, count, variety, &mut rng);
            let parts = Scene::new(&world).parts(&world);
            renderer.render(&parts, false).rgb
        });
        Ok(Self {
            seed,
            instruction: attempt.instruction,
            success: attempt.success,
            failure: attempt.failure,
            objects,
            camera,
            frames,
            distracted,
        })
    }

    /// The name of its bag, `episode_000012`: the number is the seed.
    pub fn name(&self) -> String {
        format!("episode_{:06}", self.seed)
    }
}

/// A room with its table, and what happens there.
struct Stage {
    surroundings: Surroundings,
    camera: Camera,
    /// At the start.
    world: World,
    attempt: Attempt,
}

impl Stage {
    fn of(seed: u64, options: &EpisodeOptions) -> Result<Self, Error> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if !options.policies.is_empty() {
            rng.set_stream(POLICY_STREAM);
            return Self::of_policy(seed, options, rng);
        }
        let surroundings = room::draw_surroundings(&options.variety, &mut rng);
        let camera = room::draw_camera(&options.variety, &mut rng);
        let world = layout::lay_table(&options.variety, &mut rng);
        Ok(Self {
            surroundings,
            attempt: Attempt::of(seed, options, &camera, world.clone()),
            camera,
            world,
        })
    }

    fn of_policy(seed: u64, options: &EpisodeOptions, mut rng: ChaCha8Rng) -> Result<Self, Error> {
        let policy = options.policies.choose(&mut rng).ok_or(Error::NoGoal)?;
        let kind = options.goals.choose(&mut rng).ok_or(Error::NoGoal)?;
        let environment = Environment::new(*kind, seed, &options.variety)?;
        Ok(Self {
            surroundings: *environment.surroundings(),
            camera: environment.camera().clone(),
            world: environment.world().clone(),
            attempt: Attempt::of_policy(*policy, environment, options.frames)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{GoalKind, ScriptedPolicy};
    use crate::scene::{FIRST_OBJECT_MASK, GRIPPER_MASK};
    use crate::teleop::LARGEST_STEP_M;
    use crate::variety::{Span, Variety};
    use nalgebra::Point3;

    fn short(frames: usize) -> EpisodeOptions {
        EpisodeOptions {
            frames,
            masks: true,
            ..EpisodeOptions::default()
        }
    }

    #[test]
    fn same_seed_gives_the_same_episode() {
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
    fn masks_cover_the_gripper_and_the_objects() {
        let camera = Camera::beside_the_arm();
        let options = EpisodeOptions {
            variety: Variety {
                camera_shift_m: Span::around_zero(0.0),
                camera_aim_m: Span::around_zero(0.0),
                camera_roll_rad: Span::around_zero(0.0),
                ..Variety::default()
            },
            ..short(2)
        };
        let mut checked = 0;
        for seed in 0..6 {
            let episode = Episode::generate(seed, &options).expect("valid options");
            let frame = &episode.frames[0];
            let mask = frame.mask.as_ref().expect("requested");
            assert!(
                mask.pixels().any(|pixel| pixel.0 == [GRIPPER_MASK]),
                "seed {seed}"
            );
            for (index, position) in frame.objects.iter().enumerate() {
                let middle = Point3::from(position + Vector3::z() * 0.002);
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
    fn policies_act_from_the_starts_of_the_environment() {
        let options = EpisodeOptions {
            goals: vec![GoalKind::Push],
            policies: ScriptedPolicy::ALL.to_vec(),
            ..short(24)
        };
        let mut succeeded = 0;
        for seed in 0..24 {
            let episode = Episode::generate(seed, &options).expect("valid options");
            let mut environment =
                Environment::new(GoalKind::Push, seed, &options.variety).expect("a goal");
            assert_eq!(episode.instruction, environment.instruction());
            assert!(
                episode.frames[0].image == environment.picture(),
                "seed {seed}"
            );
            let actions = episode.frames.iter().map(|frame| frame.action);
            let mut motions = actions.flat_map(|action| [action[0], action[1], action[2]]);
            assert!(motions.all(|motion| f64::from(motion.abs()) < LARGEST_STEP_M + 1e-6));
            succeeded += usize::from(episode.success);
        }
        assert!((4..=20).contains(&succeeded), "{succeeded} of 24");
        let aimless = EpisodeOptions {
            goals: Vec::new(),
            ..options
        };
        assert!(matches!(Episode::generate(0, &aimless), Err(Error::NoGoal)));
    }

    #[test]
    fn distractors_change_the_first_picture_and_nothing_else() {
        let plain = Episode::generate(5, &short(3)).expect("valid options");
        assert!(plain.distracted.is_none());
        let options = EpisodeOptions {
            distractors: 2,
            ..short(3)
        };
        let mut episode = Episode::generate(5, &options).expect("valid options");
        let distracted = episode.distracted.take().expect("requested");
        assert!(episode == plain);
        let first = &plain.frames[0];
        let changed = |(x, y): (u32, u32)| {
            let (before, after) = (first.image.get_pixel(x, y), distracted.get_pixel(x, y));
            (0..3).any(|channel| before[channel].abs_diff(after[channel]) > 40)
        };
        let pixels = (0..256).flat_map(|y| (0..256).map(move |x| (x, y)));
        let changed: Vec<_> = pixels.filter(|at| changed(*at)).collect();
        assert!((100..8000).contains(&changed.len()), "{}", changed.len());
        // What was there stays visible, except where a nearer object stands before it.
        let mask = first.mask.as_ref().expect("requested");
        let hidden = changed
            .iter()
            .filter(|(x, y)| mask.get_pixel(*x, *y).0[0] != 0);
        assert!(hidden.count() < changed.len() / 2);
    }

    #[test]
    fn too_few_frames_are_an_error() {
        assert!(matches!(
            Episode::generate(0, &short(1)),
            Err(Error::Frames { frames: 1, .. })
        ));
    }

    #[test]
    fn shares_beyond_one_are_an_error() {
        for share in [-0.1, 1.1, f64::NAN] {
            let options = EpisodeOptions {
                failures: share,
                ..EpisodeOptions::default()
            };
            assert!(matches!(
                Episode::generate(0, &options),
                Err(Error::Share { .. })
            ));
        }
    }
}
