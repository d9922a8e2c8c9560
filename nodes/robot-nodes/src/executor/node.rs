//! The executor's ROS interface.

use std::{sync::Arc, time::Instant};

use anyhow::Result;
use tracing::{error, info, warn};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    sensor_msgs::JointState,
    std_msgs::{Bool, Float64, Header},
    std_srvs::Outcome,
    trajectory_msgs::JointTrajectory,
    wm_msgs::{Action, Assessment, Plan},
};
use wm_ros::{
    Diagnostics, Level, Node, NodeDefinition, NodeProgram, Received, Setup, Subscription, answer,
    complaints::Complaints, frame_trace,
};

use crate::optional::next;

use super::{
    Cause, Command, ExecutorStep, Moment, Output, Refusal, Settings, Source, State, Status,
    StopSources, Taken,
    beat::Beat,
    message,
    outlets::{Endpoints, Inlets, Outlets, Request},
    parameters::Parameters,
    status::STATUS_PERIOD,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Executor>();

struct Executor {
    node: Node,
    step: ExecutorStep,
    beat: Beat,
    outlets: Outlets,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// The last published status, and when it was published.
    published: Option<(Status, Instant)>,
    /// Capture time of the frame whose command was traced last \[ns\].
    traced_ns: Option<i64>,
    /// Number of undecodable messages of the emergency stop.
    undecodable: u64,
}

impl NodeProgram for Executor {
    const NAME: &'static str = "executor";
    const ABOUT: &'static str = "Executes action chunks and plans on an arm, within limits.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = Settings;
    type Error = anyhow::Error;

    async fn load(node: &Node, parameters: &Arc<Parameters>) -> Result<Settings> {
        parameters.settings(node.clock().is_simulated())
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        let (node, parameters, settings) = (&at.node, &at.parameters, &at.resources);
        Ok(Self {
            node: node.clone(),
            step: ExecutorStep::new(settings.clone()),
            beat: Beat::new(
                parameters.is_clocked,
                settings.period,
                parameters.clock_timeout(settings.period),
                node.clock(),
            ),
            outlets: at.endpoints.outlets.clone(),
            complaints: Complaints::new(node.diagnostics()),
            diagnostics: node.diagnostics(),
            published: None,
            traced_ns: None,
            undecodable: 0,
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let name = at.node.fully_qualified_name();
        if at.parameters.arm_on_start {
            self.step.arm()?;
            warn!(
                "armed from the start (arm_on_start), which is for simulated arms only: what comes is executed at once; \
                 call {name}/stop to stop it"
            );
        } else {
            info!("not armed: call {name}/arm to execute");
        }
        let ended = self.execute(&mut at.endpoints).await;
        if let Err(error) = &ended {
            // Without a stop, the last command would hold until the arm's controller notices the silence.
            self.step.stop(&format!("the node ends: {error:#}"));
            let now = self.beat.now();
            self.act(now).ok();
            self.outlets.settle().await.ok();
        }
        ended
    }
}

/// Name of a caller that the graph does not contain.
const UNKNOWN_NODE: &str = "an unknown node";

impl Executor {
    async fn execute(&mut self, endpoints: &mut Endpoints) -> Result<()> {
        let Endpoints {
            inlets, requests, ..
        } = endpoints;
        let Inlets {
            chunks,
            plans,
            poses,
            joints,
            deadman,
            emergency,
            cameras,
            candidates,
            assessments,
            errors,
        } = inlets;
        let shutdown = self.node.shutdown();
        let mut is_ending = false;
        let mut graph = self.node.graph_changes();
        graph.mark_changed();
        loop {
            // Stops first. Commands before the inputs of later commands.
            tokio::select! {
                biased;
                Some(received) = emergency.recv() => self.emergency(&received)?,
                Ok(()) = graph.changed() => self.connect(emergency, deadman)?,
                Some(request) = requests.next_request() => self.obey(request)?,
                () = shutdown.wait(), if !is_ending => {
                    is_ending = true;
                    if self.beat.is_clock() {
                        // The clock may stand still forever.
                        self.step.stop("the node ends");
                        self.tick()?;
                        return self.outlets.settle().await;
                    }
                    self.step.disarm(Cause::Shutdown);
                }
                Some(received) = deadman.recv() => {
                    let moment = self.beat.of(&received);
                    self.step.deadman(received.message.data, moment.at);
                }
                Some(received) = cameras.recv() => {
                    let taken = self.step.camera(&received.message, self.beat.of(&received));
                    self.drop_malformed(taken);
                }
                Some(received) = poses.recv() => self.pose(&received.message, self.beat.of(&received)),
                Some(received) = next(joints) => self.joints(&received.message, self.beat.of(&received)),
                is_due = self.beat.tick() => {
                    if !is_due {
                        self.step.see_clock(self.beat.now());
                        continue;
                    }
                    self.expect_readable(emergency.undecodable());
                    if is_ending {
                        // A call may have armed it meanwhile.
                        self.step.disarm(Cause::Shutdown);
                    }
                    let is_moving = self.tick()?;
                    if is_ending && !is_moving {
                        return self.outlets.settle().await;
                    }
                }
                Some(received) = errors.recv() => self.step.prediction_error(&received.message),
                Some(received) = candidates.recv() => {
                    let taken = self.step.candidates(&received.message);
                    self.drop_malformed(taken);
                }
                Some(received) = assessments.recv() => self.assessment(&received.message),
                Some(received) = next(chunks) => {
                    let (moment, now) = (self.beat.of(&received), self.beat.now());
                    let taken = self.step.chunk(&received.message, moment, now);
                    self.take(Source::Chunk, taken);
                }
                Some(received) = next(plans) => {
                    let (moment, now) = (self.beat.of(&received), self.beat.now());
                    let taken = self.step.plan(&received.message, moment, now);
                    let is_accepted = matches!(taken, Ok(Taken::Accepted));
                    self.take(Source::Plan, taken);
                    if is_accepted {
                        self.announce(&received.message)?;
                    }
                }
            }
        }
    }

    fn header(&self, stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: self.step.frame_id().to_owned(),
        }
    }

    /// Publishes the command of this period and the status; returns whether the arm moves.
    fn tick(&mut self) -> Result<bool> {
        let now = self.beat.now();
        let is_moving = self.act(now)?;
        self.publish_status(now)?;
        Ok(is_moving)
    }

    /// Publishes the command of this period; returns whether the arm moves.
    fn act(&mut self, now: Moment) -> Result<bool> {
        let tick = self.step.tick(now);
        for refusal in &tick.refused {
            self.refuse(refusal, "");
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
                self.trace();
            }
        }
        Ok(is_moving)
    }

    /// Traces the first command of each offer.
    fn trace(&mut self) {
        let capture_ns = self.step.executed_capture_ns();
        if capture_ns == self.traced_ns {
            return;
        }
        self.traced_ns = capture_ns;
        if let Some(capture_ns) = capture_ns {
            frame_trace::passed("command published", Time::from_nanos(capture_ns));
        }
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
        // 64 bits of nanoseconds hold 292 years.
        let period_ns = i64::try_from(settings.period.as_nanos()).unwrap_or(i64::MAX);
        message::trajectory(self.step.frame_id().to_owned(), names, command, period_ns)
    }

    /// Publishes the status if it has changed, and at least every [`STATUS_PERIOD`].
    fn publish_status(&mut self, now: Moment) -> Result<()> {
        let status = self.step.status();
        if let Some((published, at)) = &self.published
            && *published == status
            && now.at.saturating_duration_since(*at) < STATUS_PERIOD
        {
            return Ok(());
        }
        self.log(&status);
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
        self.published = Some((status, now.at));
        Ok(())
    }

    /// Logs changes of the state, and the beginning of each hold.
    fn log(&self, status: &Status) {
        let before = self.published.as_ref().map(|(before, _)| before);
        let is_new_hold =
            status.hold.is_some() && before.and_then(|before| before.hold) != status.hold;
        if !is_new_hold && before.is_none_or(|before| before.state == status.state) {
            return;
        }
        let reason = match status.hold {
            Some(_) if !is_new_hold => String::new(),
            _ => self.spelled(&status.reason),
        };
        let text = format!("{}: {reason}", name(status.state));
        let text = text.trim_end_matches(": ");
        match status.state {
            State::Stopped => error!("{text}"),
            _ if is_new_hold => warn!("{text}"),
            _ => info!("{text}"),
        }
    }

    /// Publishes the workspace box, if a node subscribes.
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

    /// The text with this node's name in place of `~`.
    fn spelled(&self, text: &str) -> String {
        text.replace("~/", &format!("{}/", self.node.fully_qualified_name()))
    }

    /// Logs which node called a service of this node; returns the text.
    fn log_call(&self, client: &[u8; 16], service: &str) -> String {
        let node = self.node.node_of_client(client);
        let node = node.as_deref().unwrap_or(UNKNOWN_NODE);
        let text = format!("{node} called ~/{service}");
        info!("{}", self.spelled(&text));
        text
    }

    fn take(&mut self, source: Source, taken: Result<Taken, Refusal>) {
        if let Err(refusal) = taken {
            self.refuse(&refusal, &format!("{}: ", source.name()));
        }
        self.report_lateness();
    }

    /// Counts a refusal, and logs it. Holds and late sources are logged elsewhere, once for all refusals.
    fn refuse(&mut self, refusal: &Refusal, prefix: &str) {
        let reason = refusal.reason();
        let text = self.spelled(&format!("{prefix}{refusal}"));
        match refusal {
            Refusal::Held(_) => self.diagnostics.count_drop(reason),
            refusal if refusal.is_late() => {
                self.diagnostics.count_drop(reason);
                self.diagnostics.raise("lateness", Level::Warn, text);
            }
            _ => self.complaints.left_out(reason, &text),
        }
    }

    fn report_lateness(&mut self) {
        if let Some(notice) = self.step.take_late_notice() {
            let text = notice.to_string();
            warn!("{text}");
            self.diagnostics.raise("lateness", Level::Warn, text);
        }
    }

    fn drop_malformed(&mut self, taken: Result<(), Refusal>) {
        if let Err(malformed) = taken {
            self.complaints.left_out(malformed.reason(), &malformed);
        }
    }

    /// Updates the publishers that can stop the arm, after a change of the graph.
    fn connect(
        &mut self,
        emergency: &Subscription<Bool>,
        deadman: &Subscription<Bool>,
    ) -> Result<()> {
        let mut mismatches = emergency.mismatches();
        if self.step.settings().deadman.is_some() {
            mismatches.extend(deadman.mismatches());
        }
        self.step.stop_sources(StopSources {
            connected: emergency.matching_publishers(),
            mismatches,
        });
        let now = self.beat.now();
        self.publish_status(now)
    }

    /// Stops the arm after an undecodable message of the emergency stop, which may have been true.
    fn expect_readable(&mut self, undecodable: u64) {
        if undecodable > self.undecodable {
            self.undecodable = undecodable;
            self.step.stop("a message on emergency_stop is undecodable");
        }
    }

    /// Publishes an accepted plan for the predictor and the planner.
    fn announce(&self, plan: &Plan) -> Result<()> {
        let is_armed = self.step.status().state != State::DryRun;
        if let (Some(announcements), true) = (&self.outlets.announcements, is_armed) {
            announcements.publish(&message::chunk(plan))?;
        }
        Ok(())
    }

    fn assessment(&mut self, assessment: &Assessment) {
        let now = self.beat.now();
        for refusal in self.step.assessment(assessment, now) {
            self.refuse(&refusal, "");
        }
        self.report_lateness();
    }

    fn pose(&mut self, pose: &PoseStamped, received: Moment) {
        if let Err(problem) = self.step.pose(pose, received) {
            self.complaints.left_out(problem.reason(), &problem);
        }
    }

    fn joints(&mut self, joints: &JointState, received: Moment) {
        if let Err(problem) = self.step.joints(joints, received) {
            self.complaints.left_out(problem.reason(), &problem);
        }
    }

    fn emergency(&mut self, received: &Received<Bool>) -> Result<()> {
        let is_pressed = received.message.data;
        self.step.emergency(received.publisher, is_pressed);
        if is_pressed {
            // The arm does not wait for the next period.
            self.tick()?;
        }
        Ok(())
    }

    /// The response to a call. It also logs a refusal.
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

    fn obey(&mut self, request: Request) -> Result<()> {
        let now = self.beat.now();
        // The arm does not wait for the search of the graph for the caller.
        match request {
            Request::Arm(call) if call.request.data => {
                let armed = self.step.arm();
                self.log_call(&call.client(), "arm (true)");
                answer(call, &self.outcome(armed, "armed"));
            }
            Request::Arm(call) => {
                self.step.disarm(Cause::Disarmed);
                self.log_call(&call.client(), "arm (false)");
                answer(call, &self.outcome(Ok(()), "disarmed"));
            }
            Request::Stop(call) => {
                let is_first = self.step.stop(&format!("{UNKNOWN_NODE} called ~/stop"));
                self.act(now)?;
                let by = self.log_call(&call.client(), "stop");
                if is_first {
                    self.step.name_stopper(by);
                }
                answer(call, &self.outcome(Ok(()), "stopped"));
            }
            Request::Reset(call) => {
                let reset = self.step.reset();
                self.log_call(&call.client(), "reset");
                answer(call, &self.outcome(reset, "reset: not armed"));
            }
        }
        self.publish_status(now)
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
