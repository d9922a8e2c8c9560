//! The player on the wire.

use super::{Settings, playlist::Playlist, restamp::restamp, schedule::Schedule};
use crate::ending::Ending;
use anyhow::Result;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, Interval, MissedTickBehavior};
use tracing::{error, info, warn};
use wm_bag::{BagError, BagMessage, BagReader};
use wm_msgs::{
    builtin_interfaces::Time, rosgraph_msgs::Clock, sensor_msgs::CompressedImage,
    wm_msgs::ActionChunk,
};
use wm_ros::{Node, NodeArgs, Publisher, Qos};

/// The node's default name.
pub const NAME: &str = "player";

/// How long the graph must not change before the first message, where others are waited for.
const QUIET: Duration = Duration::from_millis(500);

/// Time between two passes of restamped messages: longer than what the nodes take for a lost message, so that they see
/// that another episode begins.
const LOOP_PAUSE: Duration = Duration::from_millis(1500);

/// Messages read ahead of their time. Those of a camera take about 200 KB each.
const READ_AHEAD: usize = 64;

/// Runs the player until the bag's end or a signal. `Err` where it cannot begin, `DataLost` where parts of the bag
/// were unreadable or messages found no room in a publisher.
///
/// # Errors
/// Names what is wrong with arguments, parameters or the bag.
pub fn run(args: &NodeArgs) -> Result<Ending> {
    args.expect_no_rest()?;
    let mut ending = Ending::Complete;
    wm_ros::run(
        NAME,
        crate::NAMESPACE,
        args,
        async |node: Node| -> Result<()> {
            ending = play(&node).await?;
            Ok(())
        },
    )?;
    Ok(ending)
}

async fn play(node: &Node) -> Result<Ending> {
    let settings = Settings::declare(node)?;
    node.seal_parameters()?;
    let (reader, playlist) = {
        let (node, settings) = (node.clone(), settings.clone());
        tokio::task::spawn_blocking(move || open(&node, &settings)).await??
    };
    let mut player = Player::new(node, settings, reader, playlist)?;
    let shutdown = node.shutdown();
    tokio::select! {
        result = player.play() => result?,
        () = shutdown.wait() => info!("stopped before the bag's end"),
    }
    Ok(player.report())
}

fn open(node: &Node, settings: &Settings) -> Result<(BagReader, Playlist)> {
    let reader = BagReader::open(&settings.bag)?;
    for warning in reader.warnings() {
        warn!("{warning}");
    }
    let playlist = Playlist::new(&reader, settings, node)?;
    Ok((reader, playlist))
}

struct Player {
    node: Node,
    settings: Settings,
    reader: BagReader,
    playlist: Playlist,
    clock: Option<Publisher<Clock>>,
    chunks: Option<Publisher<ActionChunk>>,
    /// Kept to the end: who comes late still gets the goal.
    goal: Option<Publisher<CompressedImage>>,
    published: u64,
    unreadable: u64,
    kept_stamps: BTreeMap<Arc<str>, u64>,
    /// Messages that this middleware cannot send, by topic.
    left_out: BTreeMap<Arc<str>, u64>,
}

impl Player {
    fn new(node: &Node, settings: Settings, reader: BagReader, playlist: Playlist) -> Result<Self> {
        let clock = match settings.clock_hz > 0.0 {
            true => Some(node.publisher("/clock", Qos::best_effort(1))?),
            false => None,
        };
        let chunks = match &playlist.chunks {
            Some(_) => Some(node.publisher("action_chunk", Qos::reliable(10))?),
            None => None,
        };
        let goal = match &playlist.goal {
            Some(_) => Some(node.publisher("goal/image/compressed", Qos::latched(1))?),
            None => None,
        };
        Ok(Self {
            node: node.clone(),
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

    async fn play(&mut self) -> Result<()> {
        self.wait_for_others().await;
        // asked for by the user
        tokio::time::sleep(self.settings.delay).await;
        let start_ns = self.settings.start_ns(&self.reader);
        let end_ns = self.reader.end_ns();
        let seconds = end_ns.saturating_sub(start_ns) as f64 / 1e9;
        info!(
            "playing {} ({seconds:.1} s at rate {})",
            self.settings.bag.display(),
            self.settings.rate
        );
        loop {
            self.play_pass(Schedule::new(start_ns, self.settings.rate), start_ns)
                .await?;
            if !self.settings.is_looping || end_ns <= start_ns {
                break;
            }
            if self.settings.is_restamping {
                tokio::time::sleep(LOOP_PAUSE).await;
            }
            info!("beginning again");
        }
        tokio::time::sleep(self.settings.linger).await;
        Ok(())
    }

    /// Waits, but not for ever, until the topics named in `wait_for` have a publisher and a subscriber.
    async fn wait_for_others(&self) {
        if self.settings.wait_for.is_empty() {
            return;
        }
        let missing = || {
            let mut missing = Vec::new();
            for topic in &self.settings.wait_for {
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
        if tokio::time::timeout(self.settings.wait_timeout, all_there)
            .await
            .is_err()
        {
            let waited = self.settings.wait_timeout.as_secs_f64();
            match missing().as_slice() {
                [] => warn!("beginning after {waited:.1} s although the graph still changes"),
                missing => warn!(
                    "beginning after {waited:.1} s without {}",
                    missing.join(", ")
                ),
            }
        }
    }

    async fn play_pass(&mut self, schedule: Schedule, start_ns: u64) -> Result<()> {
        let mut messages = read_ahead(&self.reader, start_ns);
        let begin = Instant::now();
        let wall_start_ns = self.node.now().to_nanos();
        let is_restamping = self.settings.is_restamping;
        let map = |stamp_ns| {
            if is_restamping {
                schedule.restamped_ns(stamp_ns, wall_start_ns)
            } else {
                stamp_ns
            }
        };
        // before what is of the new pass: nodes that follow it forget the old one first
        self.publish_clock(schedule.bag_time_ns(Duration::ZERO))?;
        self.publish_goal(map)?;
        // before the first frame, which would find no chunk otherwise
        self.publish_chunk(0, map)?;
        let mut next_chunk = 0;
        let mut ticks = self.clock_ticks();
        while let Some(message) = messages.recv().await {
            let message = match message {
                Ok(message) => message,
                Err(problem) => {
                    error!("{problem}");
                    self.unreadable += 1;
                    continue;
                }
            };
            let due = begin + schedule.due(message.log_time_ns);
            while due > Instant::now() {
                tokio::select! {
                    () = tokio::time::sleep_until(due) => break,
                    () = tick(&mut ticks) => self.publish_clock(schedule.bag_time_ns(begin.elapsed()))?,
                }
            }
            if message.topic.as_ref() == self.settings.action_topic {
                self.publish_chunk(next_chunk, map)?;
                next_chunk += 1;
            }
            self.publish(&message, map)?;
        }
        Ok(())
    }

    fn publish(&mut self, message: &BagMessage, map: impl Fn(i64) -> i64) -> Result<()> {
        let Some(track) = self.playlist.tracks.get(&message.topic) else {
            return Ok(());
        };
        let mut data = message.data.clone();
        if track.is_restamped {
            match restamp(&data, map) {
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
        match track.publisher.publish(data) {
            Ok(()) => self.published += 1,
            // one recorder's odd sample is no reason to stop the others
            Err(problem @ wm_ros::Error::Representation { .. }) => {
                let left_out = self.left_out.entry(message.topic.clone()).or_default();
                if *left_out == 0 {
                    error!("{}: message left out: {problem}", message.topic);
                }
                *left_out += 1;
            }
            Err(problem) => return Err(problem.into()),
        }
        Ok(())
    }

    /// Publishes the chunk of action `index`.
    fn publish_chunk(&self, index: usize, map: impl Fn(i64) -> i64) -> Result<()> {
        if let (Some(publisher), Some(chunks)) = (&self.chunks, &self.playlist.chunks) {
            let rate = if self.settings.is_restamping {
                self.settings.rate
            } else {
                1.0
            };
            if let Some(chunk) = chunks.chunk(index, rate, map) {
                publisher.publish(&chunk)?;
            }
        }
        Ok(())
    }

    fn publish_goal(&self, map: impl Fn(i64) -> i64) -> Result<()> {
        if let (Some(publisher), Some(goal)) = (&self.goal, &self.playlist.goal) {
            let mut goal = goal.clone();
            goal.header.stamp = Time::from_nanos(map(goal.header.stamp.to_nanos()));
            publisher.publish(&goal)?;
        }
        Ok(())
    }

    fn clock_ticks(&self) -> Option<Interval> {
        self.clock.as_ref()?;
        let mut ticks =
            tokio::time::interval(Duration::from_secs_f64(1.0 / self.settings.clock_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        Some(ticks)
    }

    fn publish_clock(&self, bag_time_ns: u64) -> Result<()> {
        if let Some(clock) = &self.clock {
            let time_ns = i64::try_from(bag_time_ns).unwrap_or(i64::MAX);
            clock.publish(&Clock {
                clock: Time::from_nanos(time_ns),
            })?;
        }
        Ok(())
    }

    /// Says what was lost, topic by topic.
    fn report(&self) -> Ending {
        let mut is_lost = self.unreadable > 0 || self.reader.truncated();
        for (topic, messages) in &self.left_out {
            warn!("{topic}: {messages} message(s) left out: not in a form that can be sent");
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
                "{} unreadable part(s) of the bag were left out",
                self.unreadable
            );
        }
        if self.reader.truncated() {
            warn!("the bag ends early: it was cut off while it was recorded or copied");
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

/// Reads the bag on a thread of its own, so that the disk does not delay a message that is due.
fn read_ahead(reader: &BagReader, start_ns: u64) -> mpsc::Receiver<Result<BagMessage, BagError>> {
    let messages = reader.messages().starting_at(start_ns);
    let (sender, receiver) = mpsc::channel(READ_AHEAD);
    tokio::task::spawn_blocking(move || {
        for message in messages {
            // the player is gone
            if sender.blocking_send(message).is_err() {
                break;
            }
        }
    });
    receiver
}
