//! Messages that are larger than Linux's default receive buffer, between participants on loopback.

use crate::participants::{PATIENCE, contexts, node, soon};
use bytes::Bytes;
use std::time::Duration;
use wm_ros::{Node, Qos, RawSubscription};

const TYPE: &str = "std_msgs/msg/String";
const TOPIC: &str = "large";

/// CDR's header and a pattern that no other message has.
fn message(index: usize, len: usize) -> Bytes {
    let pattern = (0..len).map(|at| (at / 251 + index) as u8);
    [0, 1, 0, 0].into_iter().chain(pattern).collect()
}

async fn next(subscription: &mut RawSubscription) -> Bytes {
    soon("a message", subscription.recv())
        .await
        .unwrap()
        .message
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reliable_messages_of_any_size_arrive_in_order() {
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "talker", ""), node(&there, "listener", ""));
    let publisher = talker
        .raw_publisher(TOPIC, TYPE, Qos::reliable(10))
        .unwrap();
    let subscribe = |node: &Node| {
        node.raw_subscription(TOPIC, TYPE, Qos::reliable(64))
            .unwrap()
    };
    let mut remote = subscribe(&listener);
    soon("connecting", publisher.wait_for_subscribers(1)).await;
    soon("connecting", remote.wait_for_publishers(1)).await;

    // small, then from the first large one on everything goes in parts; rustdds fills up to a multiple of four
    let lengths = [
        12,
        70_000,
        20,
        1 << 20,
        59_992,
        59_996,
        60_000,
        600_004,
        4,
        3 << 20,
    ];
    let messages: Vec<Bytes> = lengths
        .iter()
        .cycle()
        .take(40)
        .enumerate()
        .map(|(index, len)| message(index, *len))
        .collect();
    let sent = messages.clone();
    let sending = tokio::spawn(async move {
        for sample in sent {
            publisher.publish_when_ready(sample).await.unwrap();
        }
        publisher
    });
    for expected in &messages {
        let came = next(&mut remote).await;
        assert!(
            came == *expected,
            "{} bytes came instead of {}",
            came.len(),
            expected.len()
        );
    }
    let publisher = sending.await.unwrap();
    assert!(publisher.wait_for_acknowledgments(PATIENCE).await.unwrap());
    assert_eq!(
        (remote.lost(), remote.dropped(), publisher.dropped()),
        (0, 0, 0)
    );
    assert!(remote.try_recv().is_none(), "a message came twice");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_publisher_tells_its_readers_apart() {
    let [here, there, elsewhere] = contexts();
    let (talker, early) = (node(&here, "talker", ""), node(&there, "early", ""));
    let publisher = talker
        .raw_publisher(TOPIC, TYPE, Qos::best_effort(5))
        .unwrap();
    let subscribe = |node: &Node| {
        node.raw_subscription(TOPIC, TYPE, Qos::best_effort(5))
            .unwrap()
    };
    let (mut first, mut own) = (subscribe(&early), subscribe(&talker));
    soon("connecting", publisher.wait_for_subscribers(2)).await;
    soon("connecting", first.wait_for_publishers(1)).await;
    for index in 0..3 {
        publisher.publish(message(index, 500_000)).unwrap();
        assert!(next(&mut first).await == message(index, 500_000));
        assert!(next(&mut own).await == message(index, 500_000));
    }
    drop(own);

    // who comes late begins with what is sent then
    let late = node(&elsewhere, "late", "");
    let mut second = subscribe(&late);
    soon("connecting", publisher.wait_for_subscribers(2)).await;
    soon("connecting", second.wait_for_publishers(1)).await;
    for index in 3..6 {
        publisher.publish(message(index, 500_000)).unwrap();
        assert!(next(&mut first).await == message(index, 500_000));
        assert!(next(&mut second).await == message(index, 500_000));
    }

    // and who goes leaves the others alone
    drop((first, early));
    there.close();
    for index in 6..9 {
        publisher.publish(message(index, 500_000)).unwrap();
        assert!(next(&mut second).await == message(index, 500_000));
    }
    assert_eq!((second.lost(), second.dropped()), (0, 0));
    // one that comes anew, in a participant that has read this publisher before
    drop(second);
    let mut anew = subscribe(&late);
    soon("connecting", anew.wait_for_publishers(1)).await;
    let mut index = 9;
    let came = async {
        loop {
            publisher.publish(message(index, 500_000)).unwrap();
            // the publisher may not know of it yet
            let received = tokio::time::timeout(Duration::from_secs(1), anew.recv()).await;
            if let Ok(received) = received {
                return received.unwrap().message;
            }
            index += 1;
        }
    };
    let came = soon("a message", came).await;
    assert!(came == message(index, 500_000));
    assert_eq!(anew.lost(), 0);
}

/// More than memory would hold if it were kept for one that takes nothing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscription_that_is_not_read_costs_its_queue() {
    const LEN: usize = 4 << 20;
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "talker", ""), node(&there, "listener", ""));
    let publisher = talker
        .raw_publisher(TOPIC, TYPE, Qos::best_effort(2))
        .unwrap();
    let mut read = listener
        .raw_subscription(TOPIC, TYPE, Qos::best_effort(2))
        .unwrap();
    let unread = listener
        .raw_subscription(TOPIC, TYPE, Qos::best_effort(2))
        .unwrap();
    soon("connecting", publisher.wait_for_subscribers(2)).await;
    soon("connecting", read.wait_for_publishers(1)).await;
    soon("connecting", unread.wait_for_publishers(1)).await;
    for index in 0..60 {
        publisher.publish(message(index, LEN)).unwrap();
        assert!(next(&mut read).await == message(index, LEN));
    }
    assert_eq!((read.lost(), unread.lost()), (0, 0));
    assert_eq!(unread.dropped(), 58);
}
