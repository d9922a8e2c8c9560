//! From a plan request to a plan.

use candle_core::{Device, Tensor};
use serde::Serialize;
use wm_model::{
    planner::{Cem, CemSettings, Partial, PlannedActions, Target, TransitionDynamics},
    sampler::Given,
};
use wm_motion::actions::ActionEncoding;
use wm_msgs::{
    builtin_interfaces::Duration,
    std_msgs::Header,
    wm_msgs::{Action, Plan},
};

use super::{PlanRequest, PlannerError};
use wm_model::WorldModel;

use crate::history::stack;

/// The name of the search, as in `Plan.planner`.
const PLANNER: &str = "cem";

/// The search and the model that it searches with.
#[derive(Clone, Debug)]
pub struct PlannerModel {
    model: WorldModel,
    cem: Cem,
    /// Indices of the values that are searched.
    searched: Vec<usize>,
    integration_steps: usize,
    settings_json: String,
}

/// What `Plan.settings` holds.
#[derive(Serialize)]
struct SettingsText<'a> {
    #[serde(flatten)]
    cem: &'a CemSettings,
    integration_steps: usize,
    /// Least and greatest value of each coordinate in model units.
    bounds: &'a [(f32, f32)],
    /// Their dimensions.
    searched: &'a [&'a str],
    model: &'a str,
    model_hash: &'a str,
}

impl PlannerModel {
    /// A planner over `model` that searches the dimensions named by `searched` (none named: all but grippers), with at
    /// most `max_translation` \[m\] and `max_rotation` \[rad\] along each axis in one model step; infinity leaves them to
    /// the model's own bounds.
    ///
    /// # Errors
    /// [`PlannerError::Searched`] names a dimension that the model's actions do not have, [`PlannerError::Plan`] a
    /// setting that cannot serve.
    pub fn new(
        model: WorldModel,
        settings: CemSettings,
        searched: &[String],
        integration_steps: usize,
        max_translation: f64,
        max_rotation: f64,
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
        let (mut indices, mut names, mut bounds) = (Vec::new(), Vec::new(), Vec::new());
        for (index, (dimension, bound)) in space.dimensions().iter().zip(all).enumerate() {
            let is_searched = if searched.is_empty() {
                !dimension.kind.is_gripper()
            } else {
                searched.contains(&dimension.name)
            };
            if is_searched {
                indices.push(index);
                names.push(dimension.name.as_str());
                bounds.push(bound);
            }
        }
        let cem = Cem::new(settings, &bounds)?;
        let text = SettingsText {
            cem: cem.settings(),
            integration_steps,
            bounds: cem.bounds(),
            searched: &names,
            model: &model.name,
            model_hash: &model.hash,
        };
        let settings_json = serde_json::to_string(&text)?;
        Ok(Self {
            model,
            cem,
            searched: indices,
            integration_steps,
            settings_json,
        })
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
        let base = self.base(request);
        let mut dynamics = Partial::new(&mut dynamics, &base, &self.searched);
        let goal = Tensor::from_slice(&request.goal.values, space.shape(), &Device::Cpu)?;
        let target = Target::LastStep(goal);
        // A plan of another horizon, from before a parameter changed, is no start.
        let start = request
            .start
            .as_ref()
            .map(|start| start.actions.as_slice())
            .filter(|start| start.len() == self.cem.settings().horizon);
        let found = self
            .cem
            .plan(&mut dynamics, &target, start, request.seed, out_of_time)?;
        let actions = found
            .actions
            .iter()
            .map(|action| encoding.decode_step(&dynamics.whole(action)))
            .collect::<Result<Vec<_>, _>>()?;
        let message = self.message(request, &found, actions);
        Ok((found, message))
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
            .searched
            .iter()
            .filter_map(|index| dimensions.get(*index));
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
            planner: PLANNER.into(),
            settings: self.settings_json.clone(),
            seed: request.seed,
            goal_stamp: request.goal.stamp,
            time_taken: Duration::default(),
            deadline_cut: found.deadline_cut,
        }
    }
}

/// The model's bounds, narrowed to the physical ones of a model step.
fn bounds(encoding: &ActionEncoding, max_translation: f64, max_rotation: f64) -> Vec<(f32, f32)> {
    use wm_motion::actions::{Accumulation, Kind};
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
