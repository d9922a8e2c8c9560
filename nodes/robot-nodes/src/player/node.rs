//! The player on the wire.

mod command;
mod control;

use super::{
    Settings,
    playback::{Playback, Step},
    playlist::Playlist,
    settings::Parameters,
    source::{Ahead, Source},
};
use crate::{ending::Ending, keyboard::Keyboard};
use anyhow::Result;
use command::Command;
use control::Asked;
use std::collections::{BTreeMap, HashSet, VecDeque};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, Interval, MissedTickBehavior};
use tracing::{error, info, warn};
use wm_bag::{BagMessage, BagReader, BagWarning};
use wm_msgs::{
    builtin_interfaces::Time, rosgraph_msgs::Clock, sensor_msgs::CompressedImage,
    wm_msgs::ActionChunk,
};
use wm_ros::calls::Calls;
use wm_ros::{
    Direction, EndpointSet as _, EndpointSpec, Node, NodeArgs, NodeDefinition, ParameterSet as _,
    Publisher, Qos, frame_trace,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: "player",
    about: "Plays a bag's messages at their times.",
    parameters: Parameters::specs,
    endpoints,
    is_managed: false,
    run: |args| run(args).map(ExitCode::from),
    component: None,
};

/// Beside the bag's topics, where they are wanted: name and QoS.
const CLOCK: (&str, Qos) = ("/clock", Qos::best_effort(1));
const CHUNKS: (&str, Qos) = ("action_chunk", Qos::reliable(10));
const GOAL: (&str, Qos) = ("goal/image/compressed", Qos::latched(1));

fn endpoints() -> Vec<EndpointSpec> {
    let published = Direction::Published;
    let mut specs = vec![
        EndpointSpec::topic::<Clock>(
            published,
            CLOCK.0,
            CLOCK.1,
            "The bag's time, with the parameters clock, clock_topics and clock_topics_all.",
        ),
        EndpointSpec::topic::<ActionChunk>(
            published,
            CHUNKS.0,
            CHUNKS.1,
            "The next actions of the bag, with action_chunk_length.",
        ),
        EndpointSpec::topic::<CompressedImage>(
            published,
            GOAL.0,
            GOAL.1,
            "The last frame of the bag, with goal.",
        ),
    ];
    specs.extend(command::Services::specs());
    specs
}

/// How long the graph must not change before the first message, where others are waited for.
const QUIET: Duration = Duration::from_millis(500);

/// Runs the player until the bag's end or a signal. `Err` where it cannot begin, `DataLost` where parts of the bag
/// were unreadable or messages found no room in a publisher.
///
/// # Errors
/// Names what is wrong with arguments, parameters or the bag.
pub fn run(args: &NodeArgs) -> Result<Ending> {
    args.expect_no_rest()?;
    let mut ending = Ending::Complete;
    wm_ros::run(
        NODE.name,
        wm_ros::NAMESPACE,
        args,
        async |node: Node| -> Result<()> {
            ending = body(node).await?;
            Ok(())
        },
    )?;
    Ok(ending)
}

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// As [`run`].
pub async fn body(node: Node) -> Result<Ending> {
    let node = &node;
    let settings = Settings::declare(node)?;
    let (reader, playlist) = {
        let (node, settings) = (node.clone(), settings.clone());
        tokio::task::spawn_blocking(move || open(&node, &settings)).await??
    };
    let mut calls = command::serve(node)?;
    let mut player = Player::new(node, settings, reader, playlist)?;
    node.seal_endpoints()?;
    let shutdown = node.shutdown();
    tokio::select! {
        result = player.play(&mut calls) => result?,
        () = shutdown.wait() => info!("stopped before the end of the bag"),
    }
    Ok(player.report())
}

fn open(node: &Node, settings: &Settings) -> Result<(BagReader, Playlist)> {
    let reader = BagReader::open(&settings.parameters.bag)?;
    for warning in reader.warnings() {
        warn!("{warning}");
    }
    let playlist = Playlist::new(&reader, settings, node)?;
    Ok((reader, playlist))
}

struct Player {
    node: Node,
    settings: Settings,
    reader: Arc<BagReader>,
    playlist: Playlist,
    clock: Option<Publisher<Clock>>,
    chunks: Option<Publisher<ActionChunk>>,
    /// Kept to the end: late joiners still get the goal.
    goal: Option<Publisher<CompressedImage>>,
    playback: Playback,
    /// The moment zero of the playback, and the node's time then \[ns\], as it was when playing began last.
    epoch: Instant,
    epoch_ns: i64,
    source: Source,
    /// The next message; none where the source has yet to be asked for it, or has none.
    next: Option<Ahead>,
    is_read_to_the_end: bool,
    /// Whether no message has been read since the last jump.
    is_at_a_jump: bool,
    /// The first is being published.
    asked: VecDeque<Asked>,
    published: u64,
    unreadable: u64,
    kept_stamps: BTreeMap<Arc<str>, u64>,
    /// Messages that this middleware cannot send, by topic.
    left_out: BTreeMap<Arc<str>, u64>,
}

impl Player {
    fn new(node: &Node, settings: Settings, reader: BagReader, playlist: Playlist) -> Result<Self> {
        let clock = match settings.has_clock() {
            true => Some(node.publisher(CLOCK.0, CLOCK.1)?),
            false => None,
        };
        let chunks = match &playlist.chunks {
            Some(_) => Some(node.publisher(CHUNKS.0, CHUNKS.1)?),
            None => None,
        };
        let goal = match &playlist.goal {
            Some(_) => Some(node.publisher(GOAL.0, GOAL.1)?),
            None => None,
        };
        let reader = Arc::new(reader);
        let plan = settings.plan(&reader);
        let source = open_source(&reader, &playlist, &settings, plan.start_ns);
        Ok(Self {
            node: node.clone(),
            playback: Playback::new(
                plan,
                settings.parameters.rate,
                settings.parameters.is_starting_paused,
                Duration::ZERO,
            ),
            epoch: Instant::now(),
            epoch_ns: 0,
            source,
            next: None,
            is_read_to_the_end: false,
            is_at_a_jump: true,
            asked: VecDeque::new(),
            settings,
            reader,
            playlist,
            clock,
            chunks,
            goal,
            published: 0,
            unreadable: 0,
            kept_stamps: BTreeMap::new(),
            left_out: BTreeMap::new(),
        })
    }

    async fn play(&mut self, calls: &mut Calls<Command>) -> Result<()> {
        self.wait_for_others().await;
        let keys = calls.sender();
        // a key that finds the queue full is pressed again
        let on_key = move |key| drop(keys.try_send(Command::Key(key)));
        let has_keyboard = self.settings.has_keyboard();
        let keyboard = has_keyboard.then(|| Keyboard::listen(on_key)).flatten();
        if keyboard.is_some() {
            info!(
                "keys: space pauses and resumes, right plays the next message, up and down change the rate"
            );
        }
        let plan = self.settings.plan(&self.reader);
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
                    command = calls.next() => self.obey(command),
                    () = tick(&mut ticks) => self.tell_time()?,
                }
                self.answer_who_asked();
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
            self.answer_who_asked();
            tokio::select! {
                () = sleep_until(until) => if step == Step::Ended { break },
                command = calls.next() => self.obey(command),
                () = tick(&mut ticks) => self.tell_time()?,
            }
        }
        self.wait_for_acknowledgments().await
    }

    /// Waits, but not for ever, until the topics named in `wait_for` have a publisher and a subscriber.
    async fn wait_for_others(&self) {
        if self.settings.parameters.wait_for.is_empty() {
            return;
        }
        let missing = || {
            let mut missing = Vec::new();
            for topic in &self.settings.parameters.wait_for {
                match (
                    self.node.count_publishers(topic),
                    self.node.count_subscribers(topic),
                ) {
                    (Ok(0), _) => missing.push(format!("a publisher of {topic}")),
                    (_, Ok(0)) => missing.push(format!("a subscriber of {topic}")),
                    (Err(problem), _) | (_, Err(problem)) => missing.push(problem.to_string()),
                    _ => {}
                }
            }
            missing
        };
        let mut changes = self.node.graph_changes();
        let all_there = async {
            while !missing().is_empty() {
                // an error means that the graph is gone; the timeout, or the shutdown, ends the wait then
                if changes.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
            }
            // a topic may have further subscribers, and what is here has yet to see us: a node makes its endpoints
            // one after another, so a graph that is quiet is a graph that is whole
            while let Ok(Ok(())) = tokio::time::timeout(QUIET, changes.changed()).await {}
        };
        if tokio::time::timeout(self.settings.parameters.wait_timeout, all_there)
            .await
            .is_err()
        {
            let waited = self.settings.parameters.wait_timeout.as_secs_f64();
            match missing().as_slice() {
                [] => warn!("starting after {waited:.1} s although the graph is still changing"),
                missing => warn!(
                    "starting after {waited:.1} s without {}",
                    missing.join(", ")
                ),
            }
        }
    }

    /// Waits until reliable subscribers have everything, where that is wanted.
    async fn wait_for_acknowledgments(&self) -> Result<()> {
        let Some(limit) = self.settings.acknowledgment() else {
            return Ok(());
        };
        let begin = Instant::now();
        for (topic, track) in &self.playlist.tracks {
            let left = limit.saturating_sub(begin.elapsed());
            if track.is_reliable && !track.publisher.wait_for_acknowledgments(left).await? {
                warn!(
                    "{topic}: not all subscribers have acknowledged all messages after {:.1} s",
                    limit.as_secs_f64()
                );
            }
        }
        Ok(())
    }

    fn read_from(&mut self, bag_ns: u64) {
        self.source = open_source(&self.reader, &self.playlist, &self.settings, bag_ns);
        self.next = None;
        self.is_read_to_the_end = false;
        self.is_at_a_jump = true;
    }

    fn take(&mut self, next: Option<Ahead>) {
        // The search for latched messages may take a while: it delays the first message only.
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

    /// What comes before the messages from this log time on.
    fn begin(&mut self, bag_ns: u64) -> Result<()> {
        // at most the time since the system's start
        let elapsed_ns = i64::try_from(self.epoch.elapsed().as_nanos()).unwrap_or(i64::MAX);
        self.epoch_ns = self.node.now().to_nanos().saturating_sub(elapsed_ns);
        // before what follows: nodes that follow the clock forget the old time first
        if self.settings.parameters.clock_hz > 0.0 {
            self.publish_clock(bag_ns)?;
        }
        self.publish_goal()?;
        // before the first frame, which would find no chunk otherwise
        self.publish_chunk(bag_ns)
    }

    fn publish_next(&mut self) -> Result<()> {
        let Some(Ahead {
            message: Ok(message),
            ..
        }) = self.next.take()
        else {
            return Ok(());
        };
        if let Some(asked) = self.asked.front_mut() {
            asked.published += 1;
        }
        if message.topic.as_ref() == self.settings.parameters.action_topic {
            self.publish_chunk(message.log_time_ns)?;
        }
        self.publish(&message)
    }

    /// The stamp that replaces `stamp_ns` of the bag.
    fn stamp_ns(&self, stamp_ns: i64) -> i64 {
        if self.settings.parameters.is_restamping {
            self.epoch_ns
                .saturating_add(self.playback.moment_ns(stamp_ns))
        } else {
            stamp_ns
        }
    }

    fn publish(&mut self, message: &BagMessage) -> Result<()> {
        let Some(track) = self.playlist.tracks.get(&message.topic) else {
            return Ok(());
        };
        let mut data = message.data.clone();
        let mut frame = None;
        if let Some(stamped) = track.stamped {
            let moved = stamped.restamp(&data, |stamp_ns| {
                let moved_ns = self.stamp_ns(stamp_ns);
                frame = track.is_camera.then(|| Time::from_nanos(moved_ns));
                moved_ns
            });
            match moved {
                Ok(moved) => data = moved,
                Err(problem) => {
                    let kept = self.kept_stamps.entry(message.topic.clone()).or_default();
                    if *kept == 0 {
                        warn!("{}: stamp kept: {problem}", message.topic);
                    }
                    *kept += 1;
                }
            }
        }
        let (publisher, is_clocked) = (track.publisher.clone(), track.is_clocked);
        if is_clocked {
            self.publish_clock(message.log_time_ns)?;
        }
        if let Some(frame) = frame {
            frame_trace::passed("image due", frame);
        }
        let published = publisher.publish(data);
        if let Some(frame) = frame {
            frame_trace::passed("image published", frame);
        }
        match published {
            Ok(()) => self.published += 1,
            // one recorder's odd sample is no reason to stop the others
            Err(problem @ wm_ros::Error::Representation { .. }) => {
                let left_out = self.left_out.entry(message.topic.clone()).or_default();
                if *left_out == 0 {
                    error!("{}: message dropped: {problem}", message.topic);
                }
                *left_out += 1;
            }
            Err(problem) => return Err(problem.into()),
        }
        Ok(())
    }

    /// Publishes the chunk of the first action at or after this log time.
    fn publish_chunk(&self, log_time_ns: u64) -> Result<()> {
        if let (Some(publisher), Some(chunks)) = (&self.chunks, &self.playlist.chunks) {
            let rate = if self.settings.parameters.is_restamping {
                self.playback.rate()
            } else {
                1.0
            };
            let chunk = chunks.chunk(log_time_ns, rate, |stamp_ns| self.stamp_ns(stamp_ns));
            if let Some(chunk) = chunk {
                publisher.publish(&chunk)?;
            }
        }
        Ok(())
    }

    fn publish_goal(&self) -> Result<()> {
        if let (Some(publisher), Some(goal)) = (&self.goal, &self.playlist.goal) {
            let mut goal = goal.clone();
            goal.header.stamp = Time::from_nanos(self.stamp_ns(goal.header.stamp.to_nanos()));
            publisher.publish(&goal)?;
        }
        Ok(())
    }

    fn clock_ticks(&self) -> Option<Interval> {
        if self.settings.parameters.clock_hz <= 0.0 {
            return None;
        }
        let mut ticks = tokio::time::interval(Duration::from_secs_f64(
            1.0 / self.settings.parameters.clock_hz,
        ));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        Some(ticks)
    }

    fn tell_time(&mut self) -> Result<()> {
        let position_ns = self.playback.position_ns(self.epoch.elapsed());
        self.publish_clock(position_ns)
    }

    fn publish_clock(&mut self, bag_ns: u64) -> Result<()> {
        if let Some(clock) = &self.clock
            && let Some(clock_ns) = self.playback.clock_ns(bag_ns)
        {
            let time_ns = i64::try_from(clock_ns).unwrap_or(i64::MAX);
            clock.publish(&Clock {
                clock: Time::from_nanos(time_ns),
            })?;
        }
        Ok(())
    }

    /// Says what was lost, topic by topic.
    fn report(&self) -> Ending {
        let is_incomplete = self.reader.warnings().iter().any(BagWarning::is_loss);
        let mut is_lost = self.unreadable > 0 || is_incomplete;
        for (topic, messages) in &self.left_out {
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

/// The next tick of the clock; never where there is none.
async fn tick(ticks: &mut Option<Interval>) {
    match ticks {
        Some(ticks) => {
            ticks.tick().await;
        }
        None => std::future::pending().await,
    }
}

/// tokio's timers count whole milliseconds and end after the moment: the thread itself sleeps the last ones, so that a
/// frame leaves at the time of its stamp.
const TIMER_STEPS: Duration = Duration::from_millis(2);

async fn sleep_until(moment: Option<Instant>) {
    let Some(moment) = moment else {
        return std::future::pending().await;
    };
    if let Some(early) = moment.checked_sub(TIMER_STEPS) {
        tokio::time::sleep_until(early).await;
    }
    std::thread::sleep(moment.saturating_duration_since(Instant::now()));
}

/// Reads from this log time on. The latched messages that are valid then come first.
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
