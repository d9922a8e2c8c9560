//! From a plan request to a plan.

use candle_core::{Device, Tensor};
use serde::Serialize;
use wm_model::{
    actions::{ActionEncoding, GRIPPER, PHYSICAL_DIM},
    planner::{Cem, CemSettings, PlannedActions, Target, TransitionDynamics},
};
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    std_msgs::Header,
    wm_msgs::{Action, Plan},
};

use super::{PlanRequest, PlannerError};
use crate::predictor::{PredictorModel, context_tensor, past_actions};

/// The name of the search, as in `Plan.planner`.
const PLANNER: &str = "cem";

/// The search and the model that it searches with.
#[derive(Clone, Debug)]
pub struct PlannerModel {
    model: PredictorModel,
    cem: Cem,
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
    model: &'a str,
    model_hash: &'a str,
}

impl PlannerModel {
    /// A planner over `model`, with at most `max_translation` \[m\] and `max_rotation` \[rad\] along each axis in one
    /// model step; infinity leaves them to the model's own bounds.
    ///
    /// # Errors
    /// [`PlannerError::Plan`] names a setting that cannot serve.
    pub fn new(
        model: PredictorModel,
        settings: CemSettings,
        integration_steps: usize,
        max_translation: f64,
        max_rotation: f64,
    ) -> Result<Self, PlannerError> {
        let bounds = bounds(&model.encoding, max_translation, max_rotation);
        let cem = Cem::new(settings, &bounds)?;
        let text = SettingsText {
            cem: cem.settings(),
            integration_steps,
            bounds: cem.bounds(),
            model: &model.name,
            model_hash: &model.hash,
        };
        // Plain numbers and texts always have a JSON form.
        let settings_json = serde_json::to_string(&text).unwrap_or_default();
        Ok(Self {
            model,
            cem,
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
        let PredictorModel {
            transition,
            space,
            encoding,
            ..
        } = &self.model;
        let context = context_tensor(&request.context, space)?;
        let past = past_actions(&request.context, encoding)?;
        let mut sampler = transition.config().sampler.clone();
        sampler.steps = self.integration_steps;
        let mut dynamics =
            TransitionDynamics::new(transition, &sampler, &context, past.as_ref(), request.seed)?;
        let goal = Tensor::from_slice(&request.goal.values, space.shape(), &Device::Cpu)?;
        let target = Target::LastStep(goal);
        // A plan of another horizon, from before a parameter changed, is no start.
        let start = request
            .start
            .as_deref()
            .filter(|start| start.len() == self.cem.settings().horizon);
        let found = self
            .cem
            .plan(&mut dynamics, &target, start, request.seed, out_of_time)?;
        let message = self.message(request, &found)?;
        Ok((found, message))
    }

    fn message(&self, request: &PlanRequest, found: &PlannedActions) -> Result<Plan, PlannerError> {
        let observed = request
            .context
            .frames
            .last()
            .ok_or(wm_model::Error::Shape {
                what: "the context",
                expected: "at least one frame".into(),
                found: vec![0],
            })?;
        let stamp_ns = observed.stamp_ns;
        let step_ns = request.timing.step_ns();
        // The frame of the deltas, as the robot names it.
        let base = request.base_frame.to_string();
        let actions = found.actions.iter().enumerate().map(|(index, action)| {
            let header = Header {
                // Horizons are a handful of steps.
                stamp: Time::from_nanos(stamp_ns + step_ns * index as i64),
                frame_id: base.clone(),
            };
            Ok(Action {
                header,
                values: self.model.encoding.decode_step(action)?.to_vec(),
            })
        });
        Ok(Plan {
            header: Header {
                stamp: Time::from_nanos(stamp_ns),
                frame_id: observed.frame_id.to_string(),
            },
            actions: actions.collect::<Result<_, PlannerError>>()?,
            period: Duration::from_nanos(step_ns),
            cost: found.cost,
            iteration_costs: found.iteration_costs.clone(),
            planner: PLANNER.into(),
            settings: self.settings_json.clone(),
            seed: request.seed,
            goal_stamp: request.goal.stamp,
            time_taken: Duration::default(),
            deadline_cut: found.deadline_cut,
        })
    }
}

/// The model's bounds, narrowed to the physical ones of a model step.
fn bounds(
    encoding: &ActionEncoding,
    max_translation: f64,
    max_rotation: f64,
) -> [(f32, f32); PHYSICAL_DIM] {
    // A model step repeats its scaled action in each of its camera frames.
    let per_frame = |max: f64, scale: f32| (max / encoding.frame_skip.max(1) as f64) as f32 * scale;
    let mut bounds = encoding.bounds();
    for (index, (low, high)) in bounds.iter_mut().enumerate() {
        let limit = match index {
            0..3 => per_frame(max_translation, encoding.translation_scale),
            GRIPPER => continue,
            _ => per_frame(max_rotation, encoding.rotation_scale),
        };
        (*low, *high) = (low.max(-limit), high.min(limit));
    }
    bounds
}
