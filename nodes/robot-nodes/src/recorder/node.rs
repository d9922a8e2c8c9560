//! The recorder on the wire.

mod book;
mod command;
mod forward;
mod news;

use super::{
    lookup::{Lookups, UNDEFINED},
    losses::Loss,
    options::{Options, Parameters},
    selection::common_qos,
    writer::Entry,
};
use crate::{
    ending::Ending,
    keyboard::{Key, Keyboard},
};
use anyhow::Result;
use book::Book;
use command::Command;
use forward::{Announcement, Forward};
use news::News;
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tracing::info;
use wm_bag::{QosProfile, Schema, definitions};
use wm_msgs::{
    builtin_interfaces::Time,
    rosbag2_interfaces::{Empty, IsPausedResponse, RecordResponse, Stop, Success},
};
use wm_ros::{
    Call, Durability, EndpointSet as _, Node, NodeArgs, NodeDefinition, ParameterSet as _, Qos,
    RawSubscription, Reliability, TopicInfo,
};
use wm_ros::{calls::Calls, calls::answer};

/// The node.
pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition {
    name: "recorder",
    about: "Records topics into a bag, as they appear.",
    parameters: Parameters::specs,
    endpoints: command::Services::specs,
    is_managed: false,
    run: |args| run(args).map(ExitCode::from),
    component: None,
};

/// More topics than this are not recorded: whoever makes so many does not mean well, and each has a queue.
const MOST_TOPICS: usize = 2000;

/// Records until a signal. `DataLost` if messages are missing from the bag: those dropped from a full queue, those that
/// could not be decoded, and those that are missing in their publishers' sequence numbers.
///
/// # Errors
/// Names what is wrong with arguments or parameters, or why the bag cannot be written.
pub fn run(args: &NodeArgs) -> Result<Ending> {
    args.expect_no_rest()?;
    let mut book = Book::default();
    let result = wm_ros::run(
        NODE.name,
        wm_ros::NAMESPACE,
        args,
        async |node: Node| -> Result<()> {
            let parameters = Parameters::declare(&node)?;
            node.seal_parameters()?;
            let options = Options::new(parameters, &node)?;
            serve(&node, &options, &mut book).await
        },
    );
    // the bag is closed whatever happened, so that what was recorded can be read
    book.end()?;
    book.close()?;
    result?;
    Ok(Ending::lost_if(book.is_lossy))
}

/// Records into one bag after the other, as it is asked to.
async fn serve(node: &Node, options: &Options, book: &mut Book) -> Result<()> {
    book.begin_first(options).await?;
    let mut calls = command::serve(node)?;
    let keys = calls.sender();
    // a key that finds the queue full is pressed again
    let on_key = move |key| drop(keys.try_send(Command::Key(key)));
    let has_keyboard = options.has_keyboard;
    let keyboard = has_keyboard.then(|| Keyboard::listen(on_key)).flatten();
    if keyboard.is_some() {
        info!("space pauses and resumes");
    }
    let shutdown = node.shutdown();
    let is_paused = Arc::new(AtomicBool::new(options.is_starting_paused));
    if options.is_starting_paused {
        info!("paused until it is resumed");
    }
    loop {
        let Some(stopped) = record(node, options, &is_paused, &mut calls, book).await? else {
            return Ok(());
        };
        book.end()?;
        book.written().await;
        book.close()?;
        answer(stopped, &Empty::default());
        loop {
            tokio::select! {
                () = shutdown.wait() => return Ok(()),
                command = calls.next() => match command {
                    Command::Record(call) => {
                        let begun = book.begin_asked_for(options, &call.request.uri).await;
                        answer(call, &RecordResponse {
                            return_code: begun.is_err().into(),
                            error_string: begun.as_ref().err().map(shortened).unwrap_or_default(),
                        });
                        if begun.is_ok() {
                            break;
                        }
                    }
                    Command::Stop(call) => answer(call, &Empty::default()),
                    Command::Snapshot(call) => answer(call, &Success { success: false }),
                    Command::SplitBagfile(call) => answer(call, &Empty::default()),
                    other => obey(other, &is_paused),
                },
            }
        }
    }
}

/// Records until the node's shutdown, or until the call that it gives; counts in the book what was lost.
async fn record(
    node: &Node,
    options: &Options,
    is_paused: &Arc<AtomicBool>,
    calls: &mut Calls<Command>,
    book: &mut Book,
) -> Result<Option<Call<Stop>>> {
    let Some(queue) = book.queue() else {
        return Ok(None);
    };
    let prefixes = definitions::prefixes();
    let shutdown = node.shutdown();
    let (over, _) = watch::channel(false);
    let mut types: BTreeMap<String, String> = BTreeMap::new();
    let mut news = News::new(node.diagnostics());
    let (lookups, mut undefined) = Lookups::new(node);
    let mut topics = JoinSet::new();
    let mut changes = node.graph_changes();
    let clock = node.clock();
    // a simulated clock stands at 0 until /clock speaks: what came before would have no time
    let mut has_time = !clock.is_simulated();
    let stopped = loop {
        let wanted = |topic: &TopicInfo| has_time && options.selection.wants(topic);
        for topic in node.topics().into_iter().filter(wanted) {
            match types.get(&topic.name) {
                Some(known) if *known == topic.type_name => continue,
                Some(known) => {
                    news.skipped(&topic, &format_args!("it is recorded as {known}"));
                    continue;
                }
                None if types.len() >= MOST_TOPICS => {
                    news.skipped(
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
                // DDS allows more than ROS, and anybody may publish.
                Err(reason) => {
                    news.skipped(&topic, &reason);
                    continue;
                }
            };
            let candidates = definitions::candidates(&topic.type_name, &prefixes);
            let lookup = match candidates.is_empty() {
                true => lookups.of(&topic),
                false => None,
            };
            if lookup.is_none() {
                report_definition(&topic.type_name, &candidates, &mut news);
            }
            let announcement = Announcement {
                topic: Arc::clone(&name),
                type_name: topic.type_name.clone(),
                candidates,
                qos: profile(topic.publishers.first()),
            };
            types.insert(topic.name.clone(), topic.type_name.clone());
            news.recorded(&topic.name);
            let loss = Arc::new(Loss::default());
            book.losses.insert(name.clone(), Arc::clone(&loss));
            let forward = Forward {
                topic: name,
                queue: queue.clone(),
                is_paused: Arc::clone(is_paused),
                loss,
                diagnostics: node.diagnostics(),
            };
            let over = over.subscribe();
            topics.spawn(forward.run(announcement, lookup, subscription, over));
        }
        news.tell();
        tokio::select! {
            Ok(()) = changes.changed() => {}
            () = clock.sleep_until(Time { sec: 0, nanosec: 1 }), if !has_time => has_time = true,
            () = shutdown.wait() => break None,
            Some(ended) = topics.join_next() => {
                ended??;
            }
            Some((type_name, what)) = undefined.recv() => news.undefined(&type_name, &what),
            command = calls.next() => match command {
                Command::Stop(call) => break Some(call),
                Command::Record(call) => answer(call, &RecordResponse {
                    return_code: 1,
                    error_string: "a recording is already running".to_owned(),
                }),
                Command::Snapshot(call) => {
                    let success = queue.take_snapshot()?;
                    info!("snapshot {}", if success { "taken" } else { "refused: the previous snapshot is still being \
                                                                        written" });
                    answer(call, &Success { success });
                }
                Command::SplitBagfile(call) => {
                    queue.offer(Entry::Split)?;
                    answer(call, &Empty::default());
                }
                other => obey(other, is_paused),
            },
        }
    };
    // each ends by itself now, after its last message
    over.send_replace(true);
    while let Some(ended) = topics.join_next().await {
        ended??;
    }
    Ok(stopped)
}

/// What an answer, which has to fit into a datagram, says of an error.
fn shortened(error: &anyhow::Error) -> String {
    const LONGEST: usize = 400;
    format!("{error:#}").chars().take(LONGEST).collect()
}

/// What can be asked for whether or not it records.
fn obey(command: Command, is_paused: &AtomicBool) {
    let set = |paused: bool| {
        is_paused.store(paused, Ordering::Relaxed);
        info!("{}", if paused { "paused" } else { "resumed" });
    };
    match command {
        Command::Pause(call) => {
            set(true);
            answer(call, &Empty::default());
        }
        Command::Resume(call) => {
            set(false);
            answer(call, &Empty::default());
        }
        Command::IsPaused(call) => {
            let paused = is_paused.load(Ordering::Relaxed);
            answer(call, &IsPausedResponse { paused });
        }
        Command::Key(Key::Space) => set(!is_paused.load(Ordering::Relaxed)),
        _ => {}
    }
}

/// Subscribes to a topic. The inner error says why ROS does not allow it.
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

/// Reports a type without a definition, or without a hash.
fn report_definition(type_name: &str, candidates: &[Schema], news: &mut News) {
    match candidates.first().map(|schema| schema.type_hash(type_name)) {
        None => news.undefined(type_name, UNDEFINED),
        Some(Err(error)) => {
            news.undefined(type_name, &format!("is recorded without its hash: {error}"));
        }
        Some(Ok(_)) => {}
    }
}

/// What the publisher offers, as the bag keeps it.
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
        depth: u32::try_from(qos.depth).unwrap_or(0),
    }
}
