//! Subscribers of a reliable topic that stop, are killed or are slow: the others go on.

use super::harness::{
    Process, context, fresh_domain, given, node, peers, rclpy, resident, role, soon,
};
use bytes::Bytes;
use rustix::process::Signal;
use std::time::Duration;
use wm_ros::{Qos, RawPublisher, RawSubscription};

const TYPE: &str = "std_msgs/msg/UInt8MultiArray";
const TOPIC: &str = "/wm/heavy";
const MIB: usize = 1 << 20;

/// The message of this number, in CDR, with room for `len` bytes.
pub fn message(number: u32, len: usize) -> Bytes {
    let mut bytes = vec![0, 1, 0, 0];
    // layout: no dimensions, no offset; then the data
    for word in [0, 0, len as u32] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    let end = bytes.len() + len;
    bytes.extend_from_slice(&number.to_le_bytes());
    bytes.resize(end, number as u8);
    bytes.into()
}

/// The number of a message.
fn number(message: &Bytes) -> u32 {
    let number = message[16..].first_chunk().unwrap();
    u32::from_le_bytes(*number)
}

/// Says how many have come, until it is killed.
#[test]
#[ignore = "started by the tests of this module"]
fn subscriber() {
    let (domain, _) = given();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let context = context(domain);
        let node = node(&context, "laggard", "");
        let qos = Qos::reliable(10);
        let mut subscription = node.raw_subscription(TOPIC, TYPE, qos).unwrap();
        let mut came = 0;
        while subscription.recv().await.is_some() {
            came += 1;
            println!("came: {came}");
        }
    });
}

/// Publishes `numbers`, each when the one before has come to `live`.
async fn publish(
    publisher: &RawPublisher,
    live: &mut RawSubscription,
    numbers: std::ops::Range<u32>,
    len: usize,
) {
    for number in numbers {
        publisher.publish(message(number, len)).unwrap();
        let what = format!("message {number}, {} dropped", publisher.dropped());
        let received = soon(&what, live.recv()).await.unwrap();
        assert!(received.message == message(number, len));
    }
}

/// `count` of `len` bytes: more than the publisher keeps for one that takes nothing.
async fn one_of_two_stops(len: usize, count: u32) {
    let domain = fresh_domain();
    let (here, there) = (context(domain), context(domain));
    let publisher = node(&here, "talker", "")
        .raw_publisher(TOPIC, TYPE, Qos::reliable(10))
        .unwrap();
    let mut live = node(&there, "listener", "")
        .raw_subscription(TOPIC, TYPE, Qos::reliable(10))
        .unwrap();
    // before there is another subscriber that could be the one counted
    soon("connecting", publisher.wait_for_subscribers(1)).await;
    soon("connecting", live.wait_for_publishers(1)).await;
    for signal in [Signal::STOP, Signal::KILL] {
        let laggard = Process::start(role(&[], "laggards::subscriber", domain, ""));
        while laggard
            .last_line()
            .is_none_or(|line| !line.contains("came"))
        {
            publish(&publisher, &mut live, 0..1, len).await;
        }
        let (before, memory) = (publisher.dropped(), resident());
        laggard.signal(signal);
        publish(&publisher, &mut live, 0..count, len).await;

        let grown = resident().saturating_sub(memory) as usize;
        assert!(grown < 160 * MIB, "{} MiB", grown / MIB);
        // once a retired DDS writer goes
        let counted = async {
            let mut beat = tokio::time::interval(Duration::from_millis(20));
            while publisher.dropped() == before {
                beat.tick().await;
                publish(&publisher, &mut live, 0..1, len).await;
            }
        };
        soon("counting the drops", counted).await;
        assert_eq!((live.lost(), live.dropped()), (0, 0));
        if signal == Signal::STOP && len > MIB {
            // a reader that says nothing for seconds is not waited for
            let acknowledged = publisher.wait_for_acknowledgments(Duration::from_secs(10));
            assert!(acknowledged.await.unwrap());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_messages_continue_after_a_subscriber_stops_or_dies() {
    one_of_two_stops(4 * MIB, 60).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn small_messages_continue_after_a_subscriber_stops_or_dies() {
    one_of_two_stops(20_000, 1500).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn latched_messages_come_once_though_a_subscriber_stops() {
    const LEN: usize = 2000;
    const COUNT: u32 = 900;
    let domain = fresh_domain();
    let (here, there) = (context(domain), context(domain));
    let publisher = node(&here, "talker", "")
        .raw_publisher(TOPIC, TYPE, Qos::latched(2))
        .unwrap();
    let subscribe =
        |node: &wm_ros::Node| node.raw_subscription(TOPIC, TYPE, Qos::latched(2)).unwrap();
    let listener = node(&there, "listener", "");
    let mut live = subscribe(&listener);
    let laggard = Process::start(role(&[], "laggards::subscriber", domain, ""));
    soon("connecting", publisher.wait_for_subscribers(2)).await;
    soon("connecting", live.wait_for_publishers(1)).await;
    publish(&publisher, &mut live, 0..1, LEN).await;
    laggard.says("came");
    laggard.signal(Signal::STOP);
    // one that came again would be taken for the next
    publish(&publisher, &mut live, 1..COUNT, LEN).await;
    // what the stopped one lacks is still there, on two DDS writers
    let elsewhere = context(domain);
    let mut late = subscribe(&node(&elsewhere, "late", ""));
    let mut came = Vec::new();
    let last = async {
        while came.last() != Some(&message(COUNT - 1, LEN)) {
            came.push(late.recv().await.unwrap().message);
        }
    };
    soon("the last latched message", last).await;
    publish(&publisher, &mut live, COUNT..COUNT + 1, LEN).await;
    let next = soon("a message", late.recv()).await.unwrap();
    assert!(next.message == message(COUNT, LEN));
    assert_eq!((live.lost(), late.lost()), (0, 0));
    assert!(live.try_recv().is_none());
    assert!(late.try_recv().is_none());
    let numbers: Vec<_> = came.iter().map(number).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
}

/// As predictions will be: `create_subscription(Prediction, '/wm/predicted', callback, 10)` hears them, and so does one
/// of best effort; one that stops holds up neither.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn real_ros_2_subscribers_of_both_kinds_hear_a_reliable_topic() {
    const COUNT: u32 = 900;
    const LEN: usize = 100_000;
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let here = context(domain);
    let publisher = node(&here, "talker", "")
        .raw_publisher(TOPIC, TYPE, Qos::reliable(16))
        .unwrap();
    let listen = |reliability| {
        // with the usual 10, rclpy itself drops what comes while its callback runs on a busy machine
        let arguments = [reliability, "1000", TOPIC, TYPE];
        Process::start(rclpy(&peers, domain, "listen.py", &arguments))
    };
    let [reliable, stopped] = [(); 2].map(|()| listen("reliable"));
    let best_effort = listen("best_effort");
    soon("three subscribers", publisher.wait_for_subscribers(3)).await;
    let mut beat = tokio::time::interval(Duration::from_millis(25));
    // After a pause, the missed beats do not follow at once: that would overwrite messages before they are sent.
    beat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let all = [&reliable, &stopped, &best_effort];
    let mut heard = [false; 3];
    while heard != [true; 3] {
        beat.tick().await;
        publisher.publish(message(0, LEN)).unwrap();
        for (heard, process) in heard.iter_mut().zip(all) {
            *heard |= process.last_line().is_some();
        }
    }
    stopped.signal(Signal::STOP);
    let count = |process: &Process| -> Option<u32> {
        process.last_line().map(|line| line.parse().unwrap())
    };
    // Time for messages under way.
    std::thread::sleep(Duration::from_secs(3));
    let before = [&reliable, &best_effort].map(|process| count(process).expect("a count"));
    let memory = resident();
    for number in 0..COUNT {
        beat.tick().await;
        publisher.publish(message(number, LEN)).unwrap();
    }
    // On a busy machine a subscriber prints the last messages late: its count is final when no line follows.
    let after = [&reliable, &best_effort].map(|process| {
        let mut last = None;
        loop {
            std::thread::sleep(Duration::from_secs(2));
            match count(process) {
                Some(count) => last = Some(count),
                None => return last.expect("a count"),
            }
        }
    });
    let got = [after[0] - before[0], after[1] - before[1]];
    let grown = resident().saturating_sub(memory) as usize / MIB;
    println!(
        "of {COUNT}: {} reliably, {} by best effort; {} dropped for the stopped one; {grown} MiB more",
        got[0],
        got[1],
        publisher.dropped()
    );
    assert!(publisher.dropped() > 0);
    assert!(got[0] > COUNT * 99 / 100, "{got:?}");
    assert!(got[1] > COUNT * 70 / 100, "{got:?}");
    assert!(grown < 130, "{grown} MiB");
}
