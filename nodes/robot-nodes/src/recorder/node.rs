//! The recorder on the wire.

mod forward;
mod session;
mod topic_log;

use super::{
    lookup::{Lookups, UNDEFINED},
    losses::Loss,
    options::{Options, Parameters},
    selection::common_qos,
    writer::Entry,
};
use crate::{
    ending::Ending,
    keyboard::{Key, Keys},
};
use anyhow::Result;
use forward::{Announcement, Forward};
use session::Session;
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use tokio::sync::watch;
use tokio::task::JoinSet;
use topic_log::TopicLog;
use tracing::info;
use wm_bag::{QosProfile, Schema, definitions};
use wm_msgs::{
    builtin_interfaces::Time,
    rosbag2_interfaces::{
        Empty, IsPaused, IsPausedResponse, Pause, Record, RecordResponse, Resume, Snapshot,
        SplitBagfile, Stop, Success,
    },
};
use wm_ros::{
    Call, ChosenTopics, Durability, Node, NodeDefinition, NodeProgram, Qos, RawSubscription,
    Reliability, Requests, Service, Setup, TopicInfo, answer,
};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Recorder>();

/// Most topics in a bag: each has a queue in memory.
const MOST_TOPICS: usize = 2000;

wm_ros::endpoints! {
    /// Requests of rosbag2's services for recorders.
    enum Request {
        /// Pauses the recording.
        Pause(Service<Pause>) = "~/pause";
        /// Resumes the recording.
        Resume(Service<Resume>) = "~/resume";
        /// Whether the recording is paused.
        IsPaused(Service<IsPaused>) = "~/is_paused";
        /// Starts the bag's next file.
        SplitBagfile(Service<SplitBagfile>) = "~/split_bagfile";
        /// Starts another bag after ~/stop.
        Record(Service<Record>) = "~/record";
        /// Closes the bag.
        Stop(Service<Stop>) = "~/stop";
        /// Writes the messages in memory. Only in snapshot mode, as in rosbag2.
        Snapshot(Option<Service<Snapshot>>) = "~/snapshot", if(|node| node.parameter("snapshot_mode"));
    }
}

/// Records until a signal.
#[derive(Default)]
struct Recorder {
    session: Session,
    is_paused: Arc<AtomicBool>,
}

impl NodeProgram for Recorder {
    const NAME: &'static str = "recorder";
    const ABOUT: &'static str = "Records topics into a bag, as they appear.";
    const CHOSEN_TOPICS: ChosenTopics = ChosenTopics::Subscribed;
    const RUNS_ALONE: bool = true;
    const HAS_FIXED_ENDPOINTS: bool = false;
    type Parameters = Parameters;
    type Endpoints = Requests<Request>;
    type Resources = Options;
    type Error = anyhow::Error;

    async fn load(node: &Node, parameters: &Arc<Parameters>) -> Result<Options> {
        Options::new(parameters, node)
    }

    fn activate(_: &Setup<Self>) -> Result<Self> {
        Ok(Self::default())
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        let options = &at.resources;
        self.session.begin_first(options).await?;
        let mut keys = Keys::new(options.has_keyboard);
        if keys.are_read() {
            info!("space pauses and resumes");
        }
        if options.is_starting_paused {
            self.is_paused.store(true, Ordering::Relaxed);
            info!("paused until it is resumed");
        }
        let requests = &mut at.endpoints;
        while let Some(stop) = self.record(&at.node, options, requests, &mut keys).await? {
            self.session.end()?;
            self.session.wait_until_written().await;
            self.session.close()?;
            answer(stop, &Empty::default());
            if !self.wait_for_record(options, requests, &mut keys).await {
                break;
            }
        }
        Ok(())
    }

    /// Returns `DataLost` if messages are missing from the bag: dropped from a full queue, undecodable, or missing in
    /// their publishers' sequence numbers.
    fn finish(mut self, ended: Result<()>) -> Result<ExitCode> {
        // The bag is closed even after an error, so that the recorded messages can be read.
        self.session.end()?;
        self.session.close()?;
        ended?;
        Ok(Ending::lost_if(self.session.is_lossy).into())
    }
}

impl Recorder {
    /// Waits between two bags for a call of `~/record`; returns false at the shutdown.
    async fn wait_for_record(
        &mut self,
        options: &Options,
        requests: &mut Requests<Request>,
        keys: &mut Keys,
    ) -> bool {
        loop {
            let request = tokio::select! {
                request = requests.next_request() => request,
                key = keys.next() => {
                    self.press(key);
                    continue;
                }
            };
            match request {
                None => return false,
                Some(Request::Record(call)) => {
                    let begun = self.session.begin_further(options, &call.request.uri).await;
                    let error = begun.as_ref().err();
                    let response = RecordResponse {
                        return_code: error.is_some().into(),
                        // Empty on success, as in rosbag2.
                        error_string: error.map(shortened).unwrap_or_default(),
                    };
                    answer(call, &response);
                    if begun.is_ok() {
                        return true;
                    }
                }
                Some(Request::Stop(call)) => answer(call, &Empty::default()),
                Some(Request::Snapshot(call)) => answer(call, &Success { success: false }),
                Some(Request::SplitBagfile(call)) => answer(call, &Empty::default()),
                Some(other) => self.handle(other),
            }
        }
    }

    /// Records until the shutdown, or until a call of `~/stop`, which it returns. Counts losses in the bag's session.
    async fn record(
        &mut self,
        node: &Node,
        options: &Options,
        requests: &mut Requests<Request>,
        keys: &mut Keys,
    ) -> Result<Option<Call<Stop>>> {
        let Some(queue) = self.session.queue() else {
            return Ok(None);
        };
        let prefixes = definitions::prefixes();
        let shutdown = node.shutdown();
        let (end, _) = watch::channel(false);
        let mut types: BTreeMap<String, String> = BTreeMap::new();
        let mut topic_log = TopicLog::new(node.diagnostics());
        let (lookups, mut undefined) = Lookups::new(node);
        let mut topics = JoinSet::new();
        let mut changes = node.graph_changes();
        let clock = node.clock();
        // A simulated clock is at 0 until the first message on /clock: earlier messages would have no time.
        let mut has_time = !clock.is_simulated();
        let stop = loop {
            let is_selected = |topic: &TopicInfo| has_time && options.selection.wants(topic);
            for topic in node.topics().into_iter().filter(is_selected) {
                match types.get(&topic.name) {
                    Some(known) if *known == topic.type_name => continue,
                    Some(known) => {
                        topic_log.skipped(&topic, &format_args!("it is recorded as {known}"));
                        continue;
                    }
                    None if types.len() >= MOST_TOPICS => {
                        topic_log.skipped(
                            &topic,
                            &format_args!("{MOST_TOPICS} topics are already recorded"),
                        );
                        continue;
                    }
                    None => {}
                }
                let name: Arc<str> = topic.name.as_str().into();
                let overrides = &options.qos_overrides;
                let subscription = match subscribe(node, &topic, overrides)? {
                    Ok(subscription) => subscription,
                    // DDS allows more names than ROS.
                    Err(reason) => {
                        topic_log.skipped(&topic, &reason);
                        continue;
                    }
                };
                let candidates = definitions::candidates(&topic.type_name, &prefixes);
                let lookup = match candidates.is_empty() {
                    true => lookups.of(&topic),
                    false => None,
                };
                if lookup.is_none() {
                    report_definition(&topic.type_name, &candidates, &mut topic_log);
                }
                let announcement = Announcement {
                    topic: Arc::clone(&name),
                    type_name: topic.type_name.clone(),
                    candidates,
                    qos: profile(topic.publishers.first()),
                };
                types.insert(topic.name.clone(), topic.type_name.clone());
                topic_log.recorded(&topic.name);
                let loss = Arc::new(Loss::default());
                self.session.losses.insert(name.clone(), Arc::clone(&loss));
                let forward = Forward {
                    topic: name,
                    queue: queue.clone(),
                    is_paused: Arc::clone(&self.is_paused),
                    loss,
                    diagnostics: node.diagnostics(),
                };
                let end = end.subscribe();
                topics.spawn(forward.run(announcement, lookup, subscription, end));
            }
            topic_log.flush();
            tokio::select! {
                Ok(()) = changes.changed() => {}
                () = clock.sleep_until(Time { sec: 0, nanosec: 1 }), if !has_time => has_time = true,
                () = shutdown.wait() => break None,
                Some(ended) = topics.join_next() => {
                    ended??;
                }
                Some((type_name, reason)) = undefined.recv() => topic_log.undefined(&type_name, &reason),
                key = keys.next() => self.press(key),
                Some(request) = requests.next_request() => match request {
                    Request::Stop(call) => break Some(call),
                    Request::Record(call) => answer(call, &RecordResponse {
                        return_code: 1,
                        error_string: "a recording is already running".to_owned(),
                    }),
                    Request::Snapshot(call) => {
                        let success = queue.take_snapshot()?;
                        info!("snapshot {}", if success { "taken" } else { "refused: the previous snapshot is still being \
                                                                            written" });
                        answer(call, &Success { success });
                    }
                    Request::SplitBagfile(call) => {
                        queue.offer(Entry::Split)?;
                        answer(call, &Empty::default());
                    }
                    other => self.handle(other),
                },
            }
        };
        // Each task ends after its topic's last message.
        end.send_replace(true);
        while let Some(ended) = topics.join_next().await {
            ended??;
        }
        Ok(stop)
    }

    /// Handles the requests that do not depend on an open bag.
    fn handle(&self, request: Request) {
        match request {
            Request::Pause(call) => {
                self.set_paused(true);
                answer(call, &Empty::default());
            }
            Request::Resume(call) => {
                self.set_paused(false);
                answer(call, &Empty::default());
            }
            Request::IsPaused(call) => {
                let paused = self.is_paused.load(Ordering::Relaxed);
                answer(call, &IsPausedResponse { paused });
            }
            // `record` and `wait_for_record` handle these.
            Request::SplitBagfile(_)
            | Request::Record(_)
            | Request::Stop(_)
            | Request::Snapshot(_) => {}
        }
    }

    fn press(&self, key: Key) {
        if key == Key::Space {
            self.set_paused(!self.is_paused.load(Ordering::Relaxed));
        }
    }

    fn set_paused(&self, is_paused: bool) {
        self.is_paused.store(is_paused, Ordering::Relaxed);
        info!("{}", if is_paused { "paused" } else { "resumed" });
    }
}

/// The text of an error in an answer, which has to fit into a datagram.
fn shortened(error: &anyhow::Error) -> String {
    const LONGEST: usize = 400;
    format!("{error:#}").chars().take(LONGEST).collect()
}

/// Subscribes to a topic. The inner error is the reason why ROS does not allow its name.
fn subscribe(
    node: &Node,
    topic: &TopicInfo,
    qos_overrides: &BTreeMap<String, Qos>,
) -> Result<Result<RawSubscription, String>> {
    let qos = match qos_overrides.get(&topic.name) {
        Some(qos) => *qos,
        None => common_qos(&topic.publishers),
    };
    match node.raw_subscription(&topic.name, &topic.type_name, qos) {
        Ok(subscription) => Ok(Ok(subscription)),
        Err(wm_ros::Error::Name { kind, reason, .. }) => {
            Ok(Err(format!("not a valid {kind} name: {reason}")))
        }
        Err(error) => Err(error.into()),
    }
}

/// Reports a type without a definition or without a hash.
fn report_definition(type_name: &str, candidates: &[Schema], topic_log: &mut TopicLog) {
    match candidates.first().map(|schema| schema.type_hash(type_name)) {
        None => topic_log.undefined(type_name, UNDEFINED),
        Some(Err(error)) => {
            topic_log.undefined(type_name, &format!("is recorded without its hash: {error}"));
        }
        Some(Ok(_)) => {}
    }
}

/// The publisher's QoS in the bag's format.
fn profile(offered: Option<&Qos>) -> QosProfile {
    let Some(qos) = offered else {
        return QosProfile::reliable();
    };
    QosProfile {
        reliability: match qos.reliability {
            Reliability::BestEffort => wm_bag::Reliability::BestEffort,
            Reliability::Reliable => wm_bag::Reliability::Reliable,
        },
        durability: match qos.durability {
            Durability::Volatile => wm_bag::Durability::Volatile,
            Durability::TransientLocal => wm_bag::Durability::TransientLocal,
        },
        // 0 means the default. Queues of more than 32 bits do not exist.
        depth: u32::try_from(qos.depth).unwrap_or(0),
    }
}
