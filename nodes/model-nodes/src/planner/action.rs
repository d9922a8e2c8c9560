//! A running goal of the planner's action.

use std::time::{Duration, Instant};

use anyhow::Result;
use wm_msgs::wm_msgs::{
    Goal as GoalMessage, Plan,
    action::{Plan as PlanAction, PlanFeedback, PlanGoal, PlanResult},
};
use wm_planner::Progress;
use wm_ros::{GoalId, ServerGoal};

/// The end of an action's goal.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// It succeeded.
    Succeeded {
        /// Whether the observed distance came down to the tolerance.
        reached: bool,
        /// Why.
        message: String,
    },
    /// It was aborted.
    Aborted(String),
    /// The client cancelled it.
    Canceled,
}

/// The course of an action's goal: its time limit and its result so far.
#[derive(Clone, Debug)]
pub struct Course {
    /// When it is over; `None`: with its first plan.
    until: Option<Instant>,
    tolerance: f32,
    plans: u32,
    last: Plan,
}

impl Course {
    /// The course of a goal that is accepted at `now`.
    ///
    /// # Errors
    /// `GoalError` names the invalid value.
    pub fn new(goal: &PlanGoal, now: Instant) -> Result<Self, String> {
        let duration = goal.duration.checked_nanos();
        let duration = duration.map_err(|error| format!("its duration is {error}"))?;
        let Ok(duration) = u64::try_from(duration) else {
            return Err("its duration is negative".to_owned());
        };
        if !(goal.tolerance.is_finite() && goal.tolerance >= 0.0) {
            let tolerance = goal.tolerance;
            return Err(format!("its tolerance is {tolerance}: expected 0 or more"));
        }
        let until = (duration > 0).then(|| now.checked_add(Duration::from_nanos(duration)));
        Ok(Self {
            until: until.flatten(),
            tolerance: goal.tolerance,
            plans: 0,
            last: Plan::default(),
        })
    }

    /// Whether its plans are for the executor.
    pub fn is_published(&self) -> bool {
        self.until.is_some()
    }

    /// When it is over, with a plan or without.
    pub fn until(&self) -> Option<Instant> {
        self.until
    }

    /// Takes a plan; how it ends, if it does with this one.
    pub fn planned(&mut self, plan: &Plan) -> Option<End> {
        self.plans = self.plans.saturating_add(1);
        self.last = plan.clone();
        if self.tolerance > 0.0 && plan.distance <= self.tolerance {
            let (distance, tolerance) = (plan.distance, self.tolerance);
            return Some(End::Succeeded {
                reached: true,
                message: format!("reached: the distance is {distance}, at most {tolerance}"),
            });
        }
        self.until.is_none().then(|| End::Succeeded {
            reached: false,
            message: "planned once".to_owned(),
        })
    }

    /// How it ends when its time is over.
    pub fn expired(&self) -> End {
        if self.tolerance > 0.0 {
            return End::Aborted(format!(
                "not reached in time: the distance is {}, not {} or less",
                self.last.distance, self.tolerance
            ));
        }
        End::Succeeded {
            reached: false,
            message: "its time is over".to_owned(),
        }
    }

    /// The feedback during a search.
    pub fn feedback(&self, progress: SearchProgress) -> PlanFeedback {
        PlanFeedback {
            plan: self.plans,
            distance: self.last.distance,
            ..progress.0
        }
    }

    /// The feedback after a search.
    pub fn summary(&self, plan: &Plan) -> PlanFeedback {
        // Counts of a search, far below 2^32.
        let iterations = u32::try_from(plan.iteration_costs.len()).unwrap_or(u32::MAX);
        PlanFeedback {
            plan: self.plans,
            iteration: iterations.saturating_sub(1),
            best_cost: plan.cost,
            terms: plan.terms.clone(),
            term_costs: plan.term_costs.clone(),
            spread_costs: plan.spread_costs.clone(),
            candidates: plan.candidates,
            distance: plan.distance,
        }
    }

    fn result(self, reached: bool, message: String) -> PlanResult {
        PlanResult {
            reached,
            plan: self.last,
            plans: self.plans,
            message,
        }
    }
}

/// The progress of a search.
#[derive(Clone, Debug)]
pub struct SearchProgress(PlanFeedback);

impl SearchProgress {
    /// The progress of a search with these `terms`; `None` before there is a best candidate.
    pub fn of(progress: &Progress<'_>, terms: &[&str]) -> Option<Self> {
        Some(Self(PlanFeedback {
            // Counts of a search, far below 2^32.
            iteration: u32::try_from(progress.iteration.saturating_sub(1)).unwrap_or(u32::MAX),
            best_cost: progress.best?,
            terms: terms.iter().map(|&term| term.to_owned()).collect(),
            term_costs: progress.terms.to_vec(),
            candidates: u32::try_from(progress.candidates).unwrap_or(u32::MAX),
            ..PlanFeedback::default()
        }))
    }

    /// The search's iteration.
    pub fn iteration(&self) -> u32 {
        self.0.iteration
    }
}

/// An action's goal and its course.
pub struct ActionRun {
    goal: ServerGoal<PlanAction>,
    /// Its course.
    pub course: Course,
}

impl ActionRun {
    /// A goal that was accepted.
    pub fn new(goal: ServerGoal<PlanAction>, course: Course) -> Self {
        Self { goal, course }
    }

    /// The goal's identity.
    pub fn id(&self) -> GoalId {
        self.goal.id()
    }

    /// The goal as it was received.
    pub fn message(&self) -> &GoalMessage {
        &self.goal.goal.goal
    }

    /// Publishes feedback for the client.
    ///
    /// # Errors
    /// The middleware failed.
    pub fn publish_feedback(&self, feedback: &PlanFeedback) -> Result<()> {
        Ok(self.goal.publish_feedback(feedback)?)
    }

    /// Ends it.
    ///
    /// # Errors
    /// The middleware failed.
    pub fn end(self, end: End) -> Result<()> {
        let Self { goal, course } = self;
        match end {
            End::Succeeded { reached, message } => goal.succeed(course.result(reached, message))?,
            End::Aborted(message) => goal.abort(course.result(false, message))?,
            End::Canceled => goal.cancel(course.result(false, "canceled".to_owned()))?,
        }
        Ok(())
    }

    /// Its end by the client or by its time limit; pending without a goal. Cancel safe.
    pub async fn over(run: Option<&Self>) -> End {
        let Some(run) = run else {
            return std::future::pending().await;
        };
        let expired = async {
            match run.course.until() {
                Some(until) => tokio::time::sleep_until(until.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = run.goal.canceling() => End::Canceled,
            () = expired => run.course.expired(),
        }
    }
}

#[cfg(test)]
mod tests {
    use wm_msgs::builtin_interfaces::Duration as RosDuration;

    use super::*;

    fn course(seconds: i64, tolerance: f32) -> Result<Course, String> {
        let goal = PlanGoal {
            duration: RosDuration::from_nanos(seconds * 1_000_000_000),
            tolerance,
            ..PlanGoal::default()
        };
        Course::new(&goal, Instant::now())
    }

    fn plan(distance: f32) -> Plan {
        Plan {
            distance,
            iteration_costs: vec![0.5, 0.25],
            cost: 0.25,
            ..Plan::default()
        }
    }

    #[test]
    fn without_a_duration_the_first_plan_is_the_result() {
        let mut once = course(0, 0.0).unwrap();
        assert!(!once.is_published() && once.until().is_none());
        let end = once.planned(&plan(0.3)).unwrap();
        assert!(
            matches!(end, End::Succeeded { reached: false, .. }),
            "{end:?}"
        );
        let result = once.result(false, String::new());
        assert_eq!((result.plans, result.plan.cost), (1, 0.25));
    }

    #[test]
    fn with_a_duration_it_goes_on_until_it_is_reached_or_over() {
        let mut going = course(5, 0.1).unwrap();
        assert!(going.is_published() && going.until().is_some());
        assert_eq!(going.planned(&plan(0.3)), None);
        let text = format!("{:?}", going.expired());
        assert!(
            text.contains("0.3") && text.starts_with("Aborted"),
            "{text}"
        );
        let end = going.planned(&plan(0.1)).unwrap();
        assert!(
            matches!(end, End::Succeeded { reached: true, .. }),
            "{end:?}"
        );
        // Without a tolerance there is nothing to reach.
        let mut untold = course(5, 0.0).unwrap();
        assert_eq!(untold.planned(&plan(0.0)), None);
        assert!(matches!(
            untold.expired(),
            End::Succeeded { reached: false, .. }
        ));
        // Words alone have no distance.
        assert_eq!(going.planned(&plan(f32::NAN)), None);
    }

    #[test]
    fn what_is_no_number_is_refused_by_name() {
        assert!(course(-1, 0.0).unwrap_err().contains("duration"));
        assert!(course(1, f32::NAN).unwrap_err().contains("tolerance"));
        assert!(course(1, -0.5).unwrap_err().contains("-0.5"));
    }

    #[test]
    fn feedback_numbers_plans_and_iterations_from_zero() {
        let mut course = course(5, 0.0).unwrap();
        course.planned(&plan(0.3));
        let progress = Progress {
            iteration: 2,
            candidates: 24,
            best: Some(0.5),
            terms: &[0.5],
            deviation: 0.0,
        };
        let heard = SearchProgress::of(&progress, &["goal"]).unwrap();
        let feedback = course.feedback(heard);
        assert_eq!(
            (feedback.plan, feedback.iteration, feedback.distance),
            (1, 1, 0.3)
        );
        let none = Progress {
            best: None,
            ..progress
        };
        assert!(SearchProgress::of(&none, &[]).is_none());
        let summary = course.summary(&plan(0.2));
        assert_eq!(
            (summary.plan, summary.iteration, summary.best_cost),
            (1, 1, 0.25)
        );
    }
}
