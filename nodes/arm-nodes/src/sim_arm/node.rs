//! The simulated arm on the wire.

use std::{fmt::Display, process::ExitCode, time::Duration};

use anyhow::Result;
use tracing::info;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    std_msgs::{Bool, Float64, Float64MultiArray, String as Text},
    wm_msgs::{Action, Goal, Reset, ResetResponse},
};
use wm_ros::{
    Call, Component, Diagnostics, EndpointSet as _, Level, NAMESPACE, Node, NodeArgs,
    NodeDefinition, ParameterSet as _, Publisher, Qos, Subscription,
    calls::{Calls, answer},
    complaints::Complaints,
};
use wm_sim::{FRAME_PERIOD_NS, INSTRUCTION_TOPIC, SUCCESS_TOPIC};
use wm_wire::transport::{ImagePublisher, Pictures, Transports};

use super::{CommandError, Frame, SimArmStep, Tick, message, parameters::Parameters};

const NAME: &str = "sim_arm";

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: NAME,
    about: "A live simulated arm with a camera and a task, in place of a real one.",
    parameters: Parameters::specs,
    endpoints: Endpoints::specs,
    is_managed: false,
    run,
    component: Some(|| Component::new(NAME, body)),
};

/// Time of one step. 0.2 s fits.
const STEP_NS: i64 = FRAME_PERIOD_NS as i64;
/// How long the last messages may take to arrive.
const FAREWELL: Duration = Duration::from_millis(300);

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// Velocities of the tool in the base frame. The newest one counts.
        twists: Subscription<TwistStamped> = "command/twist", qos(Qos::best_effort(1));
        /// The same as vx, vy, vz [m/s], wx, wy, wz [rad/s].
        velocities: Subscription<Float64MultiArray> = "command/velocity", qos(Qos::best_effort(1));
        /// Motions, each to be done once. What comes within a step adds up.
        motions: Subscription<Action> = "command/action", qos(Qos::reliable(100));
        /// The gripper's opening, 0 closed to 1 open.
        openings: Subscription<Float64> = "command/gripper";
        /// What the camera sees, 256 by 256, after each step.
        pictures: ImagePublisher = "/camera/image_raw";
        /// What it would see once the task is done.
        goals: ImagePublisher = "goal/image", qos(Qos::latched(1));
        /// The same as a goal of one or several pictures, as goal_period has it.
        ways: Publisher<Goal> = "goal", qos(Qos::latched(1));
        /// The task in words.
        instructions: Publisher<Text> = INSTRUCTION_TOPIC, qos(Qos::latched(1));
        /// Whether the task is done: at the start, after a reset, and when that changes.
        successes: Publisher<Bool> = SUCCESS_TOPIC, qos(Qos::latched(1));
        /// Where the tool is.
        poses: Publisher<PoseStamped> = "ee_pose";
        /// How far the gripper is open, 0 closed to 1 open.
        grippers: Publisher<Float64> = "gripper";
        /// The arm's joints and fingers [rad, m].
        joints: Publisher<JointState> = "joint_states";
        /// What was done in each step, with publish_action; its stamp is that of the picture before.
        actions: Option<Publisher<Action>> = "action", made(|node, name, qos| {
            let is_wanted: bool = node.parameter("publish_action")?;
            is_wanted.then(|| node.publisher(name, qos)).transpose()
        });
        /// What is missing to the goal [m].
        distances: Publisher<Float64> = "~/distance";
        /// Begins the task anew, with the seed and the parameter task.
        reset: wm_ros::Service<Reset> = "~/reset";
    }
}

fn run(args: &NodeArgs) -> Result<ExitCode> {
    args.expect_no_rest()?;
    wm_ros::run(NAME, NAMESPACE, args, body).map(|()| ExitCode::SUCCESS)
}

/// Computes off the message loop: a table takes seconds to lay, a picture milliseconds to draw.
async fn off_the_loop<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T> {
    Ok(tokio::task::spawn_blocking(work).await?)
}

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// The seed has no such task, or the graph fails.
pub async fn body(node: Node) -> Result<()> {
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let settings = parameters.settings();
    let base_frame = settings.base_frame.clone();
    let mut step = off_the_loop(move || SimArmStep::new(settings)).await??;
    let Endpoints {
        mut twists,
        mut velocities,
        mut motions,
        mut openings,
        pictures,
        goals,
        ways,
        instructions,
        successes,
        poses,
        grippers,
        joints,
        actions,
        distances,
        reset,
    } = Endpoints::make(&node)?;
    node.seal_endpoints()?;
    let mut calls = Calls::default();
    calls.add(reset, |call| call);
    let mut arm = SimArm {
        outlets: Outlets {
            pictures,
            goals,
            ways,
            instructions,
            successes,
            poses,
            grippers,
            joints,
            actions,
            distances,
        },
        transports: parameters.image_transport,
        base_frame,
        complaints: Complaints::new(node.diagnostics()),
        diagnostics: node.diagnostics(),
    };
    let (clock, shutdown) = (node.clock(), node.shutdown());
    arm.announce(&step, clock.now())?;
    let mut jumps = clock.jumps();
    // A simulated clock stands at zero before it is heard of.
    tokio::select! {
        () = clock.sleep_until(Time::from_nanos(1)) => {}
        () = shutdown.wait() => return Ok(()),
    }
    let mut next_ns = clock.now().to_nanos();
    loop {
        let wake_ns = step.next_frame_ns().unwrap_or(next_ns).min(next_ns);
        tokio::select! {
            () = shutdown.wait() => return arm.outlets.settle().await,
            Ok(()) = jumps.changed() => {
                next_ns = clock.now().to_nanos();
                arm.forget(&mut step);
            }
            call = calls.next() => {
                let (task, seed) = (parameters.task(), seed(&call, &step));
                let done;
                (step, done) = off_the_loop(move || {
                    let done = step.reset(task, seed);
                    (step, done)
                }).await?;
                arm.answer(call, done, &step, clock.now())?;
                next_ns = clock.now().to_nanos();
            }
            Some(received) = twists.recv() => {
                arm.take("twist", step.twist(&received.message, received.received.to_nanos()));
            }
            Some(received) = velocities.recv() => {
                arm.take("velocity", step.velocity(&received.message, received.received.to_nanos()));
            }
            Some(received) = motions.recv() => {
                arm.take("action", step.action(&received.message, received.received.to_nanos()));
            }
            Some(received) = openings.recv() => arm.take("gripper", step.gripper(&received.message)),
            () = clock.sleep_until(Time::from_nanos(wake_ns)) => {
                let now_ns = clock.now().to_nanos();
                if now_ns < next_ns {
                    let frames = step.frames(now_ns);
                    arm.show(&frames)?;
                    continue;
                }
                let transports = arm.transports;
                let (tick, pictures);
                (step, tick, pictures) = off_the_loop(move || {
                    let tick = step.tick(now_ns);
                    let pictures = drawn(&tick.frames, transports);
                    (step, tick, pictures)
                }).await?;
                arm.publish(&tick, &pictures?)?;
                arm.status(&step, &tick);
                next_ns = next_ns.saturating_add(STEP_NS);
                let late_ns = clock.now().to_nanos().saturating_sub(next_ns);
                if late_ns > 0 {
                    // Not made up for: a clock that is behind would leave no time for commands.
                    let missed = late_ns / STEP_NS + 1;
                    arm.late(missed);
                    next_ns = next_ns.saturating_add(missed.saturating_mul(STEP_NS));
                }
            }
        }
    }
}

/// The seed that a call asks for.
fn seed(call: &Call<Reset>, step: &SimArmStep) -> u64 {
    match call.request.keep_seed {
        true => step.settings().seed,
        false => call.request.seed,
    }
}

fn drawn(frames: &[Frame], transports: Transports) -> Result<Vec<Pictures>> {
    let drawn = |frame: &Frame| message::pictures(&frame.picture, frame.stamp_ns, transports);
    frames.iter().map(drawn).collect()
}

/// Where what the arm tells goes.
struct Outlets {
    pictures: ImagePublisher,
    goals: ImagePublisher,
    ways: Publisher<Goal>,
    instructions: Publisher<Text>,
    successes: Publisher<Bool>,
    poses: Publisher<PoseStamped>,
    grippers: Publisher<Float64>,
    joints: Publisher<JointState>,
    actions: Option<Publisher<Action>>,
    distances: Publisher<Float64>,
}

impl Outlets {
    /// Waits, but not for long, until the outcome has arrived: a recorder writes it down last.
    async fn settle(&self) -> Result<()> {
        self.successes.wait_for_acknowledgments(FAREWELL).await?;
        Ok(())
    }
}

struct SimArm {
    outlets: Outlets,
    transports: Transports,
    base_frame: String,
    complaints: Complaints,
    diagnostics: Diagnostics,
}

impl SimArm {
    /// Says what is to be done.
    fn announce(&self, step: &SimArmStep, now: Time) -> Result<()> {
        let settings = step.settings();
        info!(
            "{} with seed {}: {}",
            settings.task,
            settings.seed,
            step.instruction()
        );
        let goal = message::pictures(step.goal_picture(), now.to_nanos(), self.transports)?;
        self.outlets.goals.publish(&goal)?;
        let way = message::goal(step.goals(), now.to_nanos());
        self.outlets.ways.publish(&way)?;
        let data = step.instruction().to_owned();
        self.outlets.instructions.publish(&Text { data })?;
        Ok(())
    }

    fn publish(&mut self, tick: &Tick, drawn: &[Pictures]) -> Result<()> {
        let outlets = &self.outlets;
        if let (Some(actions), Some(done)) = (&outlets.actions, &tick.done) {
            actions.publish(&message::action(done, &self.base_frame))?;
        }
        outlets
            .poses
            .publish(&message::pose(tick, &self.base_frame))?;
        outlets.grippers.publish(&Float64 { data: tick.opening })?;
        if let Some(positions) = tick.joints {
            let joints = message::joints(positions, tick.stamp_ns);
            outlets.joints.publish(&joints)?;
        }
        let data = tick.distance_m;
        outlets.distances.publish(&Float64 { data })?;
        if let Some(data) = tick.success {
            outlets.successes.publish(&Bool { data })?;
            if data {
                info!("the task is done");
            }
        }
        for pictures in drawn {
            outlets.pictures.publish(pictures)?;
        }
        if let Some(problem) = &tick.problem {
            self.complaints.left_out(problem.reason(), problem);
        }
        if tick.is_picture_lost {
            // As the parameter drop has it: no reason to complain.
            self.diagnostics.count_drop("picture_lost");
        }
        Ok(())
    }

    fn show(&self, frames: &[Frame]) -> Result<()> {
        for pictures in drawn(frames, self.transports)? {
            self.outlets.pictures.publish(&pictures)?;
        }
        Ok(())
    }

    fn status(&self, step: &SimArmStep, tick: &Tick) {
        let settings = step.settings();
        let text = format!(
            "{} with seed {}: {:.3} m to the goal",
            settings.task, settings.seed, tick.distance_m
        );
        self.diagnostics.set_status(Level::Ok, text);
    }

    fn take(&mut self, what: &str, taken: Result<(), CommandError>) {
        if let Err(refused) = taken {
            let text = format!("{what}: {refused}");
            self.complaints.left_out(refused.reason(), &text);
        }
    }

    fn late(&mut self, missed: i64) {
        let text = format!("a step took longer than {} s", wm_sim::STEP_S);
        self.complaints
            .left_out_many("late_step", missed.unsigned_abs(), &text);
    }

    fn forget(&mut self, step: &mut SimArmStep) {
        // A length fits.
        let lost = step.forget() as u64;
        let text: &dyn Display = &"the clock jumped back: commands and pictures under way are lost";
        self.complaints
            .left_out_many("clock_jumped", lost.max(1), text);
    }

    fn answer(
        &self,
        call: Call<Reset>,
        done: Result<(), wm_sim::Error>,
        step: &SimArmStep,
        now: Time,
    ) -> Result<()> {
        let (success, message) = match done {
            Ok(()) => {
                self.announce(step, now)?;
                (true, step.instruction().to_owned())
            }
            Err(refused) => (false, refused.to_string()),
        };
        answer(call, &ResetResponse { success, message });
        Ok(())
    }
}
