//! Topics.

use crate::{
    harness::{Process, Site, bridge, fresh_domain, fresh_endpoint, gone, no_echo, soon, text},
    pair::{Pair, next, real_bridge},
};
use std::time::Duration;
use wm_msgs::{Message, sensor_msgs::Image, std_msgs::String as Text};
use wm_ros::{Node, Publisher, Qos, Subscription};

/// A topic from one side to the other on which messages arrive.
async fn across<M: Message + Default + PartialEq>(
    from: &Node,
    to: &Node,
    topic: &str,
) -> (Publisher<M>, Subscription<M>) {
    let qos = Qos::reliable(100);
    let publisher = from.publisher::<M>(topic, qos).unwrap();
    let mut subscription = to.subscription::<M>(topic, qos).unwrap();
    soon("connecting", async {
        publisher.wait_for_subscribers(1).await;
        subscription.wait_for_publishers(1).await;
    })
    .await;
    arrives(&publisher, &M::default(), &mut subscription).await;
    (publisher, subscription)
}

/// Publishes until a message arrives: messages of the real bridge within 0.1 s after a subscriber's discovery may be
/// lost.
async fn arrives<M: Message + PartialEq>(
    publisher: &Publisher<M>,
    message: &M,
    heard: &mut Subscription<M>,
) {
    let mut arrived = async || while heard.recv().await.unwrap().message != *message {};
    soon("a message", async {
        loop {
            publisher.publish(message).unwrap();
            let wait = tokio::time::timeout(Duration::from_millis(200), arrived());
            if wait.await.is_ok() {
                break;
            }
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn topic_crosses_both_ways_without_echo() {
    let pair = Pair::new(&[]);
    let qos = Qos::reliable(100);
    let out = pair.here.node.publisher::<Text>("said", qos).unwrap();
    let back = pair.there.node.publisher::<Text>("said", qos).unwrap();
    // subscriptions of other participants than the publishers', which receive both
    let (ear_here, ear_there) = (Site::join(pair.domain_here), Site::join(pair.domain_there));
    let mut heard_here = ear_here.node.subscription::<Text>("said", qos).unwrap();
    let mut heard_there = ear_there.node.subscription::<Text>("said", qos).unwrap();
    soon("connecting", async {
        // the subscription of this side and the bridge's
        out.wait_for_subscribers(2).await;
        back.wait_for_subscribers(2).await;
        heard_here.wait_for_publishers(2).await;
        heard_there.wait_for_publishers(2).await;
    })
    .await;
    arrives(&out, &text("hello from here"), &mut heard_there).await;
    arrives(&back, &text("hello from there"), &mut heard_here).await;
    no_echo([&out, &back], [&mut heard_here, &mut heard_there]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn image_crosses_both_ways() {
    let pair = Pair::new(&[]);
    let (here, there) = (&pair.here.node, &pair.there.node);
    // more than a datagram, but not more than another DDS' receive buffer at Linux's default
    let (height, width) = (160, 160);
    for (from, to, topic) in [(here, there, "image_here"), (there, here, "image_there")] {
        let (publisher, mut subscription) = across::<Image>(from, to, topic).await;
        let bytes = (0..height * width * 3).map(|index: u32| (index % 251) as u8);
        let image = Image {
            height,
            width,
            encoding: "rgb8".into(),
            step: width * 3,
            data: bytes.collect(),
            ..Image::default()
        };
        publisher.publish(&image).unwrap();
        let received = soon("the image", async {
            loop {
                let received = subscription.recv().await.unwrap().message;
                if received != Image::default() {
                    break received;
                }
            }
        });
        assert!(received.await == image, "the image is another");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn names_and_lists_hold() {
    let pair = Pair::new(&["--namespace", "/robot1", "--deny", "/wm/secret"]);
    let (here, there) = (&pair.here.node, &pair.there.node);
    let qos = Qos::reliable(10);
    let secret = here.publisher::<Text>("secret", qos).unwrap();
    let _unheard = there
        .subscription::<Text>("/robot1/wm/secret", qos)
        .unwrap();
    let open = here.publisher::<Text>("open", qos).unwrap();
    let mut heard = there.subscription::<Text>("/robot1/wm/open", qos).unwrap();
    soon("connecting", open.wait_for_subscribers(1)).await;
    soon("connecting", heard.wait_for_publishers(1)).await;
    open.publish(&text("open")).unwrap();
    assert_eq!(next(&mut heard).await, "open");
    assert_eq!(secret.subscribers(), 0);
}

/// A latched publisher on one side, and late subscribers on the other.
struct Latched {
    from: Site,
    to: Site,
    domains: [u16; 2],
    endpoint: String,
}

impl Latched {
    fn new() -> Self {
        let domains = [fresh_domain(), fresh_domain()];
        let [from, to] = domains.map(Site::join);
        Self {
            from,
            to,
            domains,
            endpoint: fresh_endpoint(),
        }
    }

    /// A peer: a router of Zenoh 1.10.2 that returns at once may get no data.
    fn real_bridge(&self, domain: u16) -> Process {
        real_bridge(domain, &self.endpoint, "peer")
    }

    fn publisher(&self) -> Publisher<Text> {
        self.from.node.publisher("map", Qos::latched(1)).unwrap()
    }

    fn late(&self) -> Subscription<Text> {
        self.to.node.subscription("map", Qos::latched(1)).unwrap()
    }

    /// Two late subscribers, one after the other: each gets the state before and after an update.
    async fn two_late(&self, map: &Publisher<Text>) -> (Subscription<Text>, Subscription<Text>) {
        let mut first = self.late();
        assert_eq!(next(&mut first).await, "new");
        let mut second = self.late();
        assert_eq!(next(&mut second).await, "new");
        map.publish(&text("newer")).unwrap();
        assert_eq!(next(&mut first).await, "newer");
        assert_eq!(next(&mut second).await, "newer");
        (first, second)
    }
}

/// Waits for the last latched state: a restarted bridge may repeat earlier ones.
async fn until(heard: &mut Subscription<Text>, last: &str) {
    while next(heard).await != last {}
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscriber_behind_the_real_bridge_gets_latched_state() {
    let latched = Latched::new();
    let map = latched.publisher();
    map.publish(&text("new")).unwrap();
    // the bridges start after the first message
    let [domain_here, domain_there] = latched.domains;
    let _bridge = bridge(domain_here, &["--listen", &latched.endpoint]);
    let real = latched.real_bridge(domain_there);
    let (first, second) = latched.two_late(&map).await;
    // a third one after a restart of the real bridge
    drop((first, second, real));
    let _real = latched.real_bridge(domain_there);
    let mut third = latched.late();
    until(&mut third, "newer").await;
    map.publish(&text("newest")).unwrap();
    until(&mut third, "newest").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscriber_gets_latched_state_of_the_real_bridge() {
    let latched = Latched::new();
    let map = latched.publisher();
    map.publish(&text("new")).unwrap();
    let [domain_there, domain_here] = latched.domains;
    let _bridge = bridge(domain_here, &["--listen", &latched.endpoint]);
    let real = latched.real_bridge(domain_there);
    let (mut first, _second) = latched.two_late(&map).await;
    drop(real);
    let _real = latched.real_bridge(domain_there);
    map.publish(&text("newest")).unwrap();
    until(&mut first, "newest").await;
    let mut third = latched.late();
    until(&mut third, "newest").await;
}

/// The real bridge stops reading a topic when the last announced subscriber leaves, and resumes only when one joins a
/// network without any.
#[tokio::test(flavor = "multi_thread")]
async fn latched_topic_resumes_after_its_subscribers_left() {
    let latched = Latched::new();
    let [domain_there, domain_here] = latched.domains;
    let _bridge = bridge(domain_here, &["--listen", &latched.endpoint]);
    let _real = latched.real_bridge(domain_there);
    let map = latched.publisher();
    map.publish(&text("new")).unwrap();
    let mut first = latched.late();
    assert_eq!(next(&mut first).await, "new");
    drop(first);
    gone(domain_here, "/wm/map").await;
    // a route for a later message has handled the departure
    let (from, to) = (&latched.from.node, &latched.to.node);
    let _after = across::<Text>(from, to, "map_after").await;
    let mut second = latched.late();
    assert_eq!(next(&mut second).await, "new");
    map.publish(&text("newer")).unwrap();
    assert_eq!(next(&mut second).await, "newer");
}
