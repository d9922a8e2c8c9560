//! The adapter on the wire.

use std::{process::ExitCode, time::Duration};

use anyhow::Result;
use tokio::time::MissedTickBehavior;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    std_msgs::{Float64, Header},
    wm_msgs::Action,
};
use wm_ros::{
    Component, EndpointSet as _, NAMESPACE, Node, NodeArgs, NodeDefinition, ParameterSet as _,
    Publisher, complaints::Complaints,
};

use super::{AdapterStep, Done, Problem, outlets::Endpoints, parameters::Parameters};
use wm_sim::message::pose as pose_message;

use crate::optional::next;

const NAME: &str = "action_adapter";

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: NAME,
    about: "Makes actions of velocities, poses or transforms, for arms that do not publish them.",
    parameters: Parameters::specs,
    endpoints: Endpoints::specs,
    is_managed: false,
    run,
    component: Some(|| Component::new(NAME, body)),
};

/// How often it looks whether its source is silent.
const LOOK: Duration = Duration::from_millis(50);

fn run(args: &NodeArgs) -> Result<ExitCode> {
    args.expect_no_rest()?;
    wm_ros::run(NAME, NAMESPACE, args, body).map(|()| ExitCode::SUCCESS)
}

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// Parameters contradict each other, or the graph fails.
pub async fn body(node: Node) -> Result<()> {
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let step = AdapterStep::new(parameters.settings()?);
    let Endpoints {
        mut twists,
        mut poses,
        mut transforms,
        mut static_transforms,
        mut openings,
        mut joints,
        actions,
        states,
        grippers,
    } = Endpoints::make(&node)?;
    node.seal_endpoints()?;
    let mut adapter = Adapter {
        step,
        base_frame: parameters.base_frame.clone(),
        is_lost: false,
        actions,
        states,
        grippers,
        complaints: Complaints::new(node.diagnostics()),
    };
    let (clock, shutdown) = (node.clock(), node.shutdown());
    let mut jumps = clock.jumps();
    let mut looks = tokio::time::interval(LOOK);
    looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            () = shutdown.wait() => return Ok(()),
            Ok(()) = jumps.changed() => adapter.step.forget(),
            Some(received) = next(&mut static_transforms) => {
                let problems = adapter.step.transforms(&received.message, true);
                adapter.left_out(&problems);
            }
            Some(received) = next(&mut transforms) => {
                let problems = adapter.step.transforms(&received.message, false);
                adapter.left_out(&problems);
                adapter.follow()?;
            }
            Some(received) = next(&mut twists) => {
                let taken = adapter.step.twist(&received.message, received.received.to_nanos());
                adapter.taken(taken)?;
            }
            Some(received) = next(&mut poses) => {
                let taken = adapter.step.pose(&received.message, received.received.to_nanos());
                adapter.taken(taken)?;
            }
            Some(received) = next(&mut openings) => {
                let taken = adapter.step.gripper(received.message.data, received.received.to_nanos());
                adapter.taken(taken)?;
            }
            Some(received) = next(&mut joints) => {
                let taken = adapter.step.joints(&received.message, received.received.to_nanos());
                adapter.opened(taken)?;
            }
            _ = looks.tick() => {
                let is_silent = adapter.step.tick(clock.now().to_nanos());
                adapter.publish()?;
                if is_silent && !adapter.is_lost {
                    adapter.complaints.waiting("motion", true, &"motions of the arm");
                }
            }
        }
    }
}

struct Adapter {
    step: AdapterStep,
    base_frame: String,
    /// Whether transforms are missing, which then is what it waits for.
    is_lost: bool,
    actions: Publisher<Action>,
    states: Option<Publisher<PoseStamped>>,
    grippers: Option<Publisher<Float64>>,
    complaints: Complaints,
}

impl Adapter {
    fn header(&self, stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: self.base_frame.clone(),
        }
    }

    fn left_out(&mut self, problems: &[Problem]) {
        for problem in problems {
            self.complaints
                .left_out_many(problem.reason(), problem.count(), problem);
        }
    }

    fn taken(&mut self, taken: Result<(), Problem>) -> Result<()> {
        if let Err(problem) = taken {
            self.left_out(&[problem]);
        }
        self.publish()
    }

    fn opened(&mut self, taken: Result<Option<f64>, Problem>) -> Result<()> {
        if let (Ok(Some(opening)), Some(grippers)) = (&taken, &self.grippers) {
            grippers.publish(&Float64 { data: *opening })?;
        }
        self.taken(taken.map(drop))
    }

    fn follow(&mut self) -> Result<()> {
        let followed = self.step.follow();
        self.is_lost = followed.is_err();
        match followed {
            Ok(Some((stamp_ns, pose))) => {
                if let Some(states) = &self.states {
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

    /// Publishes the actions of the periods that are over.
    fn publish(&mut self) -> Result<()> {
        for done in self.step.take_done() {
            match done {
                Ok(Done { stamp_ns, values }) => {
                    self.complaints.working("actions are published");
                    self.actions.publish(&Action {
                        header: self.header(stamp_ns),
                        values,
                    })?;
                }
                Err(problem) => self.left_out(&[problem]),
            }
        }
        Ok(())
    }
}
