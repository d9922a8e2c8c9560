//! From a plan request to a plan.

use std::{collections::BTreeMap, fmt, sync::Arc};

use candle_core::{DType, Device, Tensor};
use serde::Serialize;
use wm_model::{WorldModel, sampler::Given};
use wm_motion::actions::{ActionEncoding, Kind};
use wm_msgs::{
    builtin_interfaces::Duration,
    std_msgs::Header,
    wm_msgs::{Action, Plan},
};
use wm_planner::{
    ActionSize, Coordinate, GoalDistance, Objective, PlannedActions, PlannerChoice,
    PlannerSettings, Problem, Range, SearchSpace, Smoothness, Target, TransitionDynamics, spread,
};
use wm_zoo::idm::TrainedIdm;

use super::{PlanRequest, PlannerError, PlannerSetup};
use crate::history::stack;

/// The search and the model that it searches with.
#[derive(Clone)]
pub struct PlannerModel {
    model: WorldModel,
    idm: Option<Arc<TrainedIdm>>,
    setup: PlannerSetup,
    choice: PlannerChoice,
    /// The values that are searched.
    coordinates: Vec<Coordinate>,
    integration_steps: usize,
    settings_json: String,
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
    /// A planner over `model` that searches the dimensions named by `searched` (none named: all but grippers), with at
    /// most `max_translation` \[m\] and `max_rotation` \[rad\] along each axis in one model step; infinity leaves them to
    /// the model's own bounds. A gripper that is searched is open or closed, nothing between.
    ///
    /// # Errors
    /// [`PlannerError::Searched`] names a dimension that the model's actions do not have, [`PlannerError::Plan`] a
    /// setting that cannot serve, or that there is no inverse dynamics model.
    pub fn new(
        model: WorldModel,
        idm: Option<TrainedIdm>,
        setup: PlannerSetup,
        searched: &[String],
        integration_steps: usize,
        (max_translation, max_rotation): (f64, f64),
    ) -> Result<Self, PlannerError> {
        let space = model.encoding.space();
        if let Some(unknown) = searched
            .iter()
            .find(|name| space.dimensions().iter().all(|known| known.name != **name))
        {
            return Err(PlannerError::Searched {
                name: unknown.clone(),
                space: space.to_string(),
            });
        }
        let all = bounds(&model.encoding, max_translation, max_rotation);
        let (mut coordinates, mut names) = (Vec::new(), Vec::new());
        for (index, (dimension, (low, high))) in space.dimensions().iter().zip(all).enumerate() {
            let is_searched = if searched.is_empty() {
                !dimension.kind.is_gripper()
            } else {
                searched.contains(&dimension.name)
            };
            if is_searched {
                let range = match dimension.kind {
                    Kind::GripperBinary => Range::Either(-1.0, 1.0),
                    _ => Range::Between(low, high),
                };
                coordinates.push(Coordinate {
                    index,
                    range,
                    rate: f32::INFINITY,
                });
                names.push(dimension.name.as_str());
            }
        }
        let idm = idm.map(Arc::new);
        let choice = setup.choice.unwrap_or(match idm {
            Some(_) => PlannerChoice::IdmIcem,
            None => PlannerChoice::Icem,
        });
        // What cannot serve is found here, not at the first goal.
        let nowhere = Tensor::zeros(model.space.shape(), DType::F32, &Device::Cpu)?;
        choice.build(&setup.settings, idm.as_ref(), &[nowhere])?;
        SearchSpace::new(vec![0.0; model.encoding.action_dim()], coordinates.clone())?;
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
            model,
            idm,
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

    /// Searches for the plan of a request, until `out_of_time`. The message is complete but for `time_taken`, which is
    /// the sender's to fill.
    ///
    /// # Errors
    /// [`PlannerError`] where the request does not fit the model, or nothing finite is found.
    pub fn plan(
        &self,
        request: &PlanRequest,
        out_of_time: &mut dyn FnMut() -> bool,
    ) -> Result<(PlannedActions, Plan), PlannerError> {
        let WorldModel {
            transition,
            space,
            encoding,
            ..
        } = &self.model;
        let mut sampler = transition.config().sampler.clone();
        sampler.steps = self.integration_steps;
        let mut rollout = request
            .moment
            .rollout(transition, space, &sampler, request.seed)?;
        // What happens while the search goes on, so that the plan starts where the robot will be.
        for pair in request.until.windows(2) {
            let [action, next] = pair else { continue };
            let (fed, own) = (
                stack(std::slice::from_ref(action))?,
                stack(std::slice::from_ref(next))?,
            );
            if let Some(fed) = fed {
                let given = Given {
                    own_action: own.as_ref(),
                    ..Given::default()
                };
                rollout.next_given(&fed, given)?;
            }
        }
        let mut dynamics = TransitionDynamics::after(rollout)?;
        let searched = SearchSpace::new(self.base(request), self.coordinates.clone())?;
        let searched = match request.until.split_last() {
            // The action that the robot takes as the plan begins is the one that it replaces.
            Some((_, [.., before])) => searched.after(&before.model.values)?,
            _ => searched,
        };
        let goal = Tensor::from_slice(&request.goal.values, space.shape(), &Device::Cpu)?;
        let objective = self.objective(&goal);
        let planner = self
            .choice
            .build(&self.setup.settings, self.idm.as_ref(), &[goal])?;
        // A plan of another horizon, from before a parameter changed, is no start.
        let start = request
            .start
            .as_ref()
            .map(|start| &start.actions)
            .filter(|start| start.len() == self.setup.horizon);
        let mut problem = Problem {
            space: &searched,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon: self.setup.horizon,
            batch: self.setup.batch,
            proposals: start.into_iter().cloned().collect(),
        };
        let found = planner.plan(&mut problem, request.seed, &mut |_| out_of_time())?;
        // Other seeds than those of the plans to come.
        let seeds = (1..=self.setup.spread_seeds as u64).map(|index| !request.seed ^ index);
        let seeds: Vec<u64> = seeds.collect();
        let spread_costs = if seeds.is_empty() {
            Vec::new()
        } else {
            spread(&dynamics, &objective, &searched, &found.actions, &seeds)?
        };
        let actions = found
            .actions
            .iter()
            .map(|action| encoding.decode_step(&searched.whole(action)))
            .collect::<Result<Vec<_>, _>>()?;
        let message = Plan {
            terms: objective.names().map(str::to_owned).collect(),
            term_costs: found.terms.clone(),
            spread_costs,
            ..self.message(request, &found, actions)
        };
        Ok((found, message))
    }

    fn objective(&self, goal: &Tensor) -> Objective {
        let weights = self.setup.weights;
        let last = GoalDistance::new(Target::LastStep(goal.clone()));
        let path = GoalDistance::new(Target::AllSteps(goal.clone())).named("path");
        Objective::default()
            .and(weights.goal, last)
            .and(weights.path, path)
            .and(weights.action, ActionSize)
            .and(weights.smoothness, Smoothness)
    }

    /// What dimensions do that are not searched: deltas nothing, and states hold.
    fn base(&self, request: &PlanRequest) -> Vec<f32> {
        let encoding = &self.model.encoding;
        let mut base = match request.until.last() {
            Some(last) => last.model.values.clone(),
            None => vec![0.0; encoding.action_dim()],
        };
        for (value, dimension) in base.iter_mut().zip(encoding.space().dimensions()) {
            if dimension.kind.is_delta() {
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
        let dimensions = self.model.encoding.space().dimensions();
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
            planner: self.choice.to_string(),
            settings: self.settings_json.clone(),
            seed: request.seed,
            goal_stamp: request.goal.stamp,
            time_taken: Duration::default(),
            deadline_cut: found.deadline_cut,
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
        PlannerChoice::Idm => None,
        PlannerChoice::Cem | PlannerChoice::IdmCem => {
            used.insert("cem", serde_json::to_value(&settings.cem)?)
        }
        PlannerChoice::Icem | PlannerChoice::IdmIcem => {
            used.insert("icem", serde_json::to_value(&settings.icem)?)
        }
        PlannerChoice::Mppi | PlannerChoice::IdmMppi => {
            used.insert("mppi", serde_json::to_value(&settings.mppi)?)
        }
    };
    Ok(used)
}

/// The model's bounds, narrowed to the physical ones of a model step.
fn bounds(encoding: &ActionEncoding, max_translation: f64, max_rotation: f64) -> Vec<(f32, f32)> {
    use wm_motion::actions::Accumulation;
    // But for the sum, a model step repeats its scaled delta in each of its intervals.
    let intervals = match encoding.accumulation() {
        Accumulation::Sum => 1,
        _ => encoding.frame_skip(),
    };
    let bounds = encoding.bounds().into_iter();
    let narrowed = bounds
        .zip(encoding.space().dimensions())
        .map(|((low, high), dimension)| {
            let max = match dimension.kind {
                Kind::TranslationDelta => max_translation,
                Kind::RotationDelta => max_rotation,
                _ => f64::INFINITY,
            };
            let limit = (max / intervals as f64) as f32 * dimension.scale.abs();
            (low.max(-limit), high.min(limit))
        });
    narrowed.collect()
}
