//! The learner's ROS interface.

use std::{fs, path::PathBuf, sync::Arc, time::Duration};

use anyhow::{Context as _, Result};
use tokio::{
    sync::mpsc::{UnboundedReceiver, unbounded_channel},
    time::MissedTickBehavior,
};
use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::{Float32, Header},
    wm_msgs::{
        Action, LearnerRound, LearnerStatus, Model, UseModel, UseModelRequest, UseModelResponse,
    },
};
use wm_ros::{
    Diagnostics, Input, Level, Node, NodeDefinition, NodeProgram, Publisher, Qos, Service, Setup,
    Subscription, answer, complaints::Complaints,
};
use wm_wire::transport::ImageSubscription;

use super::{
    Due, Item, Recorded, Recording, Schedule, Training, hottest_c,
    parameters::Parameters,
    recording::{bags, duration_s},
    resources::{GIB, free_of, memory_of},
    superfluous,
    training::{delete_old_models, is_tested, progress_of, result_of, rounds, steps_of},
    workplace::{IN_USE, MOST_ROUNDS, Workplace},
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Learner>();

/// Time between two looks at the training and the disk.
const LOOK: Duration = Duration::from_secs(1);
/// Wait after a training that failed.
const AFTER_FAILURE: Duration = Duration::from_secs(30);

wm_ros::endpoints! {
    /// Topics and services.
    struct Endpoints {
        /// The camera's frames.
        images: ImageSubscription = "/camera/image_raw", qos(Qos::sensor_data());
        /// Actions that the robot takes.
        actions: Subscription<Action> = "action";
        /// The model that the nodes with the parameter follow_model use.
        models: Publisher<Model> = "model", qos(Qos::latched(1));
        /// What the learner does, and its rounds.
        statuses: Publisher<LearnerStatus> = "~/status", qos(Qos::latched(1));
        /// Error ratio of the last round's model one step ahead, for plots.
        ratios: Publisher<Float32> = "~/ratio", qos(Qos::latched(1));
        /// Lets the nodes use a model, for example an earlier one. An empty name stands for the best one of the learner.
        choices: Service<UseModel> = "~/use_model";
    }
}

struct Learner {
    recording: Option<Recording>,
    recorded: UnboundedReceiver<Recorded>,
    schedule: Schedule,
    training: Option<Training>,
    /// The earliest time of the next round.
    not_before: Option<tokio::time::Instant>,
    recorded_s: f64,
    /// Of the bags on the disk \[s\].
    kept_s: f64,
    kept_bytes: u64,
    /// Whether the disk has too little room for recordings.
    is_full: bool,
    rounds: Vec<LearnerRound>,
    model: String,
    /// Why the learner pauses.
    pause: Option<String>,
    complaints: Complaints,
    diagnostics: Diagnostics,
    node: Node,
}

impl NodeProgram for Learner {
    const NAME: &'static str = "learner";
    const ABOUT: &'static str =
        "Records what passes, trains on it, and gives the nodes a new model if it is better.";
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = Workplace;
    type Error = anyhow::Error;

    async fn load(_: &Node, parameters: &Arc<Parameters>) -> Result<Workplace> {
        let parameters = Arc::clone(parameters);
        tokio::task::spawn_blocking(move || Workplace::open(&parameters)).await?
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        let (found, diagnostics) = (&at.resources, at.node.diagnostics());
        let (sender, recorded) = unbounded_channel();
        let recording = Recording::begin(found.recording.clone(), sender)?;
        let images = at.endpoints.images.topics();
        diagnostics.expect_input(Input::new("camera images", images, "start the camera"));
        let actions = Input::new(
            "actions",
            [at.endpoints.actions.topic()],
            "start the arm's driver, or remap /wm/action to its topic",
        );
        diagnostics.expect_input(actions);
        Ok(Self {
            recording: Some(recording),
            recorded,
            schedule: found.schedule.clone(),
            training: None,
            not_before: None,
            recorded_s: found.recorded_s,
            kept_s: found.recorded_s,
            kept_bytes: 0,
            is_full: false,
            rounds: found.rounds.clone(),
            model: found.model.clone(),
            pause: None,
            complaints: Complaints::new(diagnostics.clone()),
            diagnostics,
            node: at.node.clone(),
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        if self.model != at.parameters.model {
            self.hand_over(at, "the best one of the last run")?;
        }
        self.publish(at)?;
        tracing::info!("{}", self.waiting());
        let ended = self.learn(at).await;
        if let Some(training) = self.training.take() {
            tracing::info!("the round is saved; it goes on at the next start");
            training.end().await;
        }
        // Finishes its bag.
        drop(self.recording.take());
        ended
    }
}

impl Learner {
    async fn learn(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let shutdown = at.node.shutdown();
        let mut looks = tokio::time::interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            let Endpoints {
                images,
                actions,
                choices,
                ..
            } = &mut at.endpoints;
            tokio::select! {
                () = shutdown.wait() => return Ok(()),
                Some(received) = images.recv() => {
                    let at_ns = at_ns(received.received);
                    self.record(Item::Picture(Box::new(received.message), at_ns));
                }
                Some(received) = actions.recv() => {
                    let at_ns = at_ns(received.received);
                    self.record(Item::Action(received.message, at_ns));
                }
                Some(recorded) = self.recorded.recv() => self.recorded(recorded, at)?,
                ended = ended(&mut self.training) => {
                    let status = ended.context("waiting for the training")?;
                    self.training = None;
                    if !status.success() {
                        let log = at.resources.training.log.display();
                        let text = format!("a training ended with {status}: see {log}");
                        self.complaints.left_out("failed_round", &text);
                        self.fail();
                    }
                    self.finished(at)?;
                    self.publish(at)?;
                }
                Some(call) = choices.recv() => {
                    let response = self.choose(&call.request, at);
                    answer(call, &response);
                }
                _ = looks.tick() => self.look(at)?,
            }
        }
    }

    /// Tries a failed round again, but not at once.
    fn fail(&mut self) {
        self.schedule.fail();
        self.not_before = Some(tokio::time::Instant::now() + AFTER_FAILURE);
    }

    fn record(&mut self, item: Item) {
        if self.is_full {
            self.diagnostics.count_skipped("not recorded", 1);
            return;
        }
        let has_room = self
            .recording
            .as_ref()
            .is_some_and(|recording| recording.record(item));
        if !has_room {
            self.complaints
                .left_out("slow_disk", &"the disk is slower than the camera");
        }
    }

    fn recorded(&mut self, recorded: Recorded, at: &Setup<Self>) -> Result<()> {
        match recorded {
            Recorded::Bag { seconds } => {
                self.recorded_s += seconds;
                self.kept_s += seconds;
                self.schedule.recorded(seconds);
                self.make_room(at)?;
                self.publish(at)
            }
            Recorded::BadPicture(text) => {
                self.complaints.left_out("bad_image", &text);
                Ok(())
            }
            Recorded::Failed(error) => Err(error.context("recording")),
        }
    }

    /// Deletes older bags beyond the recordings' share of the disk. Not during a round, which needs its bags.
    fn make_room(&mut self, at: &Setup<Self>) -> Result<()> {
        let all = bags(&at.resources.recording.folder)?;
        let sizes: Vec<u64> = all.iter().map(|bag| bag.size).collect();
        self.kept_bytes = sizes.iter().sum();
        if self.training.is_some() {
            return Ok(());
        }
        let limit = (at.parameters.max_disk * GIB) as u64;
        let recent = at.parameters.most_bags.div_ceil(2) + at.parameters.test_bags;
        let seed = sizes.len() as u64;
        for index in superfluous(&sizes, limit, recent, seed) {
            let Some(bag) = all.get(index) else { continue };
            self.kept_s -= duration_s(&bag.path)?;
            fs::remove_dir_all(&bag.path).with_context(|| bag.path.display().to_string())?;
            self.kept_bytes -= bag.size;
            self.diagnostics
                .count_skipped("older bags deleted, for max_disk", 1);
        }
        Ok(())
    }

    /// Looks at the training and the computer, and begins a round if one is due.
    fn look(&mut self, at: &Setup<Self>) -> Result<()> {
        let (resources, output) = (&at.resources.resources, &at.parameters.output);
        let free = free_of(output).with_context(|| output.display().to_string())?;
        let is_paused = self.training.as_ref().is_some_and(Training::is_paused);
        let celsius = hottest_c();
        self.is_full = free < resources.least_free;
        self.pause = match celsius {
            _ if self.is_full => Some(format!(
                "{:.1} GiB of the disk are free, min_free is {:.1} GiB",
                free as f64 / GIB,
                resources.least_free as f64 / GIB
            )),
            Some(celsius) if resources.is_too_hot(celsius, is_paused) => Some(format!(
                "the computer has {celsius:.0} degrees Celsius, max_temperature is {:.0}",
                resources.most_c
            )),
            _ => None,
        };
        if let Some(pause) = &self.pause {
            self.diagnostics
                .raise("learner", Level::Warn, format!("paused: {pause}"));
        }
        if let Some(celsius) = celsius {
            let text = format!("{celsius:.0}");
            self.diagnostics
                .set_value("temperature [degrees Celsius]", text);
        }
        let mib = |bytes: u64| (bytes >> 20).to_string();
        self.diagnostics
            .set_value("recordings [MiB]", mib(self.kept_bytes));
        self.diagnostics.set_value("free disk [MiB]", mib(free));
        if let Some(training) = &mut self.training {
            training.pause(self.pause.is_some());
            let memory = training.id().and_then(memory_of).unwrap_or_default();
            self.diagnostics
                .set_value("training's memory [MiB]", mib(memory));
            if memory > resources.most_memory {
                let text = format!(
                    "the training needs {} MiB, max_memory is {} MiB: it is ended",
                    mib(memory),
                    mib(resources.most_memory)
                );
                self.complaints.left_out("too_much_memory", &text);
                // Dropping it kills it.
                self.training = None;
                self.fail();
            }
            return self.publish(at);
        }
        let is_held = self
            .not_before
            .is_some_and(|time| tokio::time::Instant::now() < time);
        if self.pause.is_none() && !is_held && self.schedule.due() == Due::Round {
            self.training = Some(Training::begin(&at.resources.training, &self.model)?);
            self.schedule.begin();
            self.publish(at)?;
        }
        Ok(())
    }

    /// Takes the results of finished rounds, and hands over a better model.
    fn finished(&mut self, at: &Setup<Self>) -> Result<()> {
        let known = self.rounds.last().map_or(0, |round| round.round);
        for (number, folder) in rounds(&at.resources.training.models)? {
            if number <= known {
                continue;
            }
            let Some(result) = result_of(&folder)? else {
                continue;
            };
            let round = result.message(self.node.now());
            tracing::info!("{}", in_words(&round));
            at.endpoints
                .ratios
                .publish(&Float32 { data: round.ratio })?;
            let is_better = round.accepted;
            self.model_and_round(round);
            if is_better {
                self.model = result.model.display().to_string();
                self.hand_over(at, &format!("better in round {number}"))?;
                let (models, most) = (&at.resources.training.models, at.parameters.most_models);
                // The model in use is the newest of them.
                if let Err(error) = delete_old_models(models, most) {
                    tracing::warn!("older models than the newest {most} are kept: {error:#}");
                }
            }
        }
        Ok(())
    }

    fn model_and_round(&mut self, round: LearnerRound) {
        self.rounds.push(round);
        let surplus = self.rounds.len().saturating_sub(MOST_ROUNDS);
        self.rounds.drain(..surplus);
    }

    /// Names the model in use on the topic, and on the disk for the next start.
    fn hand_over(&mut self, at: &Setup<Self>, reason: &str) -> Result<()> {
        let path = at.parameters.output.join(IN_USE);
        let part = path.with_extension("part");
        fs::write(&part, &self.model).with_context(|| part.display().to_string())?;
        fs::rename(&part, &path).with_context(|| path.display().to_string())?;
        tracing::info!("the nodes use {} now: {reason}", self.model);
        at.endpoints.models.publish(&Model {
            header: self.header(),
            model: self.model.clone(),
            reason: reason.to_owned(),
        })?;
        Ok(())
    }

    fn choose(&mut self, request: &UseModelRequest, at: &Setup<Self>) -> UseModelResponse {
        let wanted = match request.model.as_str() {
            "" => {
                let better = self.rounds.iter().rev().find(|round| round.accepted);
                better.map_or(at.parameters.model.clone(), |round| round.model.clone())
            }
            name => name.to_owned(),
        };
        let folder = PathBuf::from(&wanted);
        let has = |file: &str| folder.join(file).is_file();
        let is_there = wanted == "tiny" || has("model.json") || has("transition.safetensors");
        if !is_there {
            return UseModelResponse {
                success: false,
                message: format!(
                    "{wanted} is no model: expected tiny, or a folder with a model.json"
                ),
            };
        }
        self.model.clone_from(&wanted);
        match self
            .hand_over(at, "by request")
            .and_then(|()| self.publish(at))
        {
            Ok(()) => UseModelResponse {
                success: true,
                message: wanted,
            },
            Err(error) => UseModelResponse {
                success: false,
                message: format!("{error:#}"),
            },
        }
    }

    fn header(&self) -> Header {
        Header {
            stamp: self.node.now(),
            ..Header::default()
        }
    }

    /// Publishes the status.
    fn publish(&self, at: &Setup<Self>) -> Result<()> {
        let own = rounds(&at.resources.training.models)?;
        let (round, folder) = own.last().cloned().unwrap_or_default();
        let progress = self.training.as_ref().and_then(|_| progress_of(&folder));
        let progress = progress.unwrap_or_default();
        let planned = steps_of(&folder).unwrap_or_default();
        let steps = match progress.part.as_str() {
            "autoencoder" => at.parameters.autoencoder_steps,
            "transition" => planned.transition_steps,
            "idm" => planned.idm_steps,
            _ => 0,
        };
        let last = match planned.idm_steps {
            0 => "transition",
            _ => "idm",
        };
        let is_tested = is_tested(&folder, &progress, last, steps);
        let (state, detail) = match (&self.pause, &self.training) {
            (Some(pause), _) => (LearnerStatus::PAUSED, format!("paused: {pause}")),
            (None, Some(_)) if is_tested => (
                LearnerStatus::TESTING,
                format!("round {round}: testing the new model"),
            ),
            (None, Some(_)) if progress.part.is_empty() => (
                LearnerStatus::TRAINING,
                "a round begins: the recordings are prepared".to_owned(),
            ),
            (None, Some(_)) => (
                LearnerStatus::TRAINING,
                format!(
                    "round {round}: {} step {} of {steps}",
                    progress.part, progress.step
                ),
            ),
            (None, None) => (LearnerStatus::WAITING, self.waiting()),
        };
        self.diagnostics.set_status(Level::Ok, detail.clone());
        at.endpoints.statuses.publish(&LearnerStatus {
            header: self.header(),
            state,
            detail,
            recorded: self.recorded_s as f32,
            kept: self.kept_s as f32,
            round,
            part: progress.part,
            step: progress.step,
            steps,
            model: self.model.clone(),
            rounds: self.rounds.clone(),
        })?;
        Ok(())
    }

    fn waiting(&self) -> String {
        match self.schedule.due() {
            Due::Recordings(seconds) => format!("recording: {seconds:.0} s until the next round"),
            Due::Round => "waiting for the next round".to_owned(),
        }
    }
}

/// The end of the training; never without one. Cancel safe.
async fn ended(training: &mut Option<Training>) -> std::io::Result<std::process::ExitStatus> {
    match training {
        Some(training) => training.ended().await,
        None => std::future::pending().await,
    }
}

/// A time of receipt \[ns\]; a clock before 1970 is not set.
fn at_ns(received: Time) -> u64 {
    u64::try_from(received.to_nanos()).unwrap_or(0)
}

fn in_words(round: &LearnerRound) -> String {
    format!(
        "round {}: error ratio {:.3} after {:.0} s of data, {:.3} before (p {:.3}): {}",
        round.round,
        round.ratio,
        round.trained_on,
        round.ratio_before,
        round.p_value,
        match round.accepted {
            true => "the new model is used",
            false => "the model before stays",
        }
    )
}
