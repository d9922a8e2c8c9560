//! The adapter's ROS interface.

use std::{sync::Arc, time::Duration};

use anyhow::Result;
use tokio::time::MissedTickBehavior;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    std_msgs::{Float64, Header},
    wm_msgs::Action,
};
use wm_ros::{Node, NodeDefinition, NodeProgram, Setup, complaints::Complaints};
use wm_sim::message::pose as pose_message;

use super::{
    AdapterStep, Done, Problem, Settings,
    outlets::{Endpoints, Inlets, Outlets},
    parameters::Parameters,
};
use crate::optional::next;

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Adapter>();

/// Time from one check for a silent source to the next.
const LOOK: Duration = Duration::from_millis(50);

struct Adapter {
    step: AdapterStep,
    base_frame: String,
    /// Whether transforms are missing: the node then waits for them.
    is_lost: bool,
    outlets: Outlets,
    complaints: Complaints,
}

impl NodeProgram for Adapter {
    const NAME: &'static str = "action_adapter";
    const ABOUT: &'static str = "Makes actions of velocities, poses, transforms or joints, for arms that do not publish them.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = Settings;
    type Error = anyhow::Error;

    async fn load(_: &Node, parameters: &Arc<Parameters>) -> Result<Settings> {
        parameters.settings()
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        Ok(Self {
            step: AdapterStep::new(at.resources.clone()),
            base_frame: at.parameters.base_frame.clone(),
            is_lost: false,
            outlets: at.endpoints.outlets.clone(),
            complaints: Complaints::new(at.node.diagnostics()),
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let (clock, shutdown) = (at.node.clock(), at.node.shutdown());
        let Inlets {
            twists,
            poses,
            transforms,
            static_transforms,
            openings,
            joints,
        } = &mut at.endpoints.inlets;
        let mut jumps = clock.jumps();
        let mut looks = tokio::time::interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                () = shutdown.wait() => return Ok(()),
                Ok(()) = jumps.changed() => self.step.forget(),
                Some(received) = next(static_transforms) => {
                    let problems = self.step.transforms(&received.message, true);
                    self.report(&problems);
                }
                Some(received) = next(transforms) => {
                    let problems = self.step.transforms(&received.message, false);
                    self.report(&problems);
                    self.follow()?;
                }
                Some(received) = next(twists) => {
                    let taken = self.step.twist(&received.message, received.received.to_nanos());
                    self.taken(taken)?;
                }
                Some(received) = next(poses) => {
                    let taken = self.step.pose(&received.message, received.received.to_nanos());
                    self.taken(taken)?;
                }
                Some(received) = next(openings) => {
                    let taken = self.step.gripper(received.message.data, received.received.to_nanos());
                    self.taken(taken)?;
                }
                Some(received) = next(joints) => {
                    let taken = self.step.joints(&received.message, received.received.to_nanos());
                    self.opened(taken)?;
                }
                _ = looks.tick() => {
                    let is_silent = self.step.tick(clock.now().to_nanos());
                    self.publish()?;
                    if is_silent && !self.is_lost {
                        match self.step.missing_joint() {
                            Some(missing) => self.complaints.waiting("motion", true, &missing),
                            None => self.complaints.waiting("motion", true, &"motions of the arm"),
                        }
                    }
                }
            }
        }
    }
}

impl Adapter {
    fn header(&self, stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: self.base_frame.clone(),
        }
    }

    fn report(&mut self, problems: &[Problem]) {
        for problem in problems {
            self.complaints
                .left_out_many(problem.reason(), problem.count(), problem);
        }
    }

    fn taken(&mut self, taken: Result<(), Problem>) -> Result<()> {
        if let Err(problem) = taken {
            self.report(&[problem]);
        }
        self.publish()
    }

    fn opened(&mut self, taken: Result<Option<f64>, Problem>) -> Result<()> {
        if let (Ok(Some(opening)), Some(grippers)) = (&taken, &self.outlets.grippers) {
            grippers.publish(&Float64 { data: *opening })?;
        }
        self.taken(taken.map(drop))
    }

    fn follow(&mut self) -> Result<()> {
        let followed = self.step.follow();
        self.is_lost = followed.is_err();
        match followed {
            Ok(Some((stamp_ns, pose))) => {
                if let Some(states) = &self.outlets.states {
                    states.publish(&PoseStamped {
                        header: self.header(stamp_ns),
                        pose: pose_message(&pose),
                    })?;
                }
                self.publish()
            }
            Ok(None) => Ok(()),
            Err(unknown) => {
                self.complaints.waiting("transform", true, &unknown);
                Ok(())
            }
        }
    }

    /// Publishes the actions of the completed periods.
    fn publish(&mut self) -> Result<()> {
        for done in self.step.take_done() {
            match done {
                Ok(Done { stamp_ns, values }) => {
                    self.complaints.working("actions are published");
                    self.outlets.actions.publish(&Action {
                        header: self.header(stamp_ns),
                        values,
                    })?;
                }
                Err(problem) => self.report(&[problem]),
            }
        }
        Ok(())
    }
}
