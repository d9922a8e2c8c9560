//! The latents that a plan aims at.

use image::RgbImage;
use wm_model::LatentSpace;
use wm_msgs::wm_msgs::Latent;
use wm_planner::{Dynamics as _, Goals, Subgoals, TransitionDynamics, Waypoint, goals_by_time};
use wm_wire::latent_message::{LatentDtype, encode_latent};
use wm_zoo::subgoals::SubgoalSampling;

use super::{PlanRequest, PlannerError, PlannerModel};
use crate::evaluator::tile;

/// The latents that a plan is to be at, one a model step, and where along the goal's latents that begins.
pub(super) struct Course {
    pub goals: Goals,
    pub waypoint: Waypoint,
    /// Of the observation to the goal's last latent.
    pub distance: f32,
    /// Model steps from the observation to the goal's last latent, by the learnt distance, if there is one.
    pub steps_to_goal: Option<f32>,
    /// All latents of the goal; none for words alone.
    pub latents: Goals,
    /// Proposed latents on the way to the next goal, from where the plan begins.
    pub subgoals: Subgoals,
}

impl PlannerModel {
    /// The latents to reach from where `dynamics` begins.
    pub(super) fn course(
        &self,
        request: &PlanRequest,
        dynamics: &TransitionDynamics<'_>,
    ) -> Result<Course, PlannerError> {
        let space = &self.parts.model.space;
        let goal = &request.goal;
        let values: Vec<&[f32]> = goal.latents.iter().map(|latent| &**latent).collect();
        let latents = Goals::of_values(space, &values)?;
        if latents.is_empty() {
            return Ok(Course {
                goals: latents.clone(),
                waypoint: request.waypoint,
                distance: f32::NAN,
                steps_to_goal: None,
                latents,
                subgoals: Subgoals::default(),
            });
        }
        let observed = Goals::of_values(space, &[&request.moment.observed.values])?;
        let distance = latents.distance(&observed)?;
        let horizon = self.setup.horizon;
        let (mut goals, waypoint) = if goal.times_ns.is_empty() {
            let waypoint = request.waypoint.advance(
                request.passed_steps,
                latents.latents(),
                &dynamics.start()?,
                self.setup.arrival,
            )?;
            (latents.one_per_step(waypoint.index, horizon), waypoint)
        } else {
            let begin_ns = request.begin_ns().saturating_sub(request.goal_set_ns);
            let step_ns = request.moment.timing.step_ns();
            let indices = goals_by_time(&goal.times_ns, begin_ns, step_ns, horizon);
            let waypoint = Waypoint {
                // The first goal, if no step of the horizon has one.
                index: indices.first().copied().unwrap_or_default(),
                steps: 0.0,
            };
            (latents.at(&indices), waypoint)
        };
        let subgoals = self.propose(request, dynamics, &goals)?;
        if !subgoals.is_empty() {
            goals = subgoals.goals(horizon);
        }
        let steps_to_goal = match &self.parts.distance {
            Some(learnt) => Some(latents.steps_from(&observed, learnt)?),
            None => None,
        };
        Ok(Course {
            goals,
            waypoint,
            distance,
            steps_to_goal,
            latents,
            subgoals,
        })
    }

    /// Subgoals on the way to the first of `goals`: all of them, for `Plan.subgoals`.
    fn propose(
        &self,
        request: &PlanRequest,
        dynamics: &TransitionDynamics<'_>,
        goals: &Goals,
    ) -> Result<Subgoals, PlannerError> {
        let model = self.parts.subgoals.as_ref();
        let model = model.filter(|_| self.choice.needs_subgoals());
        let (Some(model), Some(goal)) = (model, goals.latents().first()) else {
            return Ok(Subgoals::default());
        };
        let sampling = SubgoalSampling::of(request.seed, self.setup.subgoal_steps);
        let way = (&dynamics.start()?, goal);
        Ok(Subgoals::propose(model, way, sampling)?)
    }

    /// The subgoals in one picture, nearest first; none without subgoals or a decoder.
    pub(super) fn subgoal_pictures(
        &self,
        course: &Course,
    ) -> Result<Option<RgbImage>, PlannerError> {
        let subgoals = course.subgoals.values()?;
        let pictures = subgoals.iter().map(|(_, values)| self.picture(values));
        let pictures = pictures.filter_map(Result::transpose);
        let row = pictures.collect::<Result<Vec<_>, _>>()?;
        Ok((!row.is_empty()).then(|| tile(&[row], None)))
    }
}

impl Course {
    /// The subgoals as `Plan.subgoals` and `Plan.subgoal_steps`, with the stamps of their times.
    pub(super) fn subgoal_messages(
        &self,
        space: &LatentSpace,
        request: &PlanRequest,
    ) -> Result<(Vec<Latent>, Vec<u32>), PlannerError> {
        let message = |(steps, values): (usize, Vec<f32>)| {
            let steps = request.lead_steps() + steps;
            let header = request.moment.header_after(steps);
            let message = encode_latent(&values, space, LatentDtype::F16, header)?;
            let message = Latent {
                epoch: request.moment.epoch,
                ..message
            };
            // Far below 2^32.
            Ok((message, u32::try_from(steps).unwrap_or(u32::MAX)))
        };
        let each = self.subgoals.values()?.into_iter().map(message);
        each.collect()
    }
}
