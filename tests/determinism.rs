//! Repeated replays give identical predictions, bit for bit.

use std::{
    collections::BTreeMap,
    hash::{DefaultHasher, Hash as _, Hasher as _},
    time::Duration,
};

use wm_msgs::wm_msgs::Prediction;
use wm_ros::Qos;

use crate::harness::{Process, fresh_domain, join, wait_for_publishers, whole_suite, wm};

/// Steps of a rollout.
const HORIZON: u32 = 4;

/// A predicted step: stamp of the observation \[ns\] and k.
type Step = (i64, u32);

/// The hash of each predicted step of the bundled bag, played once through encoder and predictor: of the latent and of
/// its actions.
fn predictions() -> BTreeMap<Step, u64> {
    let domain = fresh_domain();
    let horizon = format!("horizon:={HORIZON}");
    let _nodes = [
        Process::start(wm(domain, &["encoder"])),
        Process::start(wm(
            domain,
            &["predictor", "--ros-args", "-p", "seed:=7", "-p", &horizon],
        )),
    ];
    wait_for_publishers(domain, &["/wm/latent", "/wm/predicted"]);
    let (context, node) = join(domain, "listener");
    let all = Qos::reliable(4000);
    let mut predicted = node
        .subscription::<Prediction>("/wm/predicted", all)
        .expect("a subscription");
    // with the bag's stamps, and slow enough for a busy machine; a chunk announces the actions of each rollout
    let play = [
        "player",
        "--ros-args",
        "-p",
        "bag:=bags/tabletop",
        "-p",
        "rate:=0.5",
        "-p",
        "action_chunk_length:=20",
        "-p",
        "wait_for:=[/wm/action, /wm/latent, /wm/predicted]",
        "-p",
        "linger:=2.0",
    ];
    let (status, text) = Process::start(wm(domain, &play)).finish(Duration::from_secs(120));
    assert!(status.success(), "{status}: {text}");
    let mut hashes = BTreeMap::new();
    while let Some(received) = predicted.try_recv() {
        let prediction = received.message;
        let mut hasher = DefaultHasher::new();
        prediction.latent.data.hash(&mut hasher);
        for action in &prediction.actions {
            hasher.write_i64(action.header.stamp.to_nanos());
            for value in &action.values {
                hasher.write_u32(value.to_bits());
            }
        }
        // a rollout that is repeated with its frame's chunk replaces the first
        let step = (prediction.observed_stamp.to_nanos(), prediction.step);
        hashes.insert(step, hasher.finish());
    }
    drop((predicted, node));
    context.close();
    hashes
}

#[test]
fn same_bag_gives_same_predictions_twice() {
    let _whole = whole_suite();
    let (first, second) = (predictions(), predictions());
    let common: Vec<&Step> = first
        .keys()
        .filter(|step| second.contains_key(step))
        .collect();
    // The bag has 50 frames, of which 48 have a context. On a busy machine a best-effort latent may be lost.
    let least = 30 * HORIZON as usize;
    assert!(common.len() >= least, "{} of {}", common.len(), first.len());
    let hash = |hashes: &BTreeMap<Step, u64>| {
        let mut hasher = DefaultHasher::new();
        for step in &common {
            (step, hashes.get(step)).hash(&mut hasher);
        }
        hasher.finish()
    };
    let differ = common
        .iter()
        .filter(|step| first.get(step) != second.get(step));
    let differ: Vec<_> = differ.collect();
    assert_eq!(hash(&first), hash(&second), "{differ:?}");
}
