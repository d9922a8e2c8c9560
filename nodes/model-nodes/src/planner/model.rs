//! From a plan request to a plan.

mod course;
mod limits;

use std::{
    collections::BTreeMap,
    fmt,
    sync::{Arc, Mutex, PoisonError},
};

use image::RgbImage;
use serde::Serialize;
use wm_model::{Decoder, WorldModel};
use wm_motion::actions::ActionError;
use wm_msgs::{
    builtin_interfaces::Duration,
    std_msgs::Header,
    wm_msgs::{Action, Plan},
};
use wm_planner::{
    Coordinate, Goals, Objective, PlannedActions, PlannerChoice, PlannerSettings, Problem,
    Progress, SearchSpace, StepsToGoal, Success, TransitionDynamics, Waypoint, WorkerCounts,
    WorkerPool, WorkspaceMargin, spread,
};
use wm_zoo::{
    distance::TrainedDistance, idm::TrainedIdm, subgoals::TrainedSubgoals,
    success_probe::SuccessClassifier,
};

use super::{PlanRequest, PlannerError, PlannerSetup};
use crate::history::model_values;
use course::Course;

/// `Plan.steps_to_goal` without a learnt distance. Not NaN, which JSON cannot hold.
const NO_DISTANCE: f32 = -1.0;

/// What plans are made with.
#[derive(Clone)]
pub struct PlannerParts {
    /// The transition model and its spaces.
    pub model: WorldModel,
    /// For planners that begin from what it tells.
    pub idm: Option<Arc<TrainedIdm>>,
    /// For planners along subgoals.
    pub subgoals: Option<Arc<TrainedSubgoals>>,
    /// For the model steps that remain to a goal.
    pub distance: Option<Arc<TrainedDistance>>,
    /// For goals with words.
    pub probe: Option<Arc<SuccessClassifier>>,
    /// For pictures of what plans lead to.
    pub decoder: Option<Arc<Mutex<Box<dyn Decoder>>>>,
    /// Other processes that cost candidates too.
    pub workers: Option<Arc<dyn WorkerPool>>,
}

/// The search and the model that it searches with.
#[derive(Clone)]
pub struct PlannerModel {
    parts: PlannerParts,
    setup: PlannerSetup,
    choice: PlannerChoice,
    /// The values that are searched.
    coordinates: Vec<Coordinate>,
    integration_steps: usize,
    settings_json: String,
}

/// A plan.
#[derive(Clone, Debug)]
pub struct Planned {
    /// The planned actions, in model units.
    pub actions: PlannedActions,
    /// How far along the goal's latents the plan began.
    pub waypoint: Waypoint,
    /// Complete but for `time_taken`, which is the sender's to fill.
    pub message: Plan,
    /// What the camera would see after its last action, where that was asked for.
    pub outcome: Option<RgbImage>,
    /// A picture of the subgoals side by side, nearest first; `None` without subgoals or subscribers.
    pub subgoals: Option<RgbImage>,
}

impl fmt::Debug for PlannerModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlannerModel")
            .field("settings", &self.settings_json)
            .finish_non_exhaustive()
    }
}

/// What `Plan.settings` holds.
#[derive(Serialize)]
struct SettingsText<'a> {
    #[serde(flatten)]
    setup: &'a PlannerSetup,
    /// Those of the planner that is used.
    #[serde(flatten)]
    planner: BTreeMap<&'static str, serde_json::Value>,
    integration_steps: usize,
    /// Least and greatest value of each searched value in model units.
    bounds: Vec<(f32, f32)>,
    /// Their dimensions.
    searched: &'a [&'a str],
    model: &'a str,
    model_hash: &'a str,
}

impl PlannerModel {
    /// A planner. A gripper that is searched is open or closed, nothing between.
    ///
    /// # Errors
    /// [`PlannerError::Searched`] names a dimension that the model's actions do not have, [`PlannerError::Plan`] a
    /// setting that cannot serve, or that there is no inverse dynamics model.
    pub fn new(parts: PlannerParts, setup: PlannerSetup) -> Result<Self, PlannerError> {
        let model = &parts.model;
        let choice = setup.choice.unwrap_or(match parts.idm {
            Some(_) => PlannerChoice::IdmIcem,
            None => PlannerChoice::Icem,
        });
        let coordinates = limits::coordinates(&model.encoding, &setup.search, &setup.limits)?;
        // What cannot serve is found here, not at the first goal.
        let nowhere = vec![0.0; model.space.elements()];
        let nowhere = Goals::of_values(&model.space, &[&nowhere])?;
        if choice.needs_subgoals() {
            let subgoals = parts.subgoals.as_ref();
            let subgoals = subgoals.ok_or(PlannerError::NoSubgoals { planner: choice })?;
            let (expected, found) = (model.encoding.frame_skip(), subgoals.frame_skip());
            if found != expected {
                return Err(PlannerError::SubgoalSteps { expected, found });
            }
        }
        if setup.steps_to_goal > 0.0 && parts.distance.is_none() {
            return Err(PlannerError::NoDistance);
        }
        choice.build(&setup.settings, parts.idm.as_ref(), nowhere.latents())?;
        SearchSpace::new(vec![0.0; model.encoding.action_dim()], coordinates.clone())?;
        let integration_steps = setup
            .integration_steps
            .unwrap_or(model.transition.config().sampler.steps);
        let dimensions = model.encoding.space().dimensions();
        let named = coordinates
            .iter()
            .filter_map(|coordinate| dimensions.get(coordinate.index));
        let names: Vec<&str> = named.map(|dimension| dimension.name.as_str()).collect();
        let bounds = coordinates
            .iter()
            .map(|coordinate| coordinate.range.bounds());
        let text = SettingsText {
            setup: &setup,
            planner: used(choice, &setup.settings)?,
            integration_steps,
            bounds: bounds.collect(),
            searched: &names,
            model: &model.name,
            model_hash: &model.hash,
        };
        let settings_json = serde_json::to_string(&text)?;
        Ok(Self {
            parts,
            setup,
            choice,
            coordinates,
            integration_steps,
            settings_json,
        })
    }

    /// Which planner it is.
    pub fn choice(&self) -> PlannerChoice {
        self.choice
    }

    /// How its workers do; `None` where it has none.
    pub fn worker_counts(&self) -> Option<WorkerCounts> {
        self.parts.workers.as_ref().map(|pool| pool.counts())
    }

    /// Searches for the plan of a request; `watch` hears of every batch, with the names of the cost's terms, and ends the
    /// search by `true`.
    ///
    /// # Errors
    /// [`PlannerError`] where the request does not fit the model, or nothing finite is found.
    pub fn plan(
        &self,
        request: &PlanRequest,
        watch: &mut dyn FnMut(&Progress<'_>, &[&str]) -> bool,
    ) -> Result<Planned, PlannerError> {
        let mut dynamics = self.dynamics(request)?;
        let course = self.course(request, &dynamics)?;
        let space = self.space(request)?;
        let objective = self.objective(request, &course)?;
        let choice = match course.goals.is_empty() {
            // Words alone: there is no latent to ask the inverse dynamics model about.
            true => self.choice.unseeded().ok_or(PlannerError::NoLatent)?,
            false => self.choice,
        };
        let (settings, idm) = (&self.setup.settings, self.parts.idm.as_ref());
        let planner = choice.build(settings, idm, course.goals.latents())?;
        // A plan of another horizon, from before a parameter changed, is no start.
        let mut starts = request
            .start
            .as_ref()
            .map(PlannedActions::proposals)
            .unwrap_or_default();
        starts.retain(|start| start.len() == self.setup.horizon);
        let horizon = self.setup.horizon;
        let workers = self.parts.workers.as_ref();
        let mut workers =
            workers.and_then(|pool| pool.share(&dynamics, &objective, &space, horizon));
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon,
            batch: self.setup.batch,
            proposals: starts,
            workers: workers.as_deref_mut(),
        };
        let terms: Vec<&str> = objective.names().collect();
        let watch = &mut |progress: &Progress<'_>| watch(progress, &terms);
        let found = planner.plan(&mut problem, request.seed, watch)?;
        let outcome = match request.is_shown {
            true => self.picture(&problem.outcome(&found.actions)?)?,
            false => None,
        };
        let subgoal_pictures = match request.shows_subgoals {
            true => self.subgoal_pictures(&course)?,
            false => None,
        };
        // Other seeds than those of the plans to come.
        let seeds = (1..=self.setup.spread_seeds as u64).map(|index| !request.seed ^ index);
        let seeds: Vec<u64> = seeds.collect();
        let spread_costs = if seeds.is_empty() {
            Vec::new()
        } else {
            spread(&dynamics, &objective, &space, &found.actions, &seeds)?
        };
        let encoding = &self.parts.model.encoding;
        let period_ns = request.moment.timing.frame_period_ns;
        let actions = found.actions.iter().map(|action| {
            let mut values = encoding.decode_step(&space.whole(action))?;
            encoding.space().from_nominal(&mut values, period_ns);
            Ok::<_, ActionError>(values)
        });
        let actions = actions.collect::<Result<Vec<_>, _>>()?;
        let space = &self.parts.model.space;
        let (subgoals, subgoal_steps) = course.subgoal_messages(space, request)?;
        let message = Plan {
            planner: choice.to_string(),
            // At most as many as a goal may have.
            goal_index: course.waypoint.index as u32,
            distance: course.distance,
            steps_to_goal: course.steps_to_goal.unwrap_or(NO_DISTANCE),
            subgoals,
            subgoal_steps,
            terms: terms.iter().map(|&term| term.to_owned()).collect(),
            spread_costs,
            ..self.message(request, &found, actions)
        };
        Ok(Planned {
            actions: found,
            waypoint: course.waypoint,
            message,
            outcome,
            subgoals: subgoal_pictures,
        })
    }

    /// What comes of actions from where the plan begins.
    fn dynamics(&self, request: &PlanRequest) -> Result<TransitionDynamics<'_>, PlannerError> {
        let model = &self.parts.model;
        let mut sampler = model.transition.config().sampler.clone();
        sampler.steps = self.integration_steps;
        let moment = &request.moment;
        let mut rollout = moment.rollout(&model.transition, &sampler, request.seed)?;
        // What happens while the search goes on, so that the plan starts where the robot will be.
        for pair in request.until.windows(2) {
            let [action, next] = pair else { continue };
            rollout.predict(&[model_values(action)], Some(&[model_values(next)]))?;
        }
        Ok(TransitionDynamics::after(rollout)?)
    }

    /// What may be chosen.
    fn space(&self, request: &PlanRequest) -> Result<SearchSpace, PlannerError> {
        let mut space = SearchSpace::new(self.base(request), self.coordinates.clone())?;
        if let Some((_, [.., before])) = request.until.split_last() {
            // The action that the robot takes as the plan begins is the one that it replaces.
            space = space.after(&before.model.values)?;
        }
        if let (Some(limits), Some(position)) = (self.setup.limits.workspace, request.position) {
            let encoding = &self.parts.model.encoding;
            let workspace = limits::workspace(encoding, &self.coordinates, &limits, position);
            space = space.within(workspace)?;
        }
        Ok(space)
    }

    fn objective(&self, request: &PlanRequest, course: &Course) -> Result<Objective, PlannerError> {
        let (weights, mask) = (&self.setup.weights, request.goal.mask.as_deref());
        let mut objective = weights.objective(course.goals.latents(), mask)?;
        if let (Some(distance), Some(goal)) =
            (&self.parts.distance, course.latents.latents().last())
        {
            let steps = StepsToGoal::new(Arc::clone(distance), goal.clone());
            objective = objective.and(self.setup.steps_to_goal, steps);
        }
        if let (Some(probe), Some(instruction)) = (&self.parts.probe, &request.goal.instruction) {
            let observed = self.parts.model.space.stack(&request.moment.context())?;
            let success = Success::new(Arc::clone(probe), (**instruction).clone(), observed);
            objective = objective.and(self.setup.success, success);
        }
        if let Some(limits) = self.setup.limits.workspace {
            let margin = limits.margin;
            objective = objective.and(limits.weight, WorkspaceMargin { margin });
        }
        Ok(objective)
    }

    /// The picture of `latent`; none without a decoder.
    fn picture(&self, latent: &[f32]) -> Result<Option<RgbImage>, PlannerError> {
        let Some(decoder) = &self.parts.decoder else {
            return Ok(None);
        };
        let decoder = decoder.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Some(decoder.picture(latent)?))
    }

    /// Values of dimensions that are not searched: deltas and velocities are zero, states hold.
    fn base(&self, request: &PlanRequest) -> Vec<f32> {
        let encoding = &self.parts.model.encoding;
        let mut base = match request.until.last() {
            Some(last) => last.model.values.clone(),
            None => vec![0.0; encoding.action_dim()],
        };
        for (value, dimension) in base.iter_mut().zip(encoding.space().dimensions()) {
            if dimension.kind.is_motion() {
                *value = 0.0;
            }
        }
        base
    }

    fn message(
        &self,
        request: &PlanRequest,
        found: &PlannedActions,
        actions: Vec<Vec<f32>>,
    ) -> Plan {
        let moment = &request.moment;
        let lead_steps = request.lead_steps();
        let dimensions = self.parts.model.encoding.space().dimensions();
        let named = self
            .coordinates
            .iter()
            .filter_map(|coordinate| dimensions.get(coordinate.index));
        let actions = actions
            .into_iter()
            .enumerate()
            .map(|(index, values)| Action {
                header: Header {
                    // The frame of the deltas, as the robot names it.
                    frame_id: moment.base_frame.to_string(),
                    ..moment.header_after(lead_steps + index)
                },
                values,
            });
        Plan {
            header: moment.header_after(0),
            actions: actions.collect(),
            period: moment.step_period(),
            searched: named.map(|dimension| dimension.name.clone()).collect(),
            // At most MOST_LEAD.
            lead_steps: lead_steps as u32,
            epoch: moment.epoch,
            cost: found.cost,
            iteration_costs: found.iteration_costs.clone(),
            term_costs: found.terms.clone(),
            settings: self.settings_json.clone(),
            seed: request.seed,
            goal_stamp: request.goal.stamp,
            time_taken: Duration::default(),
            deadline_cut: found.deadline_cut,
            // Far below 2^32.
            candidates: u32::try_from(found.candidates).unwrap_or(u32::MAX),
            ..Plan::default()
        }
    }
}

/// Settings of what a planner consists of, by name.
fn used(
    choice: PlannerChoice,
    settings: &PlannerSettings,
) -> serde_json::Result<BTreeMap<&'static str, serde_json::Value>> {
    let mut used = BTreeMap::new();
    if choice.needs_idm() {
        used.insert("idm", serde_json::to_value(&settings.idm)?);
    }
    match choice {
        PlannerChoice::Idm | PlannerChoice::SubgoalsIdm => None,
        PlannerChoice::Cem | PlannerChoice::IdmCem => {
            used.insert("cem", serde_json::to_value(&settings.cem)?)
        }
        PlannerChoice::Icem | PlannerChoice::IdmIcem | PlannerChoice::SubgoalsIcem => {
            used.insert("icem", serde_json::to_value(&settings.icem)?)
        }
        PlannerChoice::Mppi | PlannerChoice::IdmMppi => {
            used.insert("mppi", serde_json::to_value(&settings.mppi)?)
        }
    };
    Ok(used)
}
