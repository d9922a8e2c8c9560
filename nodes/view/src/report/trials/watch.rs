//! The state of a running episode.

use std::sync::Arc;

use image::RgbImage;
use wm_metrics::findings::{Episode, PlanTime};
use wm_msgs::wm_msgs::Plan;
use wm_sim::FRAME_PERIOD_NS;

use super::{Imagined, Shots};

/// An episode since the executor was armed.
#[derive(Clone, Debug)]
pub(crate) struct EpisodeWatch {
    seed: u64,
    /// The most steps of the simulator.
    most: usize,
    ticks: usize,
    is_done: bool,
    distance_m: f64,
    plans: Vec<PlanTime>,
    /// Of the newest plan: the planner's name and the duration of a step \[ns\].
    planner: Option<(String, i64)>,
    imagined: Imagined,
    shots: Shots,
}

impl EpisodeWatch {
    /// `most`: the most steps of the simulator.
    pub(crate) fn new(seed: u64, most: usize) -> Self {
        Self {
            seed,
            most,
            ticks: 0,
            is_done: false,
            distance_m: f64::NAN,
            plans: Vec::new(),
            planner: None,
            imagined: Imagined::default(),
            shots: Shots::default(),
        }
    }

    /// Whether the task is done or the time is up.
    pub(crate) fn is_over(&self) -> bool {
        self.is_done || self.ticks >= self.most
    }

    /// Takes the remaining distance after a step of the simulator \[m\].
    pub(crate) fn distance(&mut self, distance_m: f64) {
        if !self.is_over() {
            self.ticks += 1;
            self.distance_m = distance_m;
        }
    }

    /// Takes whether the task is done.
    pub(crate) fn success(&mut self, is_done: bool) {
        if !self.is_over() {
            self.is_done = is_done;
        }
    }

    /// Takes a plan.
    pub(crate) fn plan(&mut self, plan: &Plan) {
        self.plans.push(PlanTime {
            ms: plan.time_taken.to_nanos() as f64 / 1e6,
            // a count fits
            candidates: plan.candidates as usize,
        });
        self.planner = Some((plan.planner.clone(), plan.period.to_nanos()));
    }

    /// Takes a picture of the newest plan's outcome.
    pub(crate) fn outcome(&mut self, picture: RgbImage) {
        self.imagined.outcome = Some(Arc::new(picture));
    }

    /// Takes the newest plan's subgoals side by side.
    pub(crate) fn subgoals(&mut self, picture: RgbImage) {
        self.imagined.subgoals = Some(Arc::new(picture));
    }

    /// Takes a camera frame. `seen` decodes it if it is kept.
    pub(crate) fn frame(&mut self, stamp_ns: i64, seen: impl FnOnce() -> Option<RgbImage>) {
        self.shots.take(stamp_ns, seen, &self.imagined);
    }

    /// The planner's name after the first plan, and the duration of a model step \[ms\].
    pub(crate) fn planner(&self) -> Option<(&str, f64)> {
        let planner = self.planner.as_ref();
        planner.map(|(name, step_ns)| (name.as_str(), *step_ns as f64 / 1e6))
    }

    /// The episode, its plans and its pictures.
    pub(crate) fn finish(self) -> (Episode, Vec<PlanTime>, Shots) {
        let step_ns = self.planner.map_or(0, |(_, step_ns)| step_ns);
        // a model step has a few steps of the simulator
        let per_step = (step_ns as f64 / FRAME_PERIOD_NS as f64).round().max(1.0) as usize;
        let episode = Episode {
            seed: self.seed,
            success: self.is_done,
            steps: self.ticks.div_ceil(per_step),
            distance_m: self.distance_m,
        };
        (episode, self.plans, self.shots)
    }
}

#[cfg(test)]
mod tests {
    use wm_msgs::builtin_interfaces::Duration;

    use super::*;

    fn plan() -> Plan {
        Plan {
            time_taken: Duration::from_nanos(80_000_000),
            period: Duration::from_nanos(400_000_000),
            planner: "idm".into(),
            candidates: 1,
            ..Plan::default()
        }
    }

    #[test]
    fn episode_ends_with_its_task_or_its_time() {
        let mut watch = EpisodeWatch::new(7, 6);
        watch.success(false);
        for tick in 0..5 {
            watch.plan(&plan());
            watch.distance(0.1 / f64::from(tick + 1));
        }
        assert!(!watch.is_over());
        let mut done = watch.clone();
        done.success(true);
        assert!(done.is_over());
        // later events do not count
        done.success(false);
        done.distance(9.0);
        let (episode, plans, _) = done.finish();
        assert_eq!((episode.success, episode.steps, episode.seed), (true, 3, 7));
        assert!((episode.distance_m - 0.02).abs() < 1e-12);
        assert_eq!(plans.len(), 5);
        assert_eq!(
            plans[0],
            PlanTime {
                ms: 80.0,
                candidates: 1
            }
        );

        watch.distance(0.01);
        assert!(watch.is_over());
        assert_eq!(watch.planner(), Some(("idm", 400.0)));
        watch.success(true);
        assert!(!watch.finish().0.success, "too late");
    }
}
