//! The simulated arm's ROS interface.

use std::{fmt::Display, sync::Arc, time::Instant};

use anyhow::{Context as _, Result, ensure};
use tracing::info;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Reset, ResetResponse},
};
use wm_ros::{
    Call, Diagnostics, Level, Node, NodeDefinition, NodeProgram, Setup, answer,
    complaints::Complaints,
};
use wm_sim::FRAME_PERIOD_NS;
use wm_wire::transport::Transports;

use super::{
    CommandError, SimArmStep, Tick,
    outlets::{Endpoints, Inlets, Names, Outlets, Request, encode},
    parameters::Parameters,
    time::ArmTime,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<SimArm>();

/// Duration of a step: 0.2 s, which fits into 64 bits.
const STEP_NS: i64 = FRAME_PERIOD_NS as i64;

/// Computes off the message loop: making a table takes seconds, and rendering a picture takes milliseconds.
async fn off_the_loop<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T> {
    Ok(tokio::task::spawn_blocking(work).await?)
}

struct SimArm {
    transports: Transports,
    names: Names,
    complaints: Complaints,
    diagnostics: Diagnostics,
    /// Real time of the last step, and its stamp \[ns\].
    last_step: Option<(Instant, i64)>,
}

impl NodeProgram for SimArm {
    const NAME: &'static str = "sim_arm";
    const ABOUT: &'static str =
        "A live simulated arm with a camera and a task, in place of a real one.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    /// `run` takes them, because each step moves to another thread and back.
    type Resources = Option<(SimArmStep, ArmTime)>;
    type Error = anyhow::Error;

    async fn load(node: &Node, parameters: &Arc<Parameters>) -> Result<Self::Resources> {
        let (settings, clock) = (parameters.settings(), node.clock());
        let (factor, timeout) = (parameters.real_time_factor, settings.command_timeout);
        let step = off_the_loop(move || SimArmStep::new(settings)).await??;
        let time = ArmTime::new(factor, timeout, clock.clone());
        ensure!(
            matches!(time, ArmTime::Clock(_)) || !clock.is_simulated(),
            "real_time_factor is {factor}, so this node makes the time on /clock, but use_sim_time is set: expected one \
             of the two"
        );
        Ok(Some((step, time)))
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        Ok(Self {
            transports: at.parameters.image_transport,
            names: Names {
                base: at.parameters.settings().base_frame,
                tool: at.parameters.tool_frame.clone(),
            },
            complaints: Complaints::new(at.node.diagnostics()),
            diagnostics: at.node.diagnostics(),
            last_step: None,
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let taken = at.resources.take();
        let (mut step, mut time) = taken.context("the arm runs once")?;
        let Endpoints {
            inlets,
            outlets,
            requests,
        } = &mut at.endpoints;
        let Inlets {
            twists,
            velocities,
            motions,
            openings,
        } = inlets;
        let (clock, shutdown) = (at.node.clock(), at.node.shutdown());
        self.announce(outlets, &step, time.now_ns())?;
        let mut jumps = clock.jumps();
        // A simulated clock is at zero until the first message on /clock.
        tokio::select! {
            () = clock.sleep_until(Time::from_nanos(1)) => {}
            () = shutdown.wait() => return Ok(()),
        }
        let mut next_ns = time.now_ns();
        loop {
            let frame_ns = step.next_frame_ns().filter(|frame_ns| *frame_ns < next_ns);
            let (wake_ns, is_step) = (frame_ns.unwrap_or(next_ns), frame_ns.is_none());
            tokio::select! {
                () = shutdown.wait() => return outlets.settle().await,
                Ok(()) = jumps.changed() => {
                    next_ns = time.now_ns();
                    self.forget(&mut step);
                }
                Some(Request::Reset(call)) = requests.next_request() => {
                    let (task, seed) = (at.parameters.task(), seed(&call, &step));
                    let result;
                    (step, result) = off_the_loop(move || {
                        let result = step.reset(task, seed);
                        (step, result)
                    }).await?;
                    self.answer(outlets, call, result, &step, time.now_ns())?;
                    next_ns = time.now_ns();
                }
                Some(received) = twists.recv() => {
                    let taken = step.twist(&received.message, time.at(received.received));
                    self.take("twist", taken, &mut time);
                }
                Some(received) = velocities.recv() => {
                    let taken = step.velocity(&received.message, time.at(received.received));
                    self.take("velocity", taken, &mut time);
                }
                Some(received) = motions.recv() => {
                    let taken = step.action(&received.message, time.at(received.received));
                    self.take("action", taken, &mut time);
                }
                Some(received) = openings.recv() => {
                    if let Err(refused) = step.gripper(&received.message) {
                        self.refuse("gripper", &refused);
                    }
                }
                () = time.wait(wake_ns, is_step) => {
                    let (now_ns, is_made) = time.advance(wake_ns, is_step);
                    if is_made {
                        outlets.publish_time(now_ns)?;
                    }
                    if now_ns < next_ns {
                        let frames = step.frames(now_ns);
                        outlets.show(&encode(&step, &frames, self.transports)?)?;
                        continue;
                    }
                    let transports = self.transports;
                    let (tick, pictures);
                    (step, tick, pictures) = off_the_loop(move || {
                        let tick = step.tick(now_ns);
                        let pictures = encode(&step, &tick.frames, transports);
                        (step, tick, pictures)
                    }).await?;
                    self.publish(outlets, &step, &tick)?;
                    outlets.show(&pictures?)?;
                    self.status(&step, &tick);
                    next_ns = next_ns.saturating_add(STEP_NS);
                    let late_ns = time.now_ns().saturating_sub(next_ns);
                    if late_ns > 0 {
                        // Missed steps are skipped: catching up would leave no time for commands.
                        let missed = late_ns / STEP_NS + 1;
                        self.count_missed(missed);
                        next_ns = next_ns.saturating_add(missed.saturating_mul(STEP_NS));
                    }
                }
            }
        }
    }
}

/// The seed that a call requests.
fn seed(call: &Call<Reset>, step: &SimArmStep) -> u64 {
    match call.request.keep_seed {
        true => step.settings().seed,
        false => call.request.seed,
    }
}

impl SimArm {
    /// Logs and publishes the task.
    fn announce(&self, outlets: &Outlets, step: &SimArmStep, now_ns: i64) -> Result<()> {
        let settings = step.settings();
        info!(
            "{} with seed {}: {}",
            settings.task,
            settings.seed,
            step.instruction()
        );
        outlets.announce(step, now_ns, &self.names, self.transports)
    }

    fn publish(&mut self, outlets: &Outlets, step: &SimArmStep, tick: &Tick) -> Result<()> {
        outlets.publish(step, tick, &self.names)?;
        if tick.success == Some(true) {
            info!("the task is done");
        }
        if let Some(problem) = &tick.problem {
            self.complaints.left_out(problem.reason(), problem);
        }
        if tick.lost_pictures > 0 {
            // Lost on purpose, by the parameter drop: counted, but not a fault.
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
        if let Some((at, stamp_ns)) = self.last_step.replace((now, tick.stamp_ns)) {
            let simulated_s = tick.stamp_ns.saturating_sub(stamp_ns) as f64 / 1e9;
            let real_s = now.saturating_duration_since(at).as_secs_f64().max(1e-9);
            let factor = format!("{:.2}", simulated_s / real_s);
            self.diagnostics.set_value("real time factor", factor);
        }
    }

    fn take(&mut self, what: &str, taken: Result<(), CommandError>, time: &mut ArmTime) {
        match taken {
            Ok(()) => time.note_command(),
            Err(refused) => self.refuse(what, &refused),
        }
    }

    fn refuse(&mut self, what: &str, refused: &CommandError) {
        let text = format!("{what}: {refused}");
        self.complaints.left_out(refused.reason(), &text);
    }

    fn count_missed(&mut self, missed: i64) {
        let text = format!("a step took longer than {} s", wm_sim::STEP_S);
        self.complaints
            .left_out_many("late_step", missed.unsigned_abs(), &text);
    }

    fn forget(&mut self, step: &mut SimArmStep) {
        // A length fits into 64 bits.
        let lost = step.forget() as u64;
        let text: &dyn Display = &"the clock jumped back: commands and pictures under way are lost";
        self.complaints
            .left_out_many("clock_jumped", lost.max(1), text);
    }

    fn answer(
        &self,
        outlets: &Outlets,
        call: Call<Reset>,
        result: Result<(), wm_sim::Error>,
        step: &SimArmStep,
        now_ns: i64,
    ) -> Result<()> {
        let (success, message) = match result {
            Ok(()) => {
                self.announce(outlets, step, now_ns)?;
                (true, step.instruction().to_owned())
            }
            Err(refused) => (false, refused.to_string()),
        };
        answer(call, &ResetResponse { success, message });
        Ok(())
    }
}
