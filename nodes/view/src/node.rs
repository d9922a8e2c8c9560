//! The view on the wire.

use crate::{
    ViewError,
    access::{self, Access},
    album::SPAN_NS,
    bag::{self, Bag},
    control::{Answer, Control},
    conversion::Conversions,
    drop_reason::DropReason,
    foxglove::{hub::Hub, offer::Offer},
    inputs::{Inputs, LiveInputs, topics},
    parameters::{AXES, Parameters},
    picture::{Label, Picture, PictureError, Source},
    picture_subscription::publishers,
    scene::Scene,
    server,
    shared::{ClientCommand, Settings, Shared},
    socket,
    state::State,
    status::InputTopic,
};
use anyhow::{Context as _, Result};
use futures::{StreamExt as _, future::BoxFuture, stream::FuturesUnordered};
use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};
use tokio::{sync::mpsc, time::MissedTickBehavior};
use wm_camera::camera_frame::CameraFrame;
use wm_ros::{
    ChosenTopics, Node, NodeDefinition, NodeProgram, Received, Setup, complaints::Complaints,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<ViewProgram>();

/// How often clients are told of what is no picture.
const TICK: Duration = Duration::from_millis(100);
/// Every so many ticks, how things are.
const STATUS_TICKS: u64 = 5;
/// Commands that may wait for the node.
const COMMANDS: usize = 16;

/// The node.
struct ViewProgram;

/// What is checked and opened before anything is served.
struct Preparation {
    ip: IpAddr,
    access: Access,
    foxglove: Option<Arc<Hub>>,
    topics: Vec<InputTopic>,
    /// `None` if it is live.
    bag: Option<Arc<Bag>>,
}

impl NodeProgram for ViewProgram {
    const NAME: &'static str = "view";
    const ABOUT: &'static str = "Serves a live page of what the robot sees, what the model expects, and what a plan would do.";
    const CHOSEN_TOPICS: ChosenTopics = ChosenTopics::Subscribed;
    const RUNS_ALONE: bool = true;
    type Parameters = Parameters;
    type Endpoints = LiveInputs;
    /// The server takes it.
    type Resources = Option<Preparation>;
    type Error = anyhow::Error;

    async fn load(node: &Node, parameters: &Arc<Parameters>) -> Result<Option<Preparation>> {
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
        let is_live = parameters.bag.as_os_str().is_empty();
        let topics = topics(node, &parameters.camera_topic, is_live)?;
        let bag = match is_live {
            true => None,
            false => Some(Arc::new(Bag::open(&parameters.bag, &topics)?)),
        };
        Ok(Some(Preparation {
            ip,
            access,
            foxglove,
            topics,
            bag,
        }))
    }

    fn activate(_: &Setup<Self>) -> Result<Self> {
        Ok(Self)
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let Preparation {
            ip,
            access,
            foxglove,
            topics,
            bag,
        } = at.resources.take().context("the view runs once")?;
        let (listener, address) = server::listen(SocketAddr::new(ip, at.parameters.port)).await?;
        let url = access.url(address);
        let state = match &bag {
            Some(_) => State::of_bag(),
            // MiB
            None => State::live(at.parameters.memory << 20),
        };
        let hello = serde_json::json!({
            "op": "hello",
            "version": env!("CARGO_PKG_VERSION"),
            "bag": bag.as_ref().map(|bag| bag.name()),
            "control": at.parameters.control.name(),
            "axes": at.parameters.axes,
            "span_s": SPAN_NS / 1_000_000_000,
        });
        let settings = Settings {
            access,
            permission: at.parameters.control,
            max_clients: at.parameters.max_clients,
            hello: hello.to_string(),
            bag: bag.clone(),
            clock: at.node.clock(),
            foxglove: foxglove.clone(),
        };
        let (sender, commands) = mpsc::channel(COMMANDS);
        let shared = Arc::new(Shared::new(state, topics, settings, sender));
        tokio::spawn(server::serve(listener, Arc::clone(&shared)));
        // Not in the log, which is a topic: the address may have a token.
        wm_ros::logging::print(format_args!("the page is at {url}\n"));
        if let (Some(hub), None) = (foxglove, &bag) {
            tokio::spawn(hub.look());
        }
        if let Some(bag) = bag {
            let shared = Arc::clone(&shared);
            tokio::task::spawn_blocking(move || bag::read(&bag, &shared));
        }
        let control = Control::new(&at.node, at.parameters.control)?;
        let Some(inputs) = &mut at.endpoints.0 else {
            at.node.shutdown().wait().await;
            return Ok(());
        };
        let mut live = LiveView {
            node: at.node.clone(),
            shared,
            control,
            conversions: Conversions::default(),
            complaints: Complaints::new(at.node.diagnostics()),
            running: FuturesUnordered::new(),
        };
        live.follow(inputs, commands).await
    }
}

/// A view of what the nodes publish.
struct LiveView {
    node: Node,
    shared: Arc<Shared>,
    control: Control,
    conversions: Conversions,
    complaints: Complaints,
    /// Commands under way.
    running: FuturesUnordered<BoxFuture<'static, ()>>,
}

impl LiveView {
    async fn follow(
        &mut self,
        inputs: &mut Inputs,
        mut commands: mpsc::Receiver<ClientCommand>,
    ) -> Result<()> {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut graph = self.node.graph_changes();
        graph.mark_changed();
        let (mut tick, mut published) = (0_u64, 0_u64);
        loop {
            tokio::select! {
                received = inputs.camera.recv() => match received {
                    Some(received) => self.picture(Source::Camera, received),
                    None => return Ok(()),
                },
                Some(received) = inputs.pictures.recv() => {
                    // If both wait, the predictions first: they identify the picture.
                    while let Some(prediction) = inputs.predicted.try_recv() {
                        self.update(&prediction.map(Arc::new), State::prediction);
                    }
                    self.picture(Source::Predicted, received);
                }
                Some(received) = inputs.outcomes.recv() => self.picture(Source::Plan, received),
                Some(received) = inputs.subgoals.recv() => self.picture(Source::Subgoals, received),
                Some(received) = inputs.candidate_pictures.recv() => self.picture(Source::Candidates, received),
                Some(received) = inputs.goal_pictures.recv() => self.picture(Source::Goal, received),
                Some(converted) = self.conversions.next() => {
                    let (label, now_ns, picture) = converted;
                    self.show(label, now_ns, picture);
                }
                Some(received) = inputs.predicted.recv_shared() => self.update(&received, State::prediction),
                Some(received) = inputs.fit.recv_shared() => self.update(&received, |state, fit, _| state.fit(fit)),
                Some(received) = inputs.errors.recv_shared() => self.update(&received, of(State::error)),
                Some(received) = inputs.actions.recv_shared() => self.update(&received, of(State::action)),
                Some(received) = inputs.chunks.recv_shared() => self.update(&received, of(State::chunk)),
                Some(received) = inputs.goals.recv_shared() => self.update(&received, of(State::goal)),
                Some(received) = inputs.plans.recv_shared() => self.update(&received, of(State::plan)),
                Some(received) = inputs.markers.recv_shared() => self.update(&received, of(State::markers)),
                Some(received) = inputs.camera_infos.recv_shared() => self.place(|scene| { scene.camera(&received.message); Ok(()) }),
                Some(received) = inputs.transforms.recv_shared() => self.place(|scene| scene.transforms(&received.message, false)),
                Some(received) = inputs.static_transforms.recv_shared() => self.place(|scene| scene.transforms(&received.message, true)),
                Some(received) = inputs.candidates.recv_shared() => {
                    let now_ns = received.received.to_nanos();
                    let updated = self.shared.known().state.candidates(received.message, now_ns);
                    self.complain(updated);
                }
                Some(received) = inputs.assessments.recv_shared() => self.update(&received, of(State::assessment)),
                Some(received) = inputs.executor.recv_shared() => {
                    self.control.meet_executor()?;
                    self.update(&received, of(State::executor));
                }
                Some(received) = inputs.learner.recv_shared() => self.update(&received, of(State::learner)),
                Some(received) = inputs.diagnostics.recv_shared() => self.update(&received, of(State::diagnostics)),
                Some(received) = inputs.log.recv_shared() => self.update(&received, of(State::log)),
                Some(command) = commands.recv() => self.run(command),
                Some(()) = self.running.next() => {}
                _ = ticks.tick() => {
                    // An error is the shutdown.
                    if graph.has_changed().unwrap_or(false) {
                        graph.mark_unchanged();
                        inputs.look(&publishers(self.node.topics()), &self.shared)?;
                    }
                    let events = self.shared.known().state.journal.end();
                    let is_status_due = tick.is_multiple_of(STATUS_TICKS) && self.shared.clients() > 0;
                    if is_status_due {
                        self.shared.renew_status();
                    }
                    if is_status_due || events != published {
                        self.shared.wake();
                    }
                    (tick, published) = (tick + 1, events);
                }
            }
        }
    }

    /// Updates the state by a message.
    fn update<M>(
        &mut self,
        received: &Received<Arc<M>>,
        update: impl FnOnce(&mut State, &M, i64) -> Result<(), DropReason>,
    ) {
        let now_ns = received.received.to_nanos();
        let updated = update(&mut self.shared.known().state, &received.message, now_ns);
        self.complain(updated);
    }

    /// Updates the places of things in the picture.
    fn place(&mut self, update: impl FnOnce(&mut Scene) -> Result<(), DropReason>) {
        let updated = update(&mut self.shared.known().state.scene);
        self.complain(updated);
    }

    fn complain(&mut self, updated: Result<(), DropReason>) {
        if let Err(dropped) = updated {
            self.complaints.left_out(dropped.reason(), &dropped.text());
        }
    }

    fn picture(&mut self, source: Source, received: Received<CameraFrame>) {
        let (frame, now_ns) = (received.message, received.received.to_nanos());
        let stamp_ns = frame.header().stamp.to_nanos();
        let label = self.shared.known().state.label(source, stamp_ns, now_ns);
        let label = match label {
            Ok(Some(label)) => label,
            Ok(None) => return,
            Err(dropped) => return self.complain(Err(dropped)),
        };
        if !Picture::is_slow(&frame) {
            self.show(label, now_ns, Picture::of(&frame, label, now_ns));
        } else if !self.conversions.begin(frame, label, now_ns) {
            // The next one is as good.
            self.node
                .diagnostics()
                .count_skipped("image while others are encoded", 1);
        }
    }

    fn show(&mut self, label: Label, now_ns: i64, picture: Result<Picture, PictureError>) {
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

    fn run(&mut self, command: ClientCommand) {
        let ClientCommand {
            number,
            command,
            answers,
        } = command;
        tracing::info!("a client of the page asks to {command}");
        let answer = self.control.run(command, &self.shared);
        self.running.push(Box::pin(async move {
            let answer: Answer = answer.await;
            let answer = answer.as_deref().map_err(String::as_str);
            // A client that is gone needs no answer.
            answers.try_send(socket::answer(Some(number), answer)).ok();
        }));
    }
}

/// An update that cannot fail.
fn of<M>(
    update: impl FnOnce(&mut State, &M, i64),
) -> impl FnOnce(&mut State, &M, i64) -> Result<(), DropReason> {
    move |state, message, now_ns| {
        update(state, message, now_ns);
        Ok(())
    }
}
