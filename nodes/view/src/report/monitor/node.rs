//! The monitor on the wire.

use super::live_line::LiveLine;
use crate::report::{Scorer, bag::fit_of, files::write_report, table::terminal_table};
use anyhow::{Result, ensure};
use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::time::MissedTickBehavior;
use tracing::warn;
use wm_camera::camera_frame::CameraFrame;
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    std_msgs::String as Text,
    wm_msgs::{Plan, Prediction, PredictionError},
};
use wm_ros::{
    Diagnostics, Node, NodeDefinition, NodeProgram, Qos, Received, Setup, Subscription, frame_trace,
};
use wm_wire::transport::{ImageSubscription, Transports};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Monitor>();

/// Best effort, which matches every publisher; room for the rollouts that come while one frame is scored.
const QOS: Qos = Qos::best_effort(64);

/// The camera's topic, unless a parameter names another.
const CAMERA: &str = "/camera/image_raw";

/// The monitor's thread is so many steps below the nodes. The receiving thread takes the times of messages.
const NICE: i32 = 5;

/// How often the live line is renewed.
const LIVE_PERIOD: Duration = Duration::from_millis(500);

struct Monitor {
    scorer: Scorer,
    line: LiveLine,
    is_live: bool,
    output: PathBuf,
    topics: Topics,
    diagnostics: Diagnostics,
    /// The newest frame. Scoring takes as long as encoding, so it waits until the nodes are done with the frame: until its
    /// last prediction has come, or the next frame.
    newest: Option<CameraFrame>,
    /// The transport (whether the raw one) by which predicted pictures are taken: that of the first.
    takes_raw: Option<bool>,
}

/// The names of the topics that a report needs.
struct Topics {
    camera: String,
    predicted: String,
    plan: String,
}

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Folder for the report, relative to the working directory.
        output: PathBuf = "out/monitor";
        /// Show a live status line.
        live_line: bool = true;
        /// Image topic of the camera; its sibling /compressed is used too.
        camera_topic: String = CAMERA;
        /// Image transport of the camera. With both, a frame that arrives twice counts once.
        _image_transport as "image_transport": Transports = "both";
    }
}

wm_ros::endpoints! {
    /// Topics.
    struct Inputs {
        /// The camera's frames. The parameter camera_topic sets the topic.
        camera: ImageSubscription = CAMERA, qos(QOS), made(|node, _, qos| {
            let topic: String = node.parameter("camera_topic")?;
            ImageSubscription::new(node, &topic, Transports::of(node), qos)
        });
        /// Predicted latents.
        predicted: Subscription<Prediction> = "predicted", qos(QOS);
        /// Predicted pictures.
        pictures: ImageSubscription = "predicted/image", qos(QOS), made(|node, topic, qos| {
            ImageSubscription::new(node, topic, Transports::BOTH, qos)
        });
        /// How a camera picture becomes one of their size and aspect.
        fit: Subscription<Text> = "predicted/fit", qos(Qos::reliable(1)), made(Node::subscription_catching_up);
        /// Errors of the predictions.
        errors: Subscription<PredictionError> = "prediction_error", qos(QOS);
        /// Plans.
        plans: Subscription<Plan> = "plan", qos(QOS);
        /// The state of the nodes.
        diagnostics: Subscription<DiagnosticArray> = "/diagnostics", qos(QOS);
    }
}

impl NodeProgram for Monitor {
    const NAME: &'static str = "monitor";
    const ABOUT: &'static str = "Shows a live status line, and reports at the end how well the predictions matched the camera.";
    const RUNS_ALONE: bool = true;
    type Parameters = Parameters;
    type Endpoints = Inputs;
    type Resources = ();
    type Error = anyhow::Error;

    fn check(parameters: &Parameters) -> Result<()> {
        ensure!(
            !parameters.output.as_os_str().is_empty(),
            "parameter \"output\" is empty: give the folder for the report"
        );
        Ok(())
    }

    async fn load(_: &Node, _: &Arc<Parameters>) -> Result<()> {
        Ok(())
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        let (parameters, inputs) = (&at.parameters, &at.endpoints);
        let topics = Topics {
            camera: at.node.resolve(&parameters.camera_topic)?,
            predicted: inputs.predicted.topic().to_owned(),
            plan: inputs.plans.topic().to_owned(),
        };
        Ok(Self {
            scorer: Scorer::default(),
            line: LiveLine::default(),
            is_live: parameters.live_line,
            output: parameters.output.clone(),
            topics,
            diagnostics: at.node.diagnostics(),
            newest: None,
            takes_raw: None,
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        // On Linux, of this thread alone.
        if let Err(error) = rustix::process::nice(NICE) {
            warn!("cannot lower the priority: {error}");
        }
        let inputs = &mut at.endpoints;
        let mut ticks = tokio::time::interval(LIVE_PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                received = inputs.camera.recv() => match received {
                    Some(received) => self.camera(received.message),
                    None => break,
                },
                received = inputs.predicted.recv() => match received {
                    Some(received) => self.prediction(&received),
                    None => break,
                },
                Some(received) = inputs.pictures.recv() => self.picture(&received),
                Some(received) = inputs.fit.recv() => match fit_of(&received.message) {
                    Ok(fit) => self.scorer.fit(fit),
                    Err(problem) => self.drop_input("fit", &problem),
                },
                Some(received) = inputs.errors.recv() => self.scorer.error(&received.message),
                Some(Received { message, .. }) = inputs.plans.recv() => {
                    self.line.plan(message.cost, message.time_taken.to_nanos());
                    self.scorer.plan(&message);
                }
                Some(received) = inputs.diagnostics.recv() => self.scorer.diagnostics(&received.message),
                _ = ticks.tick() => self.show(),
            }
        }
        self.score_newest();
        if self.is_live && std::io::stderr().is_terminal() {
            wm_ros::logging::last_words("");
        }
        Ok(())
    }

    /// Writes the report after the node has left the graph, so that nothing hurries the writing.
    fn finish(self, ended: Result<()>) -> Result<ExitCode> {
        ended?;
        self.report()?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Monitor {
    /// Writes the report and shows its table.
    ///
    /// # Errors
    /// The file that cannot be written, or the topic without the messages that a report needs.
    fn report(self) -> Result<()> {
        let Topics {
            camera,
            predicted,
            plan,
        } = &self.topics;
        // An empty table would hide the reason.
        ensure!(
            !self.scorer.is_empty(),
            "no report: no frame arrived on {camera} or {camera}/compressed, no prediction on {predicted}, no plan on \
             {plan}"
        );
        let (report, files) = write_report(&self.scorer, "live", &self.output)?;
        let mut result = terminal_table(&report);
        for file in files {
            result.push_str(&format!("{}\n", file.display()));
        }
        wm_ros::logging::print(result);
        ensure!(
            report.frames > 0,
            "no frame arrived on {camera} or {camera}/compressed: nothing could be compared; is the parameter \
             \"camera_topic\" the camera's?"
        );
        ensure!(
            !self.scorer.is_without_predictions(),
            "no prediction arrived on {predicted}, although {}",
            report.frames_in_words()
        );
        Ok(())
    }

    fn camera(&mut self, frame: CameraFrame) {
        let newest = self.newest.as_ref().map(|newest| newest.header().stamp);
        // a frame may come raw and compressed: it counts once
        if newest == Some(frame.header().stamp) {
            return;
        }
        self.score_newest();
        self.newest = Some(frame);
        self.line.frame(Instant::now());
    }

    fn score_newest(&mut self) {
        let Some(frame) = self.newest.take() else {
            return;
        };
        match frame.decode() {
            Ok(rgb) => self.scorer.frame(frame.header().stamp.to_nanos(), rgb),
            Err(problem) => self.drop_input("camera image", &problem),
        }
    }

    /// A predicted picture may come raw and compressed: it counts once.
    fn picture(&mut self, received: &Received<CameraFrame>) {
        let Received {
            message, received, ..
        } = received;
        let is_raw = matches!(message, CameraFrame::Raw(_));
        if *self.takes_raw.get_or_insert(is_raw) != is_raw {
            return;
        }
        let stamp_ns = message.header().stamp.to_nanos();
        match message.decode() {
            Ok(picture) => self.scorer.picture(stamp_ns, picture, received.to_nanos()),
            Err(problem) => self.drop_input("predicted image", &problem),
        }
    }

    fn prediction(&mut self, received: &Received<Prediction>) {
        let Received {
            message,
            received,
            at,
            ..
        } = received;
        let (observed, step) = (message.observed_stamp, message.step);
        frame_trace::step_passed_at("step received", observed, step, *at);
        let arrived_ns = received.to_nanos();
        let latency_ns = arrived_ns.saturating_sub(message.observed_stamp.to_nanos());
        self.line
            .prediction(message.step, latency_ns, Instant::now());
        self.scorer.prediction(message, arrived_ns);
        let newest = self.newest.as_ref().map(|newest| newest.header().stamp);
        if newest == Some(observed) && step == message.horizon {
            self.score_newest();
        }
    }

    fn drop_input(&self, what: &str, problem: &dyn std::fmt::Display) {
        self.diagnostics.count_drop(what);
        warn!("{what} ignored: {problem}");
    }

    /// On a terminal the line renews itself in place; elsewhere it is a line that begins with a carriage return, by
    /// which `wm launch` knows it. A closed standard error is no reason to stop watching.
    fn show(&mut self) {
        if !self.is_live {
            return;
        }
        let text = self.line.text(
            Instant::now(),
            self.scorer.last_error_ratio(),
            self.scorer.drop_count(),
        );
        let mut screen = wm_ros::logging::stderr();
        let written = if std::io::stderr().is_terminal() {
            write!(screen, "\r\x1b[2K{text}")
        } else {
            writeln!(screen, "\r{text}")
        };
        written.and_then(|()| screen.flush()).ok();
    }
}
