//! The view on the wire.

use crate::{
    ViewError,
    access::{self, Access},
    album::SPAN_NS,
    bag::Bag,
    command::Permission,
    control::{Answer, Control},
    conversion::Conversions,
    foxglove::{hub::Hub, offer::Offer},
    picture::{Label, Picture, PictureError, Source},
    picture_subscription::{PictureSubscription, Publishers, publishers},
    scene::Scene,
    server::{self, Asked, Settings, Shared},
    socket,
    state::{Left, State, Topic},
    status::Heard,
};
use anyhow::Result;
use futures::{StreamExt as _, future::BoxFuture, stream::FuturesUnordered};
use std::{
    net::{IpAddr, SocketAddr},
    path::PathBuf,
    process::ExitCode,
    sync::Arc,
    time::Duration,
};
use tokio::{sync::mpsc, time::MissedTickBehavior};
use wm_camera::{camera_frame::CameraFrame, camera_info::info_topic};
use wm_msgs::{
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::CameraInfo,
    std_msgs::String as Text,
    tf2_msgs::TFMessage,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, ExecutorStatus, Goal, Plan, Prediction,
        PredictionError,
    },
};
use wm_ros::{
    EndpointSet as _, Log, Node, NodeArgs, NodeDefinition, ParameterSet as _, Qos, Received,
    Subscription, complaints::Complaints,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: "view",
    about: "Serves a live page of what the robot sees, what the model expects, and what a plan would do.",
    parameters: Parameters::specs,
    endpoints: Inputs::specs,
    is_managed: false,
    run: |args| run(args).map(|()| ExitCode::SUCCESS),
    component: None,
};

/// Best effort, which matches every publisher and which none waits for; room for the rollouts that come at once.
const BURST: Qos = Qos::best_effort(64);
/// Of a topic that is latched: a message that is lost would be missing until the next one, which may never come.
const LATCHED: Qos = Qos::reliable(1);
/// Of frames that do not move: several messages of several publishers.
const STATIC: Qos = Qos::reliable(64);
/// Of a camera: the newest few.
const NEWEST: Qos = Qos::sensor_data();

/// The camera's topic, unless a parameter names another.
const CAMERA: &str = "/camera/image_raw";

/// Where the axes of the bundled bag's actions point in its pictures: right and down for x, y and z \[picture widths per m\].
const AXES: [f64; 6] = [2.93, -0.15, -0.23, -1.84, 0.0, -2.29];

/// How often clients are told of what is no picture.
const TICK: Duration = Duration::from_millis(100);
/// Every so many ticks, how things are.
const STATUS_TICKS: u64 = 5;
/// The page's port, unless a parameter names another.
pub(crate) const PORT: u16 = 8765;
/// Commands that may wait for the node.
const COMMANDS: usize = 16;

wm_ros::parameters! {
    /// The node's parameters.
    struct Parameters {
        /// Bag to show instead of what the nodes publish; empty: live.
        bag: PathBuf = "";
        /// Address that the page is served on. On another one than loopback, a token is needed, which the node prints.
        address: String = "127.0.0.1";
        /// Port that the page is served on; 0: any free one.
        port: u16 = PORT;
        /// File whose first line is the token that clients must have; empty: none on loopback, elsewhere a new one.
        token_file: PathBuf = "";
        /// Names that this host is called by, beside its addresses and localhost.
        hosts: Vec<String> = Vec::<String>::new();
        /// What the page may do beyond looking and stopping the executor: nothing; goals, candidates and resets; or all of
        /// it, which arms the executor too.
        control: Permission = "none", one_of {
            "none" => Permission::Nothing,
            "goals" => Permission::Goals,
            "all" => Permission::All,
        };
        /// Image topic of the camera; its sibling /compressed is preferred.
        camera_topic: String = CAMERA;
        /// Memory for the pictures of the last minute [MiB].
        memory: usize = 64, in 1..=4096;
        /// Number of clients at a time.
        max_clients: usize = 16, in 1..=256;
        /// Topics that Foxglove and Lichtblick can read: those whose name contains a match of this regular expression; empty:
        /// none, and their protocol is not spoken.
        foxglove_regex: String = ".*";
        /// Topics that they cannot read: those whose name contains a match of this regular expression; empty: all can.
        foxglove_exclude_regex: String = "";
        /// Highest rates for them, each as EXPRESSION=HZ: topics whose name contains a match of the expression are thinned out
        /// to so many messages a second. The first that matches counts; topics that are latched are not thinned out.
        foxglove_rates: Vec<String> = Vec::<String>::new();
        /// Origins whose pages may connect as such a viewer. file:// is that of desktop applications, and of no website; for
        /// Foxglove in a browser add https://app.foxglove.dev.
        foxglove_origins: Vec<String> = vec!["file://".to_owned()];
        /// Where the axes of actions point in the picture: right and down for x, y and z [picture widths per m]. For the
        /// arrows of a plan where the camera's place or the end effector's is not known.
        axes: Vec<f64> = AXES.to_vec();
    }
}

wm_ros::endpoints! {
    /// Topics.
    struct Inputs {
        /// The camera's frames. The parameter camera_topic sets the topic.
        camera: PictureSubscription = CAMERA, qos(NEWEST), made(|node, _, qos| {
            let topic: String = node.parameter("camera_topic")?;
            PictureSubscription::new(node, &topic, qos)
        });
        /// How it sees, beside its frames.
        camera_infos: Subscription<CameraInfo> = "/camera/camera_info", qos(Qos::best_effort(1)), made(|node, _, qos| {
            let images: String = node.parameter("camera_topic")?;
            node.subscription(&info_topic(&images), qos)
        });
        /// Where it is, and where the arm is.
        transforms: Subscription<TFMessage> = "/tf", qos(BURST);
        /// The same, of what does not move.
        static_transforms: Subscription<TFMessage> = "/tf_static", qos(STATIC), made(Node::subscription_to_any);
        /// Predicted latents, of which only the stamps and steps are used.
        predicted: Subscription<Prediction> = "predicted", qos(BURST);
        /// Predicted pictures.
        pictures: PictureSubscription = "predicted/image", qos(BURST);
        /// How a camera picture becomes one of their size and aspect.
        fit: Subscription<Text> = "predicted/fit", qos(LATCHED), made(Node::subscription_to_any);
        /// Errors of the predictions.
        errors: Subscription<PredictionError> = "prediction_error", qos(BURST);
        /// Actions that the robot takes.
        actions: Subscription<Action> = "action", qos(BURST);
        /// Actions that a policy will take next.
        chunks: Subscription<ActionChunk> = "action_chunk", qos(NEWEST);
        /// The goal's picture.
        goal_pictures: PictureSubscription = "goal/image", qos(LATCHED), made(PictureSubscription::of_latched);
        /// Goals of other kinds.
        goals: Subscription<Goal> = "goal", qos(LATCHED), made(Node::subscription_to_any);
        /// Plans.
        plans: Subscription<Plan> = "plan", qos(NEWEST);
        /// Where a plan leads.
        markers: Subscription<MarkerArray> = "markers", qos(BURST);
        /// What the camera would see after a plan.
        outcomes: PictureSubscription = "plan/image", qos(NEWEST);
        /// A policy's candidates.
        candidates: Subscription<ActionCandidates> = "action_candidates", qos(NEWEST);
        /// What they would do.
        assessments: Subscription<Assessment> = "assessment", qos(NEWEST);
        /// The same in pictures.
        candidate_pictures: PictureSubscription = "candidates/image", qos(NEWEST);
        /// What the executor does.
        executor: Subscription<ExecutorStatus> = "executor/status", qos(LATCHED), made(Node::subscription_to_any);
        /// The state of the nodes.
        diagnostics: Subscription<DiagnosticArray> = "/diagnostics", qos(BURST);
        /// The log.
        log: Subscription<Log> = "/rosout", qos(BURST);
    }
}

fn run(args: &NodeArgs) -> Result<()> {
    args.expect_no_rest()?;
    wm_ros::run(NODE.name, wm_ros::NAMESPACE, args, async |node: Node| {
        view(&node).await
    })
}

/// The topics by their names in this node, without the siblings.
fn topics(node: &Node, camera_topic: &str) -> Result<Vec<Heard>> {
    let names = [
        (Topic::Camera, camera_topic),
        (Topic::Predicted, "predicted"),
        (Topic::Pictures, "predicted/image"),
        (Topic::Errors, "prediction_error"),
        (Topic::Action, "action"),
        (Topic::Chunk, "action_chunk"),
        (Topic::Goal, "goal/image"),
        (Topic::Plan, "plan"),
        (Topic::Markers, "markers"),
        (Topic::Outcome, "plan/image"),
        (Topic::Candidates, "action_candidates"),
        (Topic::CandidatePictures, "candidates/image"),
        (Topic::Assessment, "assessment"),
        (Topic::Executor, "executor/status"),
        (Topic::Diagnostics, "/diagnostics"),
        (Topic::Log, "/rosout"),
    ];
    let heard = |(topic, name): (Topic, &str)| {
        let name = node.resolve(name)?;
        Ok(Heard {
            topic,
            name,
            publishers: None,
        })
    };
    names.into_iter().map(heard).collect()
}

async fn view(node: &Node) -> Result<()> {
    let parameters = Parameters::declare(node)?;
    node.seal_parameters()?;
    let ip: IpAddr = parameters
        .address
        .parse()
        .map_err(|_| ViewError::Address(parameters.address.clone()))?;
    if parameters.axes.len() != AXES.len() {
        return Err(ViewError::Axes(parameters.axes.len()).into());
    }
    let token = access::token(ip, &parameters.token_file)?;
    let access = Access::new(parameters.hosts.clone(), token)
        .with_viewers(parameters.foxglove_origins.clone())?;
    let offer = Offer::new(
        &parameters.foxglove_regex,
        &parameters.foxglove_exclude_regex,
        &parameters.foxglove_rates,
    )?;
    let foxglove = offer.map(|offer| Hub::new(node, offer));
    let mut heard = topics(node, &parameters.camera_topic)?;
    let bag = match parameters.bag.as_os_str().is_empty() {
        true => None,
        false => Some(Arc::new(Bag::open(&parameters.bag, &heard)?)),
    };
    let inputs = match &bag {
        Some(_) => None,
        None => {
            heard
                .iter_mut()
                .for_each(|heard| heard.publishers = Some(0));
            Some(Inputs::make(node)?)
        }
    };
    node.seal_endpoints()?;
    let (listener, address) = server::listen(SocketAddr::new(ip, parameters.port)).await?;
    let url = access.url(address);
    let state = match &bag {
        Some(_) => State::of_bag(),
        // MiB
        None => State::live(parameters.memory << 20),
    };
    let hello = serde_json::json!({
        "op": "hello",
        "version": env!("CARGO_PKG_VERSION"),
        "bag": bag.as_ref().map(|bag| bag.name()),
        "control": parameters.control.name(),
        "axes": parameters.axes,
        "span_s": SPAN_NS / 1_000_000_000,
    });
    let settings = Settings {
        access,
        permission: parameters.control,
        max_clients: parameters.max_clients,
        hello: hello.to_string(),
        bag: bag.clone(),
        clock: node.clock(),
        foxglove: foxglove.clone(),
    };
    let (sender, commands) = mpsc::channel(COMMANDS);
    let shared = Arc::new(Shared::new(state, heard, settings, sender));
    tokio::spawn(server::serve(listener, Arc::clone(&shared)));
    // Not in the log, which others hear: it may have a token.
    wm_ros::logging::print(format_args!("the page is at {url}\n"));
    if let (Some(hub), None) = (foxglove, &bag) {
        tokio::spawn(hub.look());
    }
    if let Some(bag) = bag {
        let shared = Arc::clone(&shared);
        tokio::task::spawn_blocking(move || bag.read(&shared));
    }
    let control = Control::new(node, parameters.control)?;
    let mut hearing = Hearing {
        node: node.clone(),
        shared,
        control,
        conversions: Conversions::default(),
        complaints: Complaints::new(node.diagnostics()),
        running: FuturesUnordered::new(),
    };
    match inputs {
        Some(inputs) => hearing.hear(inputs, commands).await,
        None => {
            node.shutdown().wait().await;
            Ok(())
        }
    }
}

/// The node while it hears.
struct Hearing {
    node: Node,
    shared: Arc<Shared>,
    control: Control,
    conversions: Conversions,
    complaints: Complaints,
    /// Commands under way.
    running: FuturesUnordered<BoxFuture<'static, ()>>,
}

impl Hearing {
    async fn hear(
        &mut self,
        mut inputs: Inputs,
        mut commands: mpsc::Receiver<Asked>,
    ) -> Result<()> {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut graph = self.node.graph_changes();
        graph.mark_changed();
        let (mut tick, mut told) = (0_u64, 0_u64);
        loop {
            tokio::select! {
                received = inputs.camera.recv() => match received {
                    Some(received) => self.picture(Source::Camera, received),
                    None => return Ok(()),
                },
                Some(received) = inputs.pictures.recv() => {
                    // Where both wait, the predictions first: by them it is told which picture it is.
                    while let Some(prediction) = inputs.predicted.try_recv() {
                        self.tell(&prediction.map(Arc::new), State::prediction);
                    }
                    self.picture(Source::Predicted, received);
                }
                Some(received) = inputs.outcomes.recv() => self.picture(Source::Plan, received),
                Some(received) = inputs.candidate_pictures.recv() => self.picture(Source::Candidates, received),
                Some(received) = inputs.goal_pictures.recv() => self.picture(Source::Goal, received),
                Some(converted) = self.conversions.next() => {
                    let (label, now_ns, picture) = converted;
                    self.seen(label, now_ns, picture);
                }
                Some(received) = inputs.predicted.recv_shared() => self.tell(&received, State::prediction),
                Some(received) = inputs.fit.recv_shared() => self.tell(&received, |state, fit, _| state.fit(fit)),
                Some(received) = inputs.errors.recv_shared() => self.tell(&received, of(State::error)),
                Some(received) = inputs.actions.recv_shared() => self.tell(&received, of(State::action)),
                Some(received) = inputs.chunks.recv_shared() => self.tell(&received, of(State::chunk)),
                Some(received) = inputs.goals.recv_shared() => self.tell(&received, of(State::goal)),
                Some(received) = inputs.plans.recv_shared() => self.tell(&received, of(State::plan)),
                Some(received) = inputs.markers.recv_shared() => self.tell(&received, of(State::markers)),
                Some(received) = inputs.camera_infos.recv_shared() => self.place(|scene| { scene.camera(&received.message); Ok(()) }),
                Some(received) = inputs.transforms.recv_shared() => self.place(|scene| scene.transforms(&received.message, false)),
                Some(received) = inputs.static_transforms.recv_shared() => self.place(|scene| scene.transforms(&received.message, true)),
                Some(received) = inputs.candidates.recv_shared() => {
                    let now_ns = received.received.to_nanos();
                    let told = self.shared.known().state.candidates(received.message, now_ns);
                    self.complain(told);
                }
                Some(received) = inputs.assessments.recv_shared() => self.tell(&received, of(State::assessment)),
                Some(received) = inputs.executor.recv_shared() => {
                    self.control.meet_executor()?;
                    self.tell(&received, of(State::executor));
                }
                Some(received) = inputs.diagnostics.recv_shared() => self.tell(&received, of(State::diagnostics)),
                Some(received) = inputs.log.recv_shared() => self.tell(&received, of(State::log)),
                Some(asked) = commands.recv() => self.run(asked),
                Some(()) = self.running.next() => {}
                _ = ticks.tick() => {
                    if graph.has_changed().unwrap_or(false) {
                        graph.mark_unchanged();
                        inputs.look(&publishers(self.node.topics()), &self.shared)?;
                    }
                    let events = self.shared.known().state.journal.end();
                    let is_status_due = tick.is_multiple_of(STATUS_TICKS) && self.shared.clients() > 0;
                    if is_status_due {
                        self.shared.renew_status();
                    }
                    if is_status_due || events != told {
                        self.shared.wake();
                    }
                    (tick, told) = (tick + 1, events);
                }
            }
        }
    }

    /// Tells the state of a message.
    fn tell<M>(
        &mut self,
        received: &Received<Arc<M>>,
        tell: impl FnOnce(&mut State, &M, i64) -> Result<(), Left>,
    ) {
        let now_ns = received.received.to_nanos();
        let told = tell(&mut self.shared.known().state, &received.message, now_ns);
        self.complain(told);
    }

    /// Tells of where things are in the picture.
    fn place(&mut self, tell: impl FnOnce(&mut Scene) -> Result<(), Left>) {
        let told = tell(&mut self.shared.known().state.scene);
        self.complain(told);
    }

    fn complain(&mut self, told: Result<(), Left>) {
        if let Err(left) = told {
            self.complaints.left_out(left.reason(), &left.text());
        }
    }

    fn picture(&mut self, source: Source, received: Received<CameraFrame>) {
        let (frame, now_ns) = (received.message, received.received.to_nanos());
        let stamp_ns = frame.header().stamp.to_nanos();
        let label = self.shared.known().state.label(source, stamp_ns, now_ns);
        let label = match label {
            Ok(Some(label)) => label,
            Ok(None) => return,
            Err(left) => return self.complain(Err(left)),
        };
        if !Picture::is_slow(&frame) {
            self.seen(label, now_ns, Picture::of(&frame, label, now_ns));
        } else if !self.conversions.begin(frame, label, now_ns) {
            // The next one is as good.
            self.node
                .diagnostics()
                .count_skipped("image while others are encoded", 1);
        }
    }

    fn seen(&mut self, label: Label, now_ns: i64, picture: Result<Picture, PictureError>) {
        match picture {
            Ok(picture) => {
                self.shared.known().state.picture(Arc::new(picture), now_ns);
                self.shared.wake();
            }
            Err(error) => {
                let text = format!("a picture of {}: {error}", label.source.name());
                self.complaints.left_out("bad_picture", &text);
            }
        }
    }

    fn run(&mut self, asked: Asked) {
        let Asked {
            number,
            command,
            answers,
        } = asked;
        tracing::info!("a client of the page asks to {command}");
        let answer = self.control.run(command, &self.shared);
        self.running.push(Box::pin(async move {
            let answer: Answer = answer.await;
            let answer = answer.as_deref().map_err(String::as_str);
            // A client that is gone needs none.
            answers.try_send(socket::answer(Some(number), answer)).ok();
        }));
    }
}

/// What cannot fail.
fn of<M>(
    tell: impl FnOnce(&mut State, &M, i64),
) -> impl FnOnce(&mut State, &M, i64) -> Result<(), Left> {
    move |state, message, now_ns| {
        tell(state, message, now_ns);
        Ok(())
    }
}

impl Inputs {
    /// The graph has changed: who publishes what, and by which transport.
    fn look(&mut self, publishers: &Publishers, shared: &Shared) -> Result<()> {
        let pictures = [
            (Topic::Camera, &mut self.camera),
            (Topic::Pictures, &mut self.pictures),
            (Topic::Outcome, &mut self.outcomes),
            (Topic::CandidatePictures, &mut self.candidate_pictures),
            (Topic::Goal, &mut self.goal_pictures),
        ];
        let mut of_pictures = Vec::new();
        for (topic, subscription) in pictures {
            subscription.look(publishers)?;
            of_pictures.push((topic, subscription.publishers(publishers)));
        }
        for heard in &mut shared.known().heard {
            let picture = of_pictures.iter().find(|(topic, _)| *topic == heard.topic);
            let own = || publishers.get(&heard.name).copied().unwrap_or(0);
            heard.publishers = Some(picture.map_or_else(own, |(_, number)| *number));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_ros::Reliability;
    use wm_sim::render::{Camera, IMAGE_SIZE};

    #[test]
    fn latched_topics_are_received_reliably() {
        let specs = Inputs::specs();
        for latched in [
            "/tf_static",
            "predicted/fit",
            "goal",
            "goal/image",
            "goal/image/compressed",
            "executor/status",
        ] {
            let spec = specs.iter().find(|spec| spec.name == latched).unwrap();
            let qos = spec.qos.unwrap();
            assert_eq!(qos.reliability, Reliability::Reliable, "{latched}");
        }
    }

    /// A change of 1 cm at the middle of the bundled camera's view, on each axis.
    #[test]
    fn default_axes_fit_the_bundled_camera() {
        let camera = Camera::beside_the_arm();
        let middle = [0.262, 0.0, 0.095];
        let pixel = |point: [f64; 3]| camera.pixel(&point.into()).unwrap();
        let from = pixel(middle);
        for axis in 0..3 {
            let mut point = middle;
            point[axis] += 0.01;
            let to = pixel(point);
            for side in 0..2 {
                let widths = f64::from(to[side] - from[side]) / f64::from(IMAGE_SIZE) / 0.01;
                let expected = AXES[2 * axis + side];
                // Perspective over the centimetre.
                assert!((widths - expected).abs() < 0.06, "{axis} {side}: {widths}");
            }
        }
    }
}
