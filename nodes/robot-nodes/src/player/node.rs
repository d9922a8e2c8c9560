//! The player's ROS interface.

mod control;
mod publication;
mod wait;

use super::{
    Settings,
    playback::{Playback, Step},
    playlist::Playlist,
    settings::{Parameters, has_clock},
    source::{BufferedMessage, Source},
};
use crate::{ending::Ending, keyboard::Keys};
use anyhow::Result;
use control::BurstOrder;
use std::collections::{BTreeMap, HashSet, VecDeque};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use tracing::{error, info, warn};
use wait::{sleep_until, tick};
use wm_bag::{BagReader, BagWarning};
use wm_msgs::{
    rosbag2_interfaces::{
        Burst, GetRate, IsPaused, Pause, Play, PlayNext, Resume, Seek, SetRate, Stop, TogglePaused,
    },
    rosgraph_msgs::Clock,
    sensor_msgs::CompressedImage,
    wm_msgs::ActionChunk,
};
use wm_ros::{
    ChosenTopics, Node, NodeDefinition, NodeProgram, Publisher, Qos, Requests, Service, Setup,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<PlayerProgram>();

wm_ros::endpoints! {
    /// Topics beside the bag's, and services.
    struct Endpoints {
        /// Published topics.
        outlets: Outlets;
        /// Requests of clients.
        requests: Requests<Request>;
    }
}

wm_ros::endpoints! {
    /// Topics beside the bag's.
    struct Outlets {
        /// The bag's time, with the parameters clock, clock_topics and clock_topics_all.
        clock: Option<Publisher<Clock>> = "/clock", qos(Qos::best_effort(1)), if(has_clock);
        /// The next actions of the bag, with action_chunk_length.
        chunks: Option<Publisher<ActionChunk>> = "action_chunk",
            if(|node| Ok(node.parameter::<i64>("action_chunk_length")? > 0));
        /// The last frame of the bag, with goal.
        goal: Option<Publisher<CompressedImage>> = "goal/image/compressed", qos(Qos::latched(1)),
            if(|node| node.parameter("goal"));
    }
}

wm_ros::endpoints! {
    /// Requests of rosbag2's services for players.
    enum Request {
        /// Pauses the playback.
        Pause(Service<Pause>) = "~/pause";
        /// Resumes the playback.
        Resume(Service<Resume>) = "~/resume";
        /// Pauses or resumes the playback.
        TogglePaused(Service<TogglePaused>) = "~/toggle_paused";
        /// Whether the playback is paused.
        IsPaused(Service<IsPaused>) = "~/is_paused";
        /// Playback rate: seconds of the bag per second.
        GetRate(Service<GetRate>) = "~/get_rate";
        /// Sets the playback rate.
        SetRate(Service<SetRate>) = "~/set_rate";
        /// Plays the next message of a paused playback.
        PlayNext(Service<PlayNext>) = "~/play_next";
        /// Plays the next messages of a paused playback.
        Burst(Service<Burst>) = "~/burst";
        /// Jumps to a time of the bag.
        Seek(Service<Seek>) = "~/seek";
        /// Starts a new playback, from the beginning or of a part.
        Play(Service<Play>) = "~/play";
        /// Ends the playback.
        Stop(Service<Stop>) = "~/stop";
    }
}

/// Plays until the bag's end or a signal.
struct PlayerProgram {
    /// `DataLost` if parts of the bag were unreadable, or a publisher dropped messages.
    ending: Ending,
}

/// An open bag, and what is played of it.
struct Bag {
    settings: Settings,
    reader: Arc<BagReader>,
    playlist: Playlist,
}

impl NodeProgram for PlayerProgram {
    const NAME: &'static str = "player";
    const ABOUT: &'static str = "Plays a bag's messages at their times.";
    const CHOSEN_TOPICS: ChosenTopics = ChosenTopics::Published;
    const RUNS_ALONE: bool = true;
    type Parameters = Parameters;
    type Endpoints = Endpoints;
    type Resources = Bag;
    type Error = anyhow::Error;

    async fn load(node: &Node, parameters: &Arc<Parameters>) -> Result<Bag> {
        let settings = Settings::new(Arc::clone(parameters))?;
        let node = node.clone();
        let open = move || -> Result<Bag> {
            let reader = BagReader::open(&settings.parameters.bag)?;
            for warning in reader.warnings() {
                warn!("{warning}");
            }
            let playlist = Playlist::new(&reader, &settings, &node)?;
            Ok(Bag {
                settings,
                reader: Arc::new(reader),
                playlist,
            })
        };
        tokio::task::spawn_blocking(open).await?
    }

    fn activate(_: &Setup<Self>) -> Result<Self> {
        let ending = Ending::Complete;
        Ok(Self { ending })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let Endpoints { outlets, requests } = &mut at.endpoints;
        let mut player = Player::new(&at.node, &at.resources, outlets);
        let shutdown = at.node.shutdown();
        tokio::select! {
            result = player.play(requests) => result?,
            () = shutdown.wait() => info!("stopped before the end of the bag"),
        }
        self.ending = player.report();
        Ok(())
    }

    fn finish(self, ended: Result<()>) -> Result<ExitCode> {
        ended.map(|()| self.ending.into())
    }
}

struct Player<'a> {
    node: &'a Node,
    settings: &'a Settings,
    reader: &'a Arc<BagReader>,
    playlist: &'a Playlist,
    /// Kept to the end, so that late joiners receive the goal.
    outlets: &'a Outlets,
    playback: Playback,
    /// Moment zero of the playback, and the node's time at that moment \[ns\], from the last start.
    epoch: Instant,
    epoch_ns: i64,
    source: Source,
    /// The next message; `None` while the source reads it, and at the end.
    next: Option<BufferedMessage>,
    is_read_to_the_end: bool,
    /// Whether no message was read since the last jump.
    is_at_a_jump: bool,
    /// Bursts in the order of their requests. The messages of the first one are being published.
    bursts: VecDeque<BurstOrder>,
    published: u64,
    unreadable: u64,
    kept_stamps: BTreeMap<Arc<str>, u64>,
    /// Messages that this middleware cannot send, by topic.
    dropped: BTreeMap<Arc<str>, u64>,
}

impl<'a> Player<'a> {
    fn new(node: &'a Node, bag: &'a Bag, outlets: &'a Outlets) -> Self {
        let Bag {
            settings,
            reader,
            playlist,
        } = bag;
        let plan = settings.plan(reader);
        let source = open_source(reader, playlist, settings, plan.start_ns);
        let (rate, is_paused) = (
            settings.parameters.rate,
            settings.parameters.is_starting_paused,
        );
        Self {
            node,
            settings,
            reader,
            playlist,
            outlets,
            playback: Playback::new(plan, rate, is_paused, Duration::ZERO),
            epoch: Instant::now(),
            epoch_ns: 0,
            source,
            next: None,
            is_read_to_the_end: false,
            is_at_a_jump: true,
            bursts: VecDeque::new(),
            published: 0,
            unreadable: 0,
            kept_stamps: BTreeMap::new(),
            dropped: BTreeMap::new(),
        }
    }

    async fn play(&mut self, requests: &mut Requests<Request>) -> Result<()> {
        self.wait_for_others().await;
        let mut keys = Keys::new(self.settings.has_keyboard());
        if keys.are_read() {
            info!(
                "keys: space pauses and resumes, right plays the next message, up and down change the rate"
            );
        }
        let plan = self.settings.plan(self.reader);
        self.epoch = Instant::now();
        info!(
            "playing {} ({:.1} s at rate {}){}",
            self.settings.parameters.bag.display(),
            plan.last_ns.saturating_sub(plan.start_ns) as f64 / 1e9,
            self.settings.parameters.rate,
            if self.playback.is_paused() {
                ", paused"
            } else {
                ""
            }
        );
        let mut ticks = self.clock_ticks();
        let mut ended = None;
        loop {
            if self.playback.is_playing() && self.next.is_none() && !self.is_read_to_the_end {
                tokio::select! {
                    next = self.source.next() => self.take(next),
                    Some(request) = requests.next_request() => self.handle(request),
                    key = keys.next() => self.press(key),
                    () = tick(&mut ticks) => self.publish_time()?,
                }
                self.answer_bursts();
                continue;
            }
            let next_ns = self
                .next
                .as_ref()
                .and_then(|next| next.message.as_ref().ok());
            let next_ns = next_ns.map(|message| message.log_time_ns);
            let step = self.playback.step(self.epoch.elapsed(), next_ns);
            if step != Step::Ended {
                ended = None;
            }
            let until = match step {
                Step::Wait(until) => until.map(|until| self.epoch + until),
                Step::Ended => {
                    let ended = *ended.get_or_insert_with(Instant::now);
                    Some(ended + self.settings.parameters.linger)
                }
                Step::Begin(bag_ns) => {
                    self.begin(bag_ns)?;
                    continue;
                }
                Step::Publish => {
                    self.publish_next()?;
                    continue;
                }
                Step::Jump { from_ns, to_ns } => {
                    let seconds = (to_ns - from_ns) as f64 / 1e9;
                    warn!(
                        "skipped a gap of {seconds:.1} s without messages, from {:.3} to {:.3}",
                        from_ns as f64 / 1e9,
                        to_ns as f64 / 1e9
                    );
                    continue;
                }
                Step::Rewind(bag_ns) => {
                    info!("starting again");
                    self.read_from(bag_ns);
                    continue;
                }
            };
            self.answer_bursts();
            tokio::select! {
                () = sleep_until(until) => if step == Step::Ended { break },
                Some(request) = requests.next_request() => self.handle(request),
                key = keys.next() => self.press(key),
                () = tick(&mut ticks) => self.publish_time()?,
            }
        }
        self.wait_for_acknowledgments().await
    }

    fn read_from(&mut self, bag_ns: u64) {
        self.source = open_source(self.reader, self.playlist, self.settings, bag_ns);
        self.next = None;
        self.is_read_to_the_end = false;
        self.is_at_a_jump = true;
    }

    fn take(&mut self, next: Option<BufferedMessage>) {
        // The search for latched messages takes time. It delays only the first message.
        if std::mem::take(&mut self.is_at_a_jump) {
            self.playback.begin_late(self.epoch.elapsed());
        }
        match next {
            None => self.is_read_to_the_end = true,
            Some(next) => match &next.message {
                Ok(_) => self.next = Some(next),
                Err(problem) => {
                    error!("{problem}");
                    self.unreadable += 1;
                }
            },
        }
    }

    /// Logs the losses of each topic.
    fn report(&self) -> Ending {
        let is_incomplete = self.reader.warnings().iter().any(BagWarning::is_loss);
        let mut is_lost = self.unreadable > 0 || is_incomplete;
        for (topic, messages) in &self.dropped {
            warn!(
                "{topic}: {messages} message(s) dropped: they are not in a format that can be sent"
            );
            is_lost = true;
        }
        for (topic, track) in &self.playlist.tracks {
            let dropped = track.publisher.dropped();
            if dropped > 0 {
                warn!("{topic}: {dropped} message(s) not sent: a subscriber did not keep up");
                is_lost = true;
            }
        }
        if self.unreadable > 0 {
            warn!(
                "{} unreadable part(s) of the bag were skipped",
                self.unreadable
            );
        }
        if self.reader.truncated() {
            warn!("the bag ends early: it was truncated while it was recorded or copied");
        }
        info!("played {} message(s)", self.published);
        Ending::lost_if(is_lost)
    }
}

/// Reads from this log time on. The latched messages that are valid at this time come first.
fn open_source(
    reader: &Arc<BagReader>,
    playlist: &Playlist,
    settings: &Settings,
    from_ns: u64,
) -> Source {
    let topics: HashSet<Arc<str>> = playlist.tracks.keys().cloned().collect();
    let messages = reader.messages().only_topics(&topics).starting_at(from_ns);
    let reader = Arc::clone(reader);
    let latched = std::iter::once_with(move || {
        if from_ns <= reader.start_ns() {
            return (Vec::new(), Vec::new());
        }
        reader.latched_before(from_ns, |topic| topics.contains(&topic.name))
    });
    let latched = latched.flat_map(|(messages, unreadable)| {
        let unreadable = unreadable.into_iter().map(Err);
        unreadable.chain(messages.into_iter().map(Ok))
    });
    Source::open(latched.chain(messages), settings.parameters.read_ahead)
}
