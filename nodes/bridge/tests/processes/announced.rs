//! The bridge's announcements, as a Zenoh session sees them that acts as another bridge.

use crate::harness::{Site, bridge, fresh_domain, fresh_endpoint, gone, soon};
use serde_json::json;
use wm_msgs::std_msgs::String as Text;
use wm_ros::Qos;
use zenoh::{Config, sample::SampleKind};

#[tokio::test(flavor = "multi_thread")]
async fn latched_topic_is_announced_while_subscribed() {
    let (domain, endpoint) = (fresh_domain(), fresh_endpoint());
    let _bridge = bridge(domain, &["--connect", &endpoint]);
    let mut config = Config::default();
    for (key, value) in [
        ("listen/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let publisher = session.declare_publisher("wm/map").await.unwrap();
    // with the assumed depth of the subscription, so that the route stays when it leaves
    let token = "@/a1/@ros2_lv/MP/wm§map/std_msgs§msg§String/:1:1:0,100";
    let liveliness = session.liveliness();
    let _token = liveliness.declare_token(token).await.unwrap();
    let subscribers = "@/*/@ros2_lv/MS/**";
    let tokens = liveliness.declare_subscriber(subscribers).history(true);
    let tokens = tokens.await.unwrap();
    // waits for the announcement of a topic, and returns those withdrawn meanwhile
    let announced = async |topic: &str| {
        let mut withdrawn = Vec::new();
        soon("an announcement", async {
            loop {
                let sample = tokens.recv_async().await.unwrap();
                let key = sample.key_expr().to_string();
                match sample.kind() {
                    SampleKind::Delete => withdrawn.push(key),
                    SampleKind::Put if key.contains(&format!("/wm§{topic}/")) => break,
                    SampleKind::Put => {}
                }
            }
        })
        .await;
        withdrawn
    };
    let site = Site::join(domain);
    let subscribe = |topic: &str, qos| site.node.subscription::<Text>(topic, qos).unwrap();
    let first = subscribe("map", Qos::latched(1));
    announced("map").await;
    let matching = publisher.matching_listener().await.unwrap();
    if !publisher.matching_status().await.unwrap().matching() {
        soon("the subscriber", matching.recv_async()).await.unwrap();
    }
    drop(first);
    gone(domain, "/wm/map").await;
    // when this is announced, the bridge has handled the change
    let _after = subscribe("map_after", Qos::reliable(1));
    assert_eq!(announced("map_after").await, [""; 0]);
    assert!(publisher.matching_status().await.unwrap().matching());
}
