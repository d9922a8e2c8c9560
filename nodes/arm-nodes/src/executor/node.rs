//! The executor on the wire.

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::Result;
use tracing::{error, info, warn};
use wm_msgs::{
    Message,
    builtin_interfaces::Time,
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    std_msgs::{Bool, Float64, Float64MultiArray, Header},
    std_srvs::{Outcome, SetBool, Trigger},
    trajectory_msgs::JointTrajectory,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Plan, PredictionError,
    },
};
use wm_ros::{
    Call, Component, Diagnostics, EndpointSet as _, Error, Level, NAMESPACE, Node, NodeArgs,
    NodeDefinition, ParameterSet as _, Publisher, Qos, Service, Subscription,
    calls::{Calls, answer},
    complaints::Complaints,
};

use crate::hear::next;

use super::{
    Cause, Command, ExecutorStep, Now, Output, Refusal, Source, State, Status, Taken, beat::Beat,
    message, parameters::Parameters,
};

const NAME: &str = "executor";

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: NAME,
    about: "Executes action chunks and plans on an arm, within limits.",
    parameters: Parameters::specs,
    endpoints: Endpoints::specs,
    is_managed: false,
    run,
    component: Some(|| Component::new(NAME, body)),
};

/// Only the newest command counts.
const COMMANDS: Qos = Qos::reliable(1);

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// A policy's next actions, unless source is plan.
        chunks: Option<Subscription<ActionChunk>> = "action_chunk", made(|node, name, qos| {
            heard(node, name, qos, "chunk")
        });
        /// A planner's plans, unless source is chunk.
        plans: Option<Subscription<Plan>> = "plan", made(|node, name, qos| heard(node, name, qos, "plan"));
        /// Where the end effector is, for the workspace box.
        poses: Subscription<PoseStamped> = "ee_pose", qos(Qos::best_effort(1));
        /// Where the joints are, with command_type joint_trajectory.
        joints: Option<Subscription<JointState>> = "joint_states", qos(Qos::best_effort(10)), made(|node, name, qos| {
            is_chosen(node, "joint_trajectory")?
                .then(|| node.subscription(name, qos))
                .transpose()
        });
        /// True while a person allows motion, with require_deadman.
        deadman: Subscription<Bool> = "deadman", qos(Qos::best_effort(1));
        /// True: emergency stop. Volatile or latched.
        emergency: Subscription<Bool> = "emergency_stop", made(|node, name, qos| {
            node.subscription_catching_up(name, qos)
        });
        /// The chunks that a policy chooses from, to which assessments refer.
        candidates: Subscription<ActionCandidates> = "action_candidates";
        /// What the model predicts of them, for the veto.
        assessments: Subscription<Assessment> = "assessment";
        /// What predictions were worth, for the veto.
        errors: Subscription<PredictionError> = "prediction_error", qos(Qos::best_effort(16));
        /// Velocities in the robot's base frame, with command_type twist.
        twists: Option<Publisher<TwistStamped>> = "command/twist", qos(COMMANDS), made(|node, name, qos| {
            chosen(node, name, qos, "twist")
        });
        /// The same as vx, vy, vz [m/s], wx, wy, wz [rad/s], with command_type velocity.
        velocities: Option<Publisher<Float64MultiArray>> = "command/velocity", qos(COMMANDS), made(|node, name, qos| {
            chosen(node, name, qos, "velocity")
        });
        /// The motion of each command period, with command_type action.
        motions: Option<Publisher<Action>> = "command/action", qos(COMMANDS), made(|node, name, qos| {
            chosen(node, name, qos, "action")
        });
        /// Where the joints are to be at the end of each command period, one point, with command_type joint_trajectory.
        trajectories: Option<Publisher<JointTrajectory>> = "command/joint_trajectory", qos(COMMANDS), made(|node, name, qos| {
            chosen(node, name, qos, "joint_trajectory")
        });
        /// The gripper's opening, 0 closed to 1 open.
        gripper: Publisher<Float64> = "command/gripper", qos(COMMANDS);
        /// While not armed: the velocities that would be sent.
        previews: Option<Publisher<TwistStamped>> = "~/command_preview", qos(COMMANDS), made(|node, name, qos| {
            let is_wanted = !is_chosen(node, "joint_trajectory")?;
            is_wanted.then(|| node.publisher(name, qos)).transpose()
        });
        /// The same of joints.
        joint_previews: Option<Publisher<JointTrajectory>> = "~/joint_trajectory_preview", qos(COMMANDS),
            made(|node, name, qos| chosen(node, name, qos, "joint_trajectory"));
        /// What was done in each command period, with publish_action.
        actions: Option<Publisher<Action>> = "action", made(|node, name, qos| {
            let is_wanted: bool = node.parameter("publish_action")?;
            is_wanted.then(|| node.publisher(name, qos)).transpose()
        });
        /// What is going to be done, with announce_plans.
        announcements: Option<Publisher<ActionChunk>> = "action_chunk", made(|node, name, qos| {
            let is_wanted: bool = node.parameter("announce_plans")?;
            is_wanted.then(|| node.publisher(name, qos)).transpose()
        });
        /// The workspace box (ns workspace), where there is one. Sent with the status, while somebody subscribes.
        shapes: Option<Publisher<MarkerArray>> = "markers", qos(Qos::reliable(4)), made(|node, name, qos| {
            let corner: Vec<f64> = node.parameter("workspace_min")?;
            (!corner.is_empty()).then(|| node.publisher(name, qos)).transpose()
        });
        /// What the node does, and why.
        status: Publisher<ExecutorStatus> = "~/status", qos(Qos::latched(1));
        /// Arms the node (true), or decelerates and disarms it (false).
        arm: Service<SetBool> = "~/arm";
        /// Emergency stop: zero velocity at once, until ~/reset and ~/arm.
        stop: Service<Trigger> = "~/stop";
        /// Ends an emergency stop and forgets everything; the node is not armed.
        reset: Service<Trigger> = "~/reset";
    }
}

/// The publisher of a kind of command, where it is the one that is chosen.
fn chosen<M: Message>(
    node: &Node,
    name: &str,
    qos: Qos,
    command_type: &str,
) -> Result<Option<Publisher<M>>, Error> {
    is_chosen(node, command_type)?
        .then(|| node.publisher(name, qos))
        .transpose()
}

fn is_chosen(node: &Node, command_type: &str) -> Result<bool, Error> {
    let wanted: String = node.parameter("command_type")?;
    Ok(wanted == command_type)
}

/// The subscription to offers of a kind, where they are executed.
fn heard<M: Message>(
    node: &Node,
    name: &str,
    qos: Qos,
    source: &str,
) -> Result<Option<Subscription<M>>, Error> {
    let wanted: String = node.parameter("source")?;
    (wanted == source || wanted == "both")
        .then(|| node.subscription(name, qos))
        .transpose()
}

/// A call.
enum Request {
    Arm(Call<SetBool>),
    Stop(Call<Trigger>),
    Reset(Call<Trigger>),
}

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
    let settings = parameters.settings()?;
    let Endpoints {
        mut chunks,
        mut plans,
        mut poses,
        mut joints,
        mut deadman,
        mut emergency,
        mut candidates,
        mut assessments,
        mut errors,
        twists,
        velocities,
        motions,
        trajectories,
        gripper,
        previews,
        joint_previews,
        actions,
        announcements,
        shapes,
        status,
        arm,
        stop,
        reset,
    } = Endpoints::make(&node)?;
    node.seal_endpoints()?;
    let mut calls = Calls::default();
    calls.add(arm, Request::Arm);
    calls.add(stop, Request::Stop);
    calls.add(reset, Request::Reset);
    let mut beat = Beat::new(parameters.is_clocked, settings.period, node.clock());
    let mut executor = Executor {
        step: ExecutorStep::new(settings),
        complaints: Complaints::new(node.diagnostics()),
        diagnostics: node.diagnostics(),
        outlets: Outlets {
            twists,
            velocities,
            motions,
            trajectories,
            gripper,
            previews,
            joint_previews,
            actions,
            announcements,
            shapes,
            status,
        },
        told: None,
        node: node.clone(),
    };
    let name = node.fully_qualified_name();
    if parameters.arm_on_start {
        executor.step.arm()?;
        warn!(
            "armed from the start (arm_on_start), which is for simulated arms only: what comes is executed at once; \
             call {name}/stop to stop it"
        );
    } else {
        info!("not armed: call {name}/arm to execute");
    }
    let shutdown = node.shutdown();
    let mut is_ending = false;
    loop {
        // What stops the arm goes first; commands go before what leads to further ones.
        tokio::select! {
            biased;
            Some(received) = emergency.recv() => executor.emergency(received.message.data, beat.now())?,
            call = calls.next() => executor.obey(call, beat.now())?,
            () = shutdown.wait(), if !is_ending => {
                is_ending = true;
                if beat.is_clock() {
                    // Its clock may stand still for ever.
                    executor.step.stop("the node ends");
                    executor.tick(beat.now())?;
                    return executor.outlets.settle().await;
                }
                executor.step.disarm(Cause::Shutdown);
            }
            Some(received) = deadman.recv() => executor.step.deadman(received.message.data, beat.of(&received)),
            Some(received) = poses.recv() => executor.pose(&received.message, beat.of(&received)),
            Some(received) = next(&mut joints) => executor.joints(&received.message, beat.of(&received)),
            () = beat.tick() => {
                let is_moving = executor.tick(beat.now())?;
                if is_ending && !is_moving {
                    return executor.outlets.settle().await;
                }
            }
            Some(received) = errors.recv() => executor.step.prediction_error(&received.message),
            Some(received) = candidates.recv() => executor.step.candidates(&received.message),
            Some(received) = assessments.recv() => executor.assessment(&received.message, beat.now()),
            Some(received) = next(&mut chunks) => {
                let taken = executor.step.chunk(&received.message, beat.of(&received), beat.now());
                executor.take(Source::Chunk, taken);
            }
            Some(received) = next(&mut plans) => {
                let taken = executor.step.plan(&received.message, beat.of(&received), beat.now());
                let is_accepted = matches!(taken, Ok(Taken::Accepted));
                executor.take(Source::Plan, taken);
                if is_accepted {
                    executor.announce(&received.message)?;
                }
            }
        }
    }
}

/// Where commands go.
struct Outlets {
    twists: Option<Publisher<TwistStamped>>,
    velocities: Option<Publisher<Float64MultiArray>>,
    motions: Option<Publisher<Action>>,
    trajectories: Option<Publisher<JointTrajectory>>,
    gripper: Publisher<Float64>,
    previews: Option<Publisher<TwistStamped>>,
    joint_previews: Option<Publisher<JointTrajectory>>,
    actions: Option<Publisher<Action>>,
    announcements: Option<Publisher<ActionChunk>>,
    shapes: Option<Publisher<MarkerArray>>,
    status: Publisher<ExecutorStatus>,
}

impl Outlets {
    /// Waits, but not for long, until the last command has arrived: a node that is gone sends nothing again.
    async fn settle(&self) -> Result<()> {
        if let Some(twists) = &self.twists {
            twists.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(velocities) = &self.velocities {
            velocities.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(motions) = &self.motions {
            motions.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(trajectories) = &self.trajectories {
            trajectories.wait_for_acknowledgments(FAREWELL).await?;
        }
        Ok(())
    }
}

struct Executor {
    node: Node,
    step: ExecutorStep,
    outlets: Outlets,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// The status that was sent last, and when.
    told: Option<(Status, Instant)>,
}

/// The status goes out at least this often.
pub(super) const STATUS_PERIOD: Duration = Duration::from_secs(1);
/// Who calls where the graph does not tell.
const SOMEBODY: &str = "somebody";
/// How long the last command may take to arrive: less than a process has to end after a signal.
const FAREWELL: Duration = Duration::from_millis(300);

impl Executor {
    fn header(&self, stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: self.step.frame_id().to_owned(),
        }
    }

    /// Sends the command of this period, and tells of it; whether the arm moves.
    fn tick(&mut self, now: Now) -> Result<bool> {
        let is_moving = self.act(now)?;
        self.tell(now)?;
        Ok(is_moving)
    }

    /// Sends the command of this period; whether the arm moves.
    fn act(&mut self, now: Now) -> Result<bool> {
        let tick = self.step.tick(now);
        for refusal in &tick.refused {
            let text = self.spelled(&refusal.to_string());
            self.complaints.left_out(refusal.reason(), &text);
        }
        let header = self.header(now.stamp_ns);
        let mut is_moving = false;
        match tick.output {
            Output::Silent => {}
            Output::Preview(command) => {
                if let Some(previews) = &self.outlets.previews {
                    previews.publish(&message::twist(header, command.velocity.velocity()))?;
                }
                if let Some(previews) = &self.outlets.joint_previews {
                    previews.publish(&self.trajectory(&command))?;
                }
            }
            Output::Send(command) => {
                is_moving = !command.velocity.is_zero();
                self.send(&header, command)?;
            }
        }
        Ok(is_moving)
    }

    fn send(&self, header: &Header, command: Command) -> Result<()> {
        let outlets = &self.outlets;
        if let Some(twists) = &outlets.twists {
            twists.publish(&message::twist(header.clone(), command.velocity.velocity()))?;
        }
        if let Some(velocities) = &outlets.velocities {
            velocities.publish(&message::array(command.velocity.velocity()))?;
        }
        if let Some(trajectories) = &outlets.trajectories {
            trajectories.publish(&self.trajectory(&command))?;
        }
        let settings = self.step.settings();
        let action = || Action {
            header: header.clone(),
            values: settings.layout.action(
                command.velocity,
                command.gripper,
                settings.period.as_secs_f64(),
                command
                    .places
                    .as_ref()
                    .map_or(&[], |places| places.as_slice()),
            ),
        };
        if let Some(motions) = &outlets.motions {
            motions.publish(&action())?;
        }
        if let Some(data) = command.gripper {
            outlets.gripper.publish(&Float64 { data })?;
        }
        if let Some(actions) = &outlets.actions {
            actions.publish(&action())?;
        }
        Ok(())
    }

    fn trajectory(&self, command: &Command) -> JointTrajectory {
        let settings = self.step.settings();
        let names = settings
            .joints
            .as_ref()
            .map_or(&[][..], |joints| joints.names());
        let period_ns = i64::try_from(settings.period.as_nanos()).unwrap_or(i64::MAX);
        message::trajectory(self.step.frame_id().to_owned(), names, command, period_ns)
    }

    /// Publishes the status where it has changed, or some time has passed.
    fn tell(&mut self, now: Now) -> Result<()> {
        let status = self.step.status();
        if let Some((told, at)) = &self.told {
            let is_new = *told != status;
            if !is_new && now.at.saturating_duration_since(*at) < STATUS_PERIOD {
                return Ok(());
            }
            if told.state != status.state {
                let text = format!("{}: {}", name(status.state), self.spelled(&status.reason));
                match status.state {
                    State::Stopped => error!("{text}"),
                    _ => info!("{}", text.trim_end_matches(": ")),
                }
            }
        }
        let level = match status.state {
            State::Stopped => Level::Error,
            State::Stopping => Level::Warn,
            State::DryRun | State::Idle | State::Executing => Level::Ok,
        };
        let reason = self.spelled(&status.reason);
        let text = match reason.as_str() {
            "" => name(status.state).to_owned(),
            reason => format!("{}: {reason}", name(status.state)),
        };
        self.diagnostics.set_status(level, text);
        let mut message = message::status(self.header(now.stamp_ns), &status);
        message.reason = reason;
        self.outlets.status.publish(&message)?;
        self.draw(message.header)?;
        self.told = Some((status, now.at));
        Ok(())
    }

    /// Draws the workspace box, where somebody looks.
    fn draw(&self, header: Header) -> Result<()> {
        let workspace = self.step.settings().workspace.as_ref();
        let shapes = self.outlets.shapes.as_ref();
        if let (Some(workspace), Some(shapes)) = (workspace, shapes)
            && shapes.subscribers() > 0
        {
            shapes.publish(&message::workspace(header, workspace.corners()))?;
        }
        Ok(())
    }

    /// Names of this node's own, in full: who reads a log or a page does not know whose `~` is.
    fn spelled(&self, text: &str) -> String {
        text.replace("~/", &format!("{}/", self.node.fully_qualified_name()))
    }

    /// Logs who called a service of this node, as far as the graph tells; gives the same text.
    fn log_call(&self, participant: [u8; 12], service: &str) -> String {
        let node = self.node.node_of(participant);
        let text = format!("{} called ~/{service}", node.as_deref().unwrap_or(SOMEBODY));
        info!("{}", self.spelled(&text));
        text
    }

    fn take(&mut self, source: Source, taken: Result<Taken, Refusal>) {
        if let Err(refusal) = taken {
            let text = self.spelled(&format!("{}: {refusal}", source.name()));
            self.complaints.left_out(refusal.reason(), &text);
        }
    }

    /// Tells others of a plan that is going to be done.
    fn announce(&self, plan: &Plan) -> Result<()> {
        let is_armed = self.step.status().state != State::DryRun;
        if let (Some(announcements), true) = (&self.outlets.announcements, is_armed) {
            announcements.publish(&message::chunk(plan))?;
        }
        Ok(())
    }

    fn assessment(&mut self, assessment: &Assessment, now: Now) {
        for refusal in self.step.assessment(assessment, now) {
            self.complaints.left_out(refusal.reason(), &refusal);
        }
    }

    fn pose(&mut self, pose: &PoseStamped, at: Instant) {
        if let Err(problem) = self.step.pose(pose, at) {
            self.complaints.left_out(problem.reason(), &problem);
        }
    }

    fn joints(&mut self, joints: &JointState, at: Instant) {
        if let Err(problem) = self.step.joints(joints, at) {
            self.complaints.left_out(problem.reason(), &problem);
        }
    }

    fn emergency(&mut self, is_pressed: bool, now: Now) -> Result<()> {
        self.step.emergency(is_pressed);
        if is_pressed {
            // The arm does not wait for the next period.
            self.tick(now)?;
        }
        Ok(())
    }

    /// The answer to a call; why it is refused is in the log too.
    fn outcome(&self, done: Result<(), super::ArmError>, what: &str) -> Outcome {
        let message = match &done {
            Ok(()) => what.to_owned(),
            Err(refused) => {
                let message = self.spelled(&refused.to_string());
                warn!("{message}");
                message
            }
        };
        Outcome {
            success: done.is_ok(),
            message,
        }
    }

    fn obey(&mut self, request: Request, now: Now) -> Result<()> {
        // Each is obeyed before the graph is searched for who called: an arm does not wait for that.
        match request {
            Request::Arm(call) if call.request.data => {
                let armed = self.step.arm();
                self.log_call(call.participant(), "arm (true)");
                answer(call, &self.outcome(armed, "armed"));
            }
            Request::Arm(call) => {
                self.step.disarm(Cause::Disarmed);
                self.log_call(call.participant(), "arm (false)");
                answer(call, &self.outcome(Ok(()), "disarmed"));
            }
            Request::Stop(call) => {
                let is_first = self.step.stop(&format!("{SOMEBODY} called ~/stop"));
                self.act(now)?;
                let by = self.log_call(call.participant(), "stop");
                if is_first {
                    self.step.name_stopper(by);
                }
                answer(call, &self.outcome(Ok(()), "stopped"));
            }
            Request::Reset(call) => {
                let reset = self.step.reset();
                self.log_call(call.participant(), "reset");
                answer(call, &self.outcome(reset, "reset: not armed"));
            }
        }
        self.tell(now)
    }
}

fn name(state: State) -> &'static str {
    match state {
        State::DryRun => "dry run",
        State::Idle => "idle",
        State::Executing => "executing",
        State::Stopping => "stopping",
        State::Stopped => "stopped",
    }
}
