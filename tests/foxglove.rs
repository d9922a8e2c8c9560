//! Viewers with Foxglove's protocol on the port of `wm view`: a client of our own, which can be slow and hostile, and
//! Foxglove's client library.

use std::{collections::BTreeMap, process::Command, time::SystemTime};

use serde_json::{Value, json};

use crate::{
    harness::{Process, Signal, bundled_bag, fresh_domain, resident, root, whole_suite, wm},
    view_process::{PATIENCE, View, body, player},
    websocket::{Message, Socket, catch_up, frame_of, open_at, read_beside},
};

const NEWER: (&str, &str) = ("Sec-WebSocket-Protocol", "foxglove.sdk.v1");
const OLDER: (&str, &str) = ("Sec-WebSocket-Protocol", "foxglove.websocket.v1");
/// The origin of desktop applications.
const DESKTOP: (&str, &str) = ("Origin", "file://");
const CAMERA: &str = "/camera/image_raw/compressed";
const GRIPPER: &str = "/arm/gripper";

/// The expected status of a request, its path, and its headers.
type Case<'a> = (u16, &'a str, &'a [(&'a str, &'a str)]);

/// A viewer that knows the channels.
struct Viewer {
    socket: Socket,
    channels: BTreeMap<String, Value>,
}

impl Viewer {
    fn open(port: u16) -> Self {
        let (status, socket) = open_at(port, "/", &[NEWER, DESKTOP]);
        let mut socket = socket.unwrap_or_else(|| panic!("refused with {status}"));
        let first = text_of(socket.receive());
        assert_eq!(first["op"], "serverInfo", "{first}");
        Self {
            socket,
            channels: BTreeMap::new(),
        }
    }

    /// The result of `pick` for the first message for which there is one, apart from messages about channels.
    fn until<T>(&mut self, what: &str, mut pick: impl FnMut(Message) -> Option<T>) -> T {
        let Self { socket, channels } = self;
        socket.until(what, |message| match learn(channels, &message) {
            true => None,
            false => pick(message),
        })
    }

    /// Waits for the next message about channels.
    fn news(&mut self) {
        let Self { socket, channels } = self;
        socket.until("news of channels", |message| {
            learn(channels, &message).then_some(())
        });
    }

    /// The channel of a topic, once it is advertised.
    fn channel(&mut self, topic: &str) -> Value {
        while !self.channels.contains_key(topic) {
            self.news();
        }
        self.channels[topic].clone()
    }

    fn subscribe(&mut self, topic: &str, id: u32) {
        let channel = self.channel(topic)["id"].clone();
        let subscriptions = json!([{ "id": id, "channelId": channel }]);
        let text = json!({ "op": "subscribe", "subscriptions": subscriptions });
        self.socket.send(&text.to_string());
    }

    fn unsubscribe(&mut self, id: u32) {
        let text = json!({ "op": "unsubscribe", "subscriptionIds": [id] });
        self.socket.send(&text.to_string());
    }

    /// The next message of a topic: subscription, time \[ns\] and CDR.
    fn data(&mut self) -> (u32, u64, Vec<u8>) {
        self.until("a message of a topic", |message| {
            let Message::Bytes(bytes) = message else {
                return None;
            };
            assert_eq!(bytes[0], 1);
            let id = u32::from_le_bytes(bytes[1..5].try_into().expect("4 bytes"));
            let time = u64::from_le_bytes(bytes[5..13].try_into().expect("8 bytes"));
            Some((id, time, bytes[13..].to_vec()))
        })
    }

    /// The next status.
    fn status(&mut self) -> (u64, String) {
        self.until("a status", |message| match message {
            Message::Text(text) if text["op"] == "status" => {
                let message = text["message"].as_str().expect("text").to_owned();
                Some((text["level"].as_u64().expect("a level"), message))
            }
            _ => None,
        })
    }
}

/// Stores the channels of a message; false if it has none.
fn learn(channels: &mut BTreeMap<String, Value>, message: &Message) -> bool {
    let Message::Text(text) = message else {
        return false;
    };
    let list = |key: &str| text[key].as_array().cloned().unwrap_or_default();
    for channel in list("channels") {
        let topic = channel["topic"].as_str().expect("a topic").to_owned();
        channels.insert(topic, channel);
    }
    let gone = list("channelIds");
    channels.retain(|_, channel| !gone.contains(&channel["id"]));
    text["op"] == "advertise" || text["op"] == "unadvertise"
}

fn text_of(message: Message) -> Value {
    match message {
        Message::Text(text) => text,
        other => panic!("no text: {other:?}"),
    }
}

/// Whether the view's node subscribes to a topic, by a status of the page; `None` if the status lacks the node.
fn subscription_in(status: &Value, topic: &str) -> Option<bool> {
    let key = format!("publishers of {topic}");
    let mut nodes = status["nodes"].as_array()?.iter();
    let node = nodes.find(|node| node["name"] == "wm/view")?;
    let values = node["values"].as_array().expect("values");
    Some(values.iter().any(|pair| pair[0] == key))
}

fn is_subscribed(page: &mut Socket, topic: &str) -> bool {
    page.until_op("status", |status| subscription_in(&status, topic))
}

fn wait_for_subscription(page: &mut Socket, topic: &str, is_so: bool) {
    page.until_op("status", |status| {
        (subscription_in(&status, topic) == Some(is_so)).then_some(())
    });
}

#[test]
fn viewers_receive_topics_only_while_subscribed() {
    let domain = fresh_domain();
    let view = View::start(domain, &["--foxglove-exclude-regex", "^/task/"]);
    // Both subprotocols, at the bare address and the page's path. Without topics, the list of channels is sent too.
    for (path, protocol) in [("/", NEWER), ("/", OLDER), ("/socket", NEWER)] {
        let (status, socket) = open_at(view.port, path, &[protocol]);
        let mut socket = socket.unwrap_or_else(|| panic!("{path} {protocol:?}: {status}"));
        let info = text_of(socket.receive());
        assert_eq!(
            (
                &info["op"],
                &info["capabilities"],
                &info["metadata"]["ROS_DISTRO"]
            ),
            (&json!("serverInfo"), &json!([]), &json!("kilted")),
            "{info}"
        );
        assert_eq!(text_of(socket.receive())["op"], "advertise");
    }
    let (status, page) = body(view.port, "/", &[]);
    assert!(status == 200 && page.starts_with(b"<!doctype html>"));

    let mut viewer = Viewer::open(view.port);
    let player = player(domain, "1");
    let channel = viewer.channel(GRIPPER);
    assert_eq!(
        (
            &channel["encoding"],
            &channel["schemaEncoding"],
            &channel["schemaName"]
        ),
        (
            &json!("cdr"),
            &json!("ros2msg"),
            &json!("std_msgs/msg/Float32")
        )
    );
    let definition = viewer.channel("/arm/end_effector_pose")["schema"].clone();
    let definition = definition.as_str().expect("text");
    for part in ["MSG: std_msgs/Header", "MSG: geometry_msgs/Quaternion"] {
        assert!(definition.contains(part), "{definition}");
    }
    assert!(
        !viewer
            .channels
            .keys()
            .any(|topic| topic.starts_with("/task/"))
    );

    let mut page = view.open();
    assert!(!is_subscribed(&mut page, GRIPPER));
    viewer.subscribe(GRIPPER, 7);
    let (id, time_ns, cdr) = viewer.data();
    let now_ns = SystemTime::UNIX_EPOCH.elapsed().expect("a time").as_nanos();
    let age_ns = now_ns.saturating_sub(u128::from(time_ns));
    assert!(id == 7 && age_ns < PATIENCE.as_nanos(), "{id} {age_ns}");
    // little-endian CDR of a float32, between the closed and the open gripper
    assert_eq!((cdr.len(), &cdr[..4]), (8, &[0, 1, 0, 0][..]));
    let width = f32::from_le_bytes(cdr[4..].try_into().expect("4 bytes"));
    assert!((0.0..=1.0).contains(&width), "{width}");
    wait_for_subscription(&mut page, GRIPPER, true);
    viewer.unsubscribe(7);
    wait_for_subscription(&mut page, GRIPPER, false);

    // each new subscriber gets a latched message that was published once
    for _ in 0..2 {
        let mut viewer = Viewer::open(view.port);
        viewer.subscribe("/tf_static", 1);
        let (_, _, cdr) = viewer.data();
        assert!(cdr.len() > 50, "{}", cdr.len());
    }

    player.signal(Signal::INT);
    while viewer.channels.contains_key(GRIPPER) {
        viewer.news();
    }
    // a removed channel cannot be subscribed to
    let subscriptions = json!([{ "id": 1, "channelId": channel["id"] }]);
    let text = json!({ "op": "subscribe", "subscriptions": subscriptions });
    viewer.socket.send(&text.to_string());
    let (level, message) = viewer.status();
    assert!(
        level == 2 && message.contains("does not exist"),
        "{message}"
    );
}

#[test]
fn rates_are_limited_and_topics_can_be_disabled() {
    let domain = fresh_domain();
    let view = View::start(domain, &["--foxglove-rates", "^/camera/=2"]);
    let _player = player(domain, "2");
    let mut viewer = Viewer::open(view.port);
    viewer.subscribe(CAMERA, 1);
    viewer.subscribe(GRIPPER, 2);
    let mut counts = [0_u32; 3];
    while counts[2] < 40 {
        counts[viewer.data().0 as usize] += 1;
    }
    // 10 Hz for four seconds, of which every fifth frame of the camera
    assert!((4..=16).contains(&counts[1]), "{counts:?}");

    let none = View::start(domain, &["--foxglove-regex", ""]);
    assert_eq!(open_at(none.port, "/", &[NEWER]).0, 400);
}

#[test]
fn view_of_a_bag_refuses_live_topics() {
    let bag = bundled_bag();
    let view = View::start(fresh_domain(), &[&bag.to_string_lossy()]);
    let mut viewer = Viewer::open(view.port);
    let (level, message) = viewer.status();
    assert!(level == 0 && message.contains(".mcap"), "{message}");
    assert_eq!(
        text_of(viewer.socket.receive()),
        json!({ "op": "advertise", "channels": [] })
    );
}

#[test]
fn foreign_pages_and_hostile_viewers_are_refused() {
    let domain = fresh_domain();
    let folder = tempfile::tempdir().expect("a temporary directory");
    let token = folder.path().join("token");
    std::fs::write(&token, "0123456789abcdef\n").expect("the folder is writable");
    let listed = "https://app.foxglove.dev";
    let args = [
        "--token-file",
        &token.to_string_lossy(),
        "--foxglove-origins",
        listed,
    ];
    let view = View::start(domain, &args);
    let port = view.port;
    let with_token = "/?token=0123456789abcdef";
    let both = (
        "Sec-WebSocket-Protocol",
        "foxglove.sdk.v1, wm.view.v1, wm.token.0123456789abcdef",
    );
    let app = ("Origin", listed);
    let evil = ("Origin", "http://evil.example");
    let rebound = ("Host", "evil.example");
    let own = ("Sec-WebSocket-Protocol", "wm.view.v1");
    let other = ("Sec-WebSocket-Protocol", "other");
    let cases: [Case<'_>; 10] = [
        (101, with_token, &[NEWER, app]),
        (101, with_token, &[OLDER]),
        (401, "/", &[NEWER, app]),
        (401, "/?token=0123456789abcdee", &[NEWER, app]),
        (403, with_token, &[NEWER, evil]),
        // the list above has another origin than the default
        (403, with_token, &[NEWER, DESKTOP]),
        (421, with_token, &[NEWER, rebound, evil]),
        // a viewer's origin gets no page, and the page's socket accepts no token in an address
        (403, with_token, &[both, app]),
        (401, with_token, &[own]),
        (401, with_token, &[other]),
    ];
    for (expected, path, headers) in cases {
        assert_eq!(
            open_at(port, path, headers).0,
            expected,
            "{path} {headers:?}"
        );
    }
    // by default no website may connect, including Foxglove's
    let plain = View::start(domain, &[]);
    for origin in [listed, "https://lichtblick.example", "null"] {
        let status = open_at(plain.port, "/", &[NEWER, ("Origin", origin)]).0;
        assert_eq!(status, 403, "{origin}");
    }

    let _player = player(domain, "1");
    let mut good = Viewer::open(plain.port);
    good.subscribe(CAMERA, 1);
    good.data();
    let before = resident(plain.process.pid());
    let client = || open_at(plain.port, "/", &[NEWER]).1.expect("a socket");
    let hostile: [&[u8]; 3] = [&frame_of(1 << 30), &frame_of(u64::MAX), &[0xff; 64]];
    for bytes in hostile {
        let mut socket = client();
        // the server may have closed it before everything is sent
        let _ = socket.send_raw(bytes);
        socket.until_closed();
    }
    for text in [
        "{}",
        "[1]",
        r#"{"op":"subscribe","subscriptions":[{"id":-1}]}"#,
    ] {
        let mut socket = client();
        socket.send(text);
        socket.until_closed();
    }
    // well-formed but unsupported or excessive requests are answered, and the client stays connected
    let mut viewer = Viewer::open(plain.port);
    viewer
        .socket
        .send(r#"{"op":"getParameters","parameterNames":[]}"#);
    let (level, message) = viewer.status();
    assert!(level == 1 && message.contains("not offered"), "{message}");
    viewer.subscribe(CAMERA, 1);
    viewer.subscribe(CAMERA, 2);
    assert!(viewer.status().1.contains("subscribed to already"));
    viewer.data();
    // a client that subscribes and unsubscribes endlessly
    let channel = viewer.channel(GRIPPER)["id"].clone();
    for _ in 0..2000 {
        let subscriptions = json!([{ "id": 9, "channelId": channel }]);
        let text = json!({ "op": "subscribe", "subscriptions": subscriptions });
        viewer.socket.send(&text.to_string());
        viewer.unsubscribe(9);
    }
    let many: Vec<Value> = (0..1000)
        .map(|id| json!({ "id": id + 10, "channelId": id + 100_000 }))
        .collect();
    let text = json!({ "op": "subscribe", "subscriptions": many });
    viewer.socket.send(&text.to_string());
    assert!(viewer.status().1.contains("does not exist"));
    viewer.data();
    let grown = resident(plain.process.pid()).saturating_sub(before);
    assert!(grown < 24 << 20, "{grown} bytes more");
    let (_, first, _) = good.data();
    assert!(good.data().1 > first, "the good viewer is served on");
}

#[test]
fn stalled_viewer_costs_little_and_slows_no_other() {
    let domain = fresh_domain();
    let view = View::start(domain, &[]);
    // 750 KB/s: within seconds more than the kernel buffers for a client that does not read
    let _player = player(domain, "10");
    let viewer = || {
        let mut viewer = Viewer::open(view.port);
        viewer.subscribe(CAMERA, 1);
        viewer.data();
        viewer
    };
    let mut others: Vec<Viewer> = (0..10).map(|_| viewer()).collect();
    let mut page = view.open();
    page.frame();
    let mut stalled = viewer();
    let before = resident(view.process.pid());
    let stamp = |viewer: &mut Viewer| viewer.data().1;
    let common = read_beside(&mut others, stamp, || {
        page.frame();
    });
    let grown = resident(view.process.pid()).saturating_sub(before);
    assert!(grown < 32 << 20, "{grown} bytes more");
    catch_up(&mut stalled, stamp, &common);
    // it receives a warning about dropped messages
    let (level, message) = stalled.status();
    assert!(
        level == 1 && message.contains("dropped") && message.contains(CAMERA),
        "{message}"
    );
}

/// Foxglove's client library; `None` without `tests/setup_foxglove`.
fn library(url: &str, protocol: &str, topics: &[&str]) -> Option<Value> {
    let modules = root().join(".venv/foxglove");
    if !modules.join("stamp").is_file() {
        eprintln!(
            "skipped: no client of Foxglove's under .venv/foxglove; run tests/setup_foxglove"
        );
        return None;
    }
    let mut command = Command::new("node");
    command
        .arg(root().join("tests/interop/foxglove_client.cjs"))
        .arg(modules)
        .args([url, protocol, "100"])
        .args(topics);
    let (status, stdout) = Process::start(command).finish(PATIENCE);
    assert!(status.success(), "foxglove_client.cjs: {status}");
    Some(serde_json::from_str(&stdout).expect("foxglove_client.cjs prints JSON"))
}

#[test]
fn foxgloves_client_decodes_predictions() {
    let _whole = whole_suite();
    let domain = fresh_domain();
    let view = View::start(domain, &[]);
    let _player = player(domain, "0.5");
    let _nodes = Process::start(wm(domain, &["run", "encoder", "predictor", "decoder"]));
    let url = format!("ws://127.0.0.1:{}", view.port);
    let predicted = "/wm/predicted";
    let pictures = "/wm/predicted/image/compressed";
    let topics = [
        "/wm/predicted:8",
        "/wm/predicted/image/compressed:8",
        "/camera/image_raw/compressed:2",
        "/tf_static:1",
        "/diagnostics:2",
    ];
    let Some(answer) = library(&url, "foxglove.sdk.v1", &topics) else {
        return;
    };
    assert_eq!(answer["protocol"], "foxglove.sdk.v1");
    assert_eq!(answer["server_info"]["name"], "wm view");
    assert_eq!(answer["topics"][predicted], "wm_msgs/msg/Prediction");
    assert_eq!(answer["topics"]["/tf"], "tf2_msgs/msg/TFMessage");
    assert_eq!(answer["statuses"], json!([]));
    let list = |topic: &str| answer["messages"][topic].as_array().expect("messages");
    for message in list(predicted) {
        assert_eq!(message["horizon"], 8, "{message}");
        let step = message["step"].as_u64().expect("a step");
        assert!((1..=8).contains(&step), "{message}");
        // 400 ms per step, from the observation to the predicted time
        let ns = |stamp: &Value| {
            let part = |name: &str| stamp[name].as_i64().expect("a number");
            part("sec") * 1_000_000_000 + part("nanosec")
        };
        let ahead = ns(&message["header"]["stamp"]) - ns(&message["observed_stamp"]);
        let period = ns(&message["step_period"]);
        assert!(period > 0 && ahead == step as i64 * period, "{message}");
    }
    for topic in [pictures, CAMERA] {
        let sizes = answer["pictures"][topic].as_array().expect("pictures");
        assert_eq!(sizes.len(), list(topic).len(), "each is a JPEG");
        assert!(
            sizes
                .iter()
                .all(|size| size[0].as_u64() > Some(16) && size[0] == sizes[0][0]),
            "{sizes:?}"
        );
    }
    let transforms = list("/tf_static")[0]["transforms"].as_array();
    assert!(transforms.is_some_and(|all| !all.is_empty()));
    let status = &list("/diagnostics")[0]["status"][0];
    assert!(
        status["name"].as_str().is_some_and(|name| !name.is_empty()),
        "{status}"
    );

    // Lichtblick requests the older one
    let answer = library(
        &url,
        "foxglove.websocket.v1",
        &["/wm/predicted/image/compressed:1"],
    );
    let answer = answer.expect("it was there");
    assert_eq!(answer["protocol"], "foxglove.websocket.v1");
}
