//! Messages between nodes of one context are handed over as they are, and encoded only for those who need bytes.

use crate::participants::{contexts, node, soon};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};
use wm_msgs::Message;
use wm_ros::{Node, Qos};

static ENCODED: AtomicUsize = AtomicUsize::new(0);
static DECODED: AtomicUsize = AtomicUsize::new(0);

/// A `std_msgs/msg/UInt8` that counts how often it is turned into bytes and back.
#[derive(Clone, Debug, PartialEq)]
struct Counted(u8);

impl Serialize for Counted {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        ENCODED.fetch_add(1, Ordering::Relaxed);
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Counted {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        DECODED.fetch_add(1, Ordering::Relaxed);
        u8::deserialize(deserializer).map(Self)
    }
}

impl Message for Counted {
    const PACKAGE: &'static str = "std_msgs";
    const NAME: &'static str = "UInt8";
    const DEFINITION: &'static str = "uint8 data\n";

    fn dependencies() -> Vec<(&'static str, &'static str)> {
        Vec::new()
    }
}

fn counts() -> (usize, usize) {
    (
        ENCODED.swap(0, Ordering::Relaxed),
        DECODED.swap(0, Ordering::Relaxed),
    )
}

#[tokio::test(flavor = "current_thread")]
async fn a_message_is_encoded_only_for_those_who_need_bytes() {
    let [here, there] = contexts();
    let (talker, listener) = (node(&here, "talker", ""), node(&here, "listener", ""));
    let qos = Qos::reliable(10);
    let publisher = talker.publisher::<Counted>("counted", qos).unwrap();
    let subscribe = |node: &Node| node.subscription::<Counted>("counted", qos).unwrap();

    // nobody
    publisher.publish(&Counted(0)).unwrap();
    assert_eq!(counts(), (0, 0));

    // nodes of one context
    let (mut one, mut two) = (subscribe(&talker), subscribe(&listener));
    publisher.publish(&Counted(1)).unwrap();
    for subscription in [&mut one, &mut two] {
        assert_eq!(
            soon("a message", subscription.recv())
                .await
                .unwrap()
                .message,
            Counted(1)
        );
    }
    let message = Arc::new(Counted(2));
    publisher.publish_shared(Arc::clone(&message)).unwrap();
    for subscription in [&mut one, &mut two] {
        let received = soon("a message", subscription.recv_shared())
            .await
            .unwrap()
            .message;
        assert!(Arc::ptr_eq(&received, &message), "the very same message");
    }
    assert_eq!(counts(), (0, 0));

    // one of them wants bytes
    let mut raw = listener
        .raw_subscription("counted", "std_msgs/msg/UInt8", qos)
        .unwrap();
    publisher.publish(&Counted(3)).unwrap();
    soon("a message", one.recv()).await.unwrap();
    let bytes = soon("a message", raw.recv()).await.unwrap().message;
    assert_eq!(bytes[..], [0, 1, 0, 0, 3]);
    assert_eq!(counts(), (1, 0));

    // and one is in another process, as it were
    let elsewhere = node(&there, "elsewhere", "");
    let mut remote = subscribe(&elsewhere);
    soon("connecting", publisher.wait_for_subscribers(4)).await;
    soon("connecting", remote.wait_for_publishers(1)).await;
    publisher.publish(&Counted(4)).unwrap();
    assert_eq!(
        soon("a message", remote.recv()).await.unwrap().message,
        Counted(4)
    );
    soon("a message", raw.recv()).await.unwrap();
    assert_eq!(counts(), (1, 1));
    assert_eq!(
        (one.lost(), two.lost(), remote.lost(), raw.lost()),
        (0, 0, 0, 0)
    );
}
