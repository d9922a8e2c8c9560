//! The simulated arm on the wire.

use std::{fmt::Display, process::ExitCode, time::Instant};

use anyhow::{Result, ensure};
use tracing::info;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Reset, ResetResponse},
};
use wm_ros::{
    Call, Component, Diagnostics, EndpointSet as _, Level, NAMESPACE, Node, NodeArgs,
    NodeDefinition, ParameterSet as _,
    calls::{Calls, answer},
    complaints::Complaints,
};
use wm_sim::FRAME_PERIOD_NS;
use wm_wire::transport::Transports;

use super::{
    CommandError, SimArmStep, Tick,
    outlets::{Endpoints, Inlets, Names, Outlets, shown},
    parameters::Parameters,
    time::ArmTime,
};

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
/// The seed has no such task, parameters contradict each other, or the graph fails.
pub async fn body(node: Node) -> Result<()> {
    let parameters = Parameters::declare(&node)?;
    node.seal_parameters()?;
    let settings = parameters.settings();
    let (clock, shutdown) = (node.clock(), node.shutdown());
    let (factor, timeout) = (parameters.real_time_factor, settings.command_timeout);
    let names = Names {
        base: settings.base_frame.clone(),
        tool: parameters.tool_frame.clone(),
    };
    let mut step = off_the_loop(move || SimArmStep::new(settings)).await??;
    let mut time = ArmTime::new(factor, timeout, clock.clone());
    ensure!(
        matches!(time, ArmTime::Clock(_)) || !clock.is_simulated(),
        "real_time_factor is {factor}, so this node makes the time on /clock, but use_sim_time is set: expected one of \
         the two"
    );
    let Endpoints {
        inlets:
            Inlets {
                mut twists,
                mut velocities,
                mut motions,
                mut openings,
            },
        outlets,
        reset,
    } = Endpoints::make(&node)?;
    node.seal_endpoints()?;
    let mut calls = Calls::default();
    calls.add(reset, |call| call);
    let mut arm = SimArm {
        outlets,
        transports: parameters.image_transport,
        names,
        complaints: Complaints::new(node.diagnostics()),
        diagnostics: node.diagnostics(),
        before: None,
    };
    arm.announce(&step, time.now_ns())?;
    let mut jumps = clock.jumps();
    // A simulated clock stands at zero before it is heard of.
    tokio::select! {
        () = clock.sleep_until(Time::from_nanos(1)) => {}
        () = shutdown.wait() => return Ok(()),
    }
    let mut next_ns = time.now_ns();
    loop {
        let frame_ns = step.next_frame_ns().filter(|frame_ns| *frame_ns < next_ns);
        let (wake_ns, is_step) = (frame_ns.unwrap_or(next_ns), frame_ns.is_none());
        tokio::select! {
            () = shutdown.wait() => return arm.outlets.settle().await,
            Ok(()) = jumps.changed() => {
                next_ns = time.now_ns();
                arm.forget(&mut step);
            }
            call = calls.next() => {
                let (task, seed) = (parameters.task(), seed(&call, &step));
                let done;
                (step, done) = off_the_loop(move || {
                    let done = step.reset(task, seed);
                    (step, done)
                }).await?;
                arm.answer(call, done, &step, time.now_ns())?;
                next_ns = time.now_ns();
            }
            Some(received) = twists.recv() => {
                let taken = step.twist(&received.message, time.heard(received.received));
                arm.take("twist", taken, &mut time);
            }
            Some(received) = velocities.recv() => {
                let taken = step.velocity(&received.message, time.heard(received.received));
                arm.take("velocity", taken, &mut time);
            }
            Some(received) = motions.recv() => {
                let taken = step.action(&received.message, time.heard(received.received));
                arm.take("action", taken, &mut time);
            }
            Some(received) = openings.recv() => {
                if let Err(refused) = step.gripper(&received.message) {
                    arm.refuse("gripper", &refused);
                }
            }
            () = time.wait(wake_ns, is_step) => {
                let (now_ns, is_made) = time.go_on(wake_ns, is_step);
                if is_made {
                    arm.outlets.tell_time(now_ns)?;
                }
                if now_ns < next_ns {
                    let frames = step.frames(now_ns);
                    arm.outlets.show(&shown(&step, &frames, arm.transports)?)?;
                    continue;
                }
                let transports = arm.transports;
                let (tick, pictures);
                (step, tick, pictures) = off_the_loop(move || {
                    let tick = step.tick(now_ns);
                    let pictures = shown(&step, &tick.frames, transports);
                    (step, tick, pictures)
                }).await?;
                arm.publish(&step, &tick)?;
                arm.outlets.show(&pictures?)?;
                arm.status(&step, &tick);
                next_ns = next_ns.saturating_add(STEP_NS);
                let late_ns = time.now_ns().saturating_sub(next_ns);
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

struct SimArm {
    outlets: Outlets,
    transports: Transports,
    names: Names,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// When the step before was done, and its time \[ns\].
    before: Option<(Instant, i64)>,
}

impl SimArm {
    /// Says what is to be done.
    fn announce(&self, step: &SimArmStep, now_ns: i64) -> Result<()> {
        let settings = step.settings();
        info!(
            "{} with seed {}: {}",
            settings.task,
            settings.seed,
            step.instruction()
        );
        self.outlets
            .announce(step, now_ns, &self.names, self.transports)
    }

    fn publish(&mut self, step: &SimArmStep, tick: &Tick) -> Result<()> {
        self.outlets.publish(step, tick, &self.names)?;
        if tick.success == Some(true) {
            info!("the task is done");
        }
        if let Some(problem) = &tick.problem {
            self.complaints.left_out(problem.reason(), problem);
        }
        if tick.lost_pictures > 0 {
            // As the parameter drop has it: no reason to complain.
            self.diagnostics
                .count_drops("picture_lost", tick.lost_pictures);
        }
        Ok(())
    }

    fn status(&mut self, step: &SimArmStep, tick: &Tick) {
        let settings = step.settings();
        let text = format!(
            "{} with seed {}: {:.3} m to the goal",
            settings.task, settings.seed, tick.distance_m
        );
        self.diagnostics.set_status(Level::Ok, text);
        let now = Instant::now();
        if let Some((at, stamp_ns)) = self.before.replace((now, tick.stamp_ns)) {
            let simulated_s = tick.stamp_ns.saturating_sub(stamp_ns) as f64 / 1e9;
            let real_s = now.saturating_duration_since(at).as_secs_f64().max(1e-9);
            let factor = format!("{:.2}", simulated_s / real_s);
            self.diagnostics.set_value("real time factor", factor);
        }
    }

    fn take(&mut self, what: &str, taken: Result<(), CommandError>, time: &mut ArmTime) {
        match taken {
            Ok(()) => time.answer(),
            Err(refused) => self.refuse(what, &refused),
        }
    }

    fn refuse(&mut self, what: &str, refused: &CommandError) {
        let text = format!("{what}: {refused}");
        self.complaints.left_out(refused.reason(), &text);
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
        now_ns: i64,
    ) -> Result<()> {
        let (success, message) = match done {
            Ok(()) => {
                self.announce(step, now_ns)?;
                (true, step.instruction().to_owned())
            }
            Err(refused) => (false, refused.to_string()),
        };
        answer(call, &ResetResponse { success, message });
        Ok(())
    }
}
