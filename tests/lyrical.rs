//! A camera as ROS 2 Lyrical announces it: long user data, and channels of buffers beside the plain topic.

use std::time::Duration;

use serde_json::Value;
use wm_bag::BagReader;
use wm_msgs::sensor_msgs::Image;
use wm_ros::{Node, Qos};

use crate::harness::{
    Process, Signal, fresh_domain, join, peers, tool, wait_until, whole_suite, wm,
};

const TOPIC: &str = "/camera/image_raw";
/// Of `sensor_msgs/msg/Image`.
const HASH: &str = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47";
const LIMIT: Duration = Duration::from_secs(30);

/// The topics of the camera, each with its numbers of publishers and of subscriptions.
fn topics_of_camera(node: &Node) -> Vec<(String, usize, usize)> {
    let topics = node.topics().into_iter();
    let topics = topics.filter(|topic| topic.name.starts_with("/camera"));
    topics
        .map(|topic| (topic.name, topic.publishers.len(), topic.subscribers))
        .collect()
}

/// Receives images of `lyrical.py` with these options, and checks the graph.
fn meet_camera(options: &[&str]) {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let (context, node) = join(domain, "observer");
    let args = [&[TOPIC, HASH], options].concat();
    let _camera = Process::start(tool(&peers, domain, "lyrical.py", &args));
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        let mut images = node
            .subscription::<Image>(TOPIC, Qos::sensor_data())
            .expect("a subscription");
        let mut first = None;
        for number in 0..20 {
            let image = tokio::time::timeout(LIMIT, images.recv()).await;
            let image = image.expect("it comes in time").expect("no shutdown");
            assert_eq!((image.message.height, image.message.width), (48, 64));
            assert_eq!(image.message.data.len(), 3 * 48 * 64);
            let pixel = image.message.data[0];
            let first = first.get_or_insert(pixel);
            assert_eq!(pixel, first.wrapping_add(number), "each image comes once");
        }
        assert_eq!(topics_of_camera(&node), [(TOPIC.to_owned(), 1, 1)]);
        let hashes = node.type_hashes(TOPIC).into_iter().map(|(_, hash)| hash);
        assert_eq!(hashes.collect::<Vec<_>>(), [HASH]);
        assert_eq!((images.dropped(), images.undecodable()), (0, 0));
    });
    drop(node);
    context.close();
}

#[test]
fn camera_of_lyrical_is_one_topic_with_its_hash() {
    meet_camera(&[]);
}

#[test]
fn images_in_a_buffer_channel_of_lyrical_are_received() {
    meet_camera(&["forgetful"]);
}

#[test]
fn doctor_and_recorder_find_one_camera_of_lyrical() {
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let _camera = Process::start(tool(&peers, domain, "lyrical.py", &[TOPIC, HASH]));
    let scratch = tempfile::tempdir().expect("a temporary directory");
    let bag = scratch.path().join("bag");
    let output = bag.to_string_lossy();
    let recorder = Process::start(wm(domain, &["bag", "record", "-a", "-o", &output]));
    let doctor = wm(domain, &["doctor", "--json", "--seconds", "5"])
        .output()
        .expect("wm runs");
    let report: Value = serde_json::from_slice(&doctor.stdout).expect("JSON");
    let cameras = report["cameras"].as_array().expect("cameras").iter();
    let cameras: Vec<&Value> = cameras.map(|camera| &camera["camera"]).collect();
    assert_eq!(cameras, [TOPIC], "{report:#}");
    assert!(
        !report.to_string().contains("_buf"),
        "no finding is about the channels: {report:#}"
    );

    let count = || BagReader::open(&bag).map_or(0, |reader| reader.message_count());
    wait_until("images are recorded", LIMIT, || count() >= 10);
    recorder.signal(Signal::INT);
    let (status, _) = recorder.finish(LIMIT);
    assert!(status.success(), "{status}");
    let reader = BagReader::open(&bag).expect("a bag");
    let names = reader.topics().iter().map(|topic| &*topic.name);
    let names: Vec<&str> = names.filter(|name| name.starts_with("/camera")).collect();
    assert_eq!(names, [TOPIC]);
}
