//! The planner's parameters.

use std::time::Duration;

use anyhow::{Result, bail};
use wm_model::planner::{CemSettings, Returned};
use wm_ros::{Descriptor, Node};

use super::{Lead, PlannerSettings};
use crate::{chunk_merging, history::ChunkMerging};

/// Largest population, iteration count and the like that is accepted: far beyond use, within every integer type.
const MANY: i64 = 1_000_000;
/// How long the first search is taken to be where there is no deadline.
const FIRST_SEARCH: Duration = Duration::from_secs(1);

/// What the parameters say, read once at the start.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    population: usize,
    iterations: usize,
    elites: usize,
    horizon: usize,
    batch: usize,
    initial_std: f32,
    std_floor: f32,
    returned: String,
    /// Frames that a plan starts from.
    pub context_frames: usize,
    plan_period: f64,
    seed: u64,
    max_age: f64,
    lead_steps: Option<usize>,
    /// How overlapping chunks join.
    pub merging: ChunkMerging,
    /// Dimensions to search; none: all but grippers.
    pub search: Vec<String>,
    /// Euler steps a predicted frame.
    pub integration_steps: usize,
    /// Bound of each translation in one model step \[m\].
    pub max_translation: f64,
    /// Bound of each rotation in one model step \[rad\].
    pub max_rotation: f64,
    /// From one camera frame to the next \[s\].
    pub frame_period: f64,
    /// Time that a search may take; none: as long as it does.
    pub deadline: Option<Duration>,
}

impl Parameters {
    pub(super) fn declare(node: &Node) -> Result<Self> {
        let count = |name: &str, default: i64, least: i64, text: &str| -> Result<usize> {
            let descriptor = Descriptor::new(text).integers(least, MANY).read_only();
            // The descriptor keeps it within its bounds.
            Ok(node.declare(name, default, descriptor)?.get() as usize)
        };
        let number = |name: &str, default: f64, from: f64, to: f64, text: &str| -> Result<f64> {
            let descriptor = Descriptor::new(text).floats(from, to).read_only();
            Ok(node.declare(name, default, descriptor)?.get())
        };
        let limit = |value: f64| if value > 0.0 { value } else { f64::INFINITY };
        let deadline = number(
            "deadline",
            1.5,
            0.0,
            3600.0,
            "time that a search may take [s]; 0: no limit",
        )?;
        let returned =
            Descriptor::new("which actions are returned: best_seen or final_mean").read_only();
        let seed = Descriptor::new(
            "seed of the first plan's candidates and noise; each later plan adds 1",
        )
        .read_only();
        let search = Descriptor::new(
            "dimensions of the action space that are searched; empty: all but grippers, which hold their state",
        );
        let lead = Descriptor::new(
            "model steps from the observed frame to the first planned action, for which the robot's motion is predicted; -1: as \
             many as the last searches took",
        );
        let lead = node
            .declare("lead_steps", -1_i64, lead.integers(-1, 16).read_only())?
            .get();
        Ok(Self {
            max_age: number(
                "max_age",
                2.0,
                0.01,
                3600.0,
                "greatest age of the newest frame, by when it was received, at which a plan is made or sent [s]",
            )?,
            lead_steps: usize::try_from(lead).ok(),
            merging: chunk_merging::declare(node)?,
            search: node
                .declare("search", Vec::<String>::new(), search.read_only())?
                .get(),
            population: count("population", 32, 2, "candidates an iteration")?,
            iterations: count("iterations", 3, 1, "iterations a plan")?,
            elites: count(
                "elites",
                8,
                2,
                "candidates that the next iteration is fitted to",
            )?,
            horizon: count("horizon", 1, 1, "model steps of a plan")?,
            batch: count(
                "batch",
                16,
                1,
                "candidates rolled out at once; the deadline is looked at after each batch",
            )?,
            initial_std: number(
                "initial_std",
                0.25,
                1e-6,
                10.0,
                "first standard deviation, part of each range",
            )? as f32,
            std_floor: number(
                "std_floor",
                1e-4,
                1e-9,
                10.0,
                "least standard deviation [model units]",
            )? as f32,
            returned: node
                .declare("returned", "best_seen".to_owned(), returned)?
                .get(),
            context_frames: count(
                "context_frames",
                2,
                1,
                "observed frames that a plan starts from",
            )?
            .min(64),
            plan_period: number(
                "plan_period",
                2.0,
                0.0,
                3600.0,
                "least time between two plans for one goal [s]",
            )?,
            // Any 64 bits are a seed.
            seed: node.declare("seed", 0_i64, seed)?.get() as u64,
            integration_steps: count(
                "integration_steps",
                0,
                0,
                "Euler steps a frame; 0: what the model was trained for",
            )?,
            max_translation: limit(number(
                "max_translation",
                0.0,
                0.0,
                10.0,
                "bound of each translation in one model step [m]; 0: the model's own",
            )?),
            max_rotation: limit(number(
                "max_rotation",
                0.0,
                0.0,
                10.0,
                "bound of each rotation in one model step [rad]; 0: the model's own",
            )?),
            frame_period: number(
                "frame_period",
                0.2,
                1e-3,
                60.0,
                "time from one camera frame to the next [s]",
            )?,
            deadline: (deadline > 0.0).then(|| Duration::from_secs_f64(deadline)),
        })
    }

    /// Settings of the search.
    pub(super) fn cem(&self) -> Result<CemSettings> {
        let returned = match self.returned.as_str() {
            "best_seen" => Returned::BestSeen,
            "final_mean" => Returned::FinalMean,
            other => bail!("parameter returned is \"{other}\"; expected best_seen or final_mean"),
        };
        Ok(CemSettings {
            population: self.population,
            iterations: self.iterations,
            elites: self.elites,
            horizon: self.horizon,
            batch: self.batch,
            initial_std: self.initial_std,
            std_floor: self.std_floor,
            returned,
        })
    }

    /// Settings of the state.
    pub(super) fn settings(&self) -> PlannerSettings {
        PlannerSettings {
            // The descriptor keeps it within an hour.
            plan_period_ns: (self.plan_period * 1e9) as i64,
            max_age: Duration::from_secs_f64(self.max_age),
            lead: match self.lead_steps {
                Some(steps) => Lead::Steps(steps),
                None => Lead::Measured {
                    first: self.deadline.unwrap_or(FIRST_SEARCH),
                },
            },
            seed: self.seed,
        }
    }
}
