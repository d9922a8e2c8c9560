//! A subscription that no quality of service of a publisher excludes, over DDS on loopback.

use crate::participants::{PATIENCE, contexts, node};
use std::time::Duration;
use wm_msgs::std_msgs::{Bool, String as Text};
use wm_ros::{Publisher, Qos, Subscription};

/// Apart from the domains of this crate's other tests, and from another run of this one.
/// Publishes until the subscription has received it.
async fn arrives(publisher: &Publisher<Bool>, subscription: &mut Subscription<Bool>, data: bool) {
    let mut beat = tokio::time::interval(Duration::from_millis(20));
    loop {
        tokio::select! {
            _ = beat.tick() => publisher.publish(&Bool { data }).unwrap(),
            received = subscription.recv() => {
                if received.unwrap().message.data == data {
                    return;
                }
            }
        }
    }
}

#[tokio::test(flavor = "current_thread")]
async fn publishers_of_any_quality_of_service_are_received() {
    let [there, here] = contexts();
    let (sender, receiver) = (node(&there, "sender", ""), node(&here, "receiver", ""));
    let scenario = async {
        // Latched before the subscription is there.
        let latched: Publisher<Bool> = sender.publisher("stop", Qos::latched(1)).unwrap();
        latched.publish(&Bool { data: true }).unwrap();
        let mut stops: Subscription<Bool> = receiver
            .subscription_to_any("stop", Qos::reliable(10))
            .unwrap();
        assert!(stops.recv().await.unwrap().message.data);

        let best_effort: Publisher<Bool> = sender.publisher("stop", Qos::best_effort(1)).unwrap();
        arrives(&best_effort, &mut stops, false).await;
        let volatile: Publisher<Bool> = sender.publisher("stop", Qos::reliable(1)).unwrap();
        arrives(&volatile, &mut stops, true).await;
        arrives(&best_effort, &mut stops, false).await;
        arrives(&latched, &mut stops, true).await;
        assert_eq!(stops.matching_publishers().len(), 3);
        assert_eq!(stops.mismatches(), [""; 0]);

        let mut changes = receiver.graph_changes();
        drop(best_effort);
        while stops.matching_publishers().len() > 2 {
            changes.changed().await.unwrap();
        }
        let _other: Publisher<Text> = sender.publisher("stop", Qos::reliable(1)).unwrap();
        while stops.mismatches().is_empty() {
            changes.changed().await.unwrap();
        }
        let named = &stops.mismatches()[0];
        assert!(named.contains("std_msgs/msg/String"), "{named}");
        assert_eq!(stops.matching_publishers().len(), 2);
    };
    tokio::time::timeout(PATIENCE, scenario).await.unwrap();
    for context in [there, here] {
        context.shutdown().trigger();
        context.close();
    }
}
