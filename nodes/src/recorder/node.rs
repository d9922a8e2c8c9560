//! The recorder on the wire.

use super::{
    definitions,
    selection::{Selection, common_qos},
    writer::{Entry, Queue, Recording, remove_old},
};
use crate::ending::Ending;
use anyhow::{Result, ensure};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};
use tokio::task::JoinSet;
use tracing::{debug, info, warn};
use wm_bag::QosProfile;
use wm_ros::{
    Descriptor, Durability, Node, NodeArgs, Qos, RawSubscription, Reliability, TopicInfo,
};

/// The node's default name.
pub const NAME: &str = "recorder";

/// Messages that found no room, by topic.
type Losses = BTreeMap<Arc<str>, Arc<AtomicU64>>;

/// Records until a signal. `DataLost` where messages found no room on their way to the bag.
///
/// # Errors
/// Names what is wrong with arguments or parameters, or why the bag cannot be written.
pub fn run(args: &NodeArgs) -> Result<Ending> {
    args.expect_no_rest()?;
    let mut recording = None;
    let mut losses = Losses::new();
    let result = wm_ros::run(
        NAME,
        crate::NAMESPACE,
        args,
        async |node: Node| -> Result<()> {
            let (started, selection) = start(&node).await?;
            let queue = recording.insert(started).queue();
            record(&node, &selection, &queue, &mut losses).await
        },
    );
    // the bag is closed whatever happened, so that what was recorded can be read
    let Some(recording) = recording else {
        return result.map(|()| Ending::Complete);
    };
    let queue = recording.queue();
    for (topic, lost) in losses {
        let messages = lost.load(Ordering::Relaxed);
        if messages > 0 {
            queue.put(Entry::Lost { topic, messages })?;
        }
    }
    drop(queue);
    let summary = recording.finish()?;
    result?;
    println!(
        "recorded {} message(s) of {} topic(s) to {}",
        summary.message_count,
        summary.topics.len(),
        summary.path.display()
    );
    for (topic, messages) in summary.lost.iter().filter(|(_, messages)| **messages > 0) {
        println!("lost {messages} message(s) of {topic}");
    }
    let is_lost = summary.lost.values().any(|messages| *messages > 0);
    Ok(Ending::lost_if(is_lost))
}

async fn start(node: &Node) -> Result<(Recording, Selection)> {
    let fixed = |text: &str| Descriptor::new(text).read_only();
    let texts = |name: &str, what: &str| -> Result<Vec<String>> {
        let list = node.declare(name, Vec::<String>::new(), fixed(what))?.get();
        // ROS cannot write an empty list of strings: [''] stands for it
        list.into_iter()
            .filter(|item| !item.is_empty())
            .map(|item| Ok(node.resolve(&item)?))
            .collect()
    };
    let output = node
        .declare(
            "output",
            String::new(),
            fixed("folder of the new bag; relative to the working directory"),
        )?
        .get();
    let is_overwriting = node
        .declare(
            "overwrite",
            false,
            fixed("replace a bag that is there already"),
        )?
        .get();
    let topics = texts("topics", "topics to record; empty: all that are not hidden")?;
    let exclude = texts("exclude_topics", "topics not to record")?;
    node.seal_parameters()?;
    ensure!(
        !output.is_empty(),
        "parameter \"output\" is empty: name the folder of the new bag"
    );
    let folder = PathBuf::from(output);
    info!("recording to {}", folder.display());
    let recording = tokio::task::spawn_blocking(move || -> Result<Recording> {
        if is_overwriting {
            remove_old(&folder)?;
        }
        Recording::create(&folder)
    })
    .await??;
    Ok((recording, Selection { topics, exclude }))
}

/// Records until the node's shutdown; counts in `losses` what was lost.
async fn record(
    node: &Node,
    selection: &Selection,
    queue: &Queue,
    losses: &mut Losses,
) -> Result<()> {
    let prefixes = definitions::prefixes();
    let shutdown = node.shutdown();
    let mut types: BTreeMap<String, String> = BTreeMap::new();
    let mut refused = BTreeSet::new();
    let mut topics = JoinSet::new();
    let mut changes = node.graph_changes();
    loop {
        for topic in node
            .topics()
            .into_iter()
            .filter(|topic| selection.wants(topic))
        {
            match types.get(&topic.name) {
                Some(known) if *known == topic.type_name => continue,
                Some(known) => {
                    if refused.insert((topic.name.clone(), topic.type_name.clone())) {
                        warn!(
                            "{} is recorded as {known}; not as {} too",
                            topic.name, topic.type_name
                        );
                    }
                    continue;
                }
                None => {}
            }
            types.insert(topic.name.clone(), topic.type_name.clone());
            let lost = Arc::new(AtomicU64::new(0));
            let name: Arc<str> = topic.name.as_str().into();
            let subscription = subscribe(node, &topic, &name, queue, &prefixes).await?;
            losses.insert(name.clone(), Arc::clone(&lost));
            topics.spawn(forward(subscription, name, queue.clone(), lost));
        }
        tokio::select! {
            Ok(()) = changes.changed() => {}
            () = shutdown.wait() => break,
            Some(ended) = topics.join_next() => {
                ended??;
            }
        }
    }
    // each ends by itself now, after its last message
    while let Some(ended) = topics.join_next().await {
        ended??;
    }
    Ok(())
}

async fn subscribe(
    node: &Node,
    topic: &TopicInfo,
    name: &Arc<str>,
    queue: &Queue,
    prefixes: &[PathBuf],
) -> Result<RawSubscription> {
    let schema = definitions::definition(&topic.type_name, prefixes).unwrap_or_else(|| {
        warn!(
            "{name}: no definition of {} on AMENT_PREFIX_PATH: recorded without one",
            topic.type_name
        );
        definitions::unknown()
    });
    let qos = common_qos(&topic.publishers);
    info!("recording {name} ({})", topic.type_name);
    let type_name = topic.type_name.clone();
    let recorded = Entry::Topic {
        name: Arc::clone(name),
        type_name,
        schema,
        qos: profile(topic.publishers.first()),
    };
    let queue = queue.clone();
    tokio::task::spawn_blocking(move || queue.put(recorded)).await??;
    Ok(node.raw_subscription(&topic.name, &topic.type_name, qos)?)
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

async fn forward(
    mut subscription: RawSubscription,
    topic: Arc<str>,
    queue: Queue,
    lost: Arc<AtomicU64>,
) -> Result<()> {
    // after the shutdown, what still waits
    while let Some(received) = match subscription.recv().await {
        Some(received) => Some(received),
        None => subscription.try_recv(),
    } {
        let log_time_ns = u64::try_from(received.received.to_nanos()).unwrap_or(0);
        let entry = Entry::Message {
            topic: Arc::clone(&topic),
            log_time_ns,
            data: received.message,
        };
        if !queue.offer(entry)? {
            lost.fetch_add(1, Ordering::Relaxed);
        }
    }
    let (dropped, missing) = (subscription.dropped(), subscription.lost());
    let refused = subscription.undecodable();
    lost.fetch_add(dropped + missing + refused, Ordering::Relaxed);
    debug!(
        "{topic}: {dropped} dropped in the subscription, {missing} never arrived, {refused} in no known form"
    );
    Ok(())
}
