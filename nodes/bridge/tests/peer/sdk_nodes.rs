//! Nodes of wm over Zenoh, and zenoh-ros2-sdk of PyPI, which implements the wire format of rmw_zenoh independently.

use super::{
    harness::{PATIENCE, root, soon},
    hiroz_types as types,
    zenoh_process::{hiroz_node, with_router, wm_node},
};
use hiroz::Builder as _;
use std::{
    io::{BufRead as _, BufReader, Write as _},
    path::PathBuf,
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::{Duration, Instant},
};
use wm_msgs::{
    TypeDescription,
    std_msgs::String as Text,
    std_srvs::{Outcome, SetBool, SetBoolRequest},
};
use wm_ros::Qos;

/// More than one batch of Zenoh, and more than one fragment of any link.
const LARGE: usize = 512 << 10;

/// Longer than the SDK takes to start.
const LATE: Duration = Duration::from_secs(10);

/// The Python with the SDK; `None` (with a message) without `tests/setup_ros2`.
fn python() -> Option<PathBuf> {
    let python = root().join(".venv/tools/bin/python");
    let has_sdk = Command::new(&python)
        .args(["-c", "import zenoh_ros2_sdk"])
        .status();
    if has_sdk.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    eprintln!("skipped: no zenoh-ros2-sdk under .venv; run tests/setup_ros2 (tests/run does)");
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// A run of `sdk.py`.
struct Sdk {
    child: Child,
    input: Option<ChildStdin>,
    lines: Receiver<String>,
}

impl Sdk {
    fn start(python: &PathBuf, router: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(python)
            .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peer/sdk.py"))
            .arg(router)
            .args(arguments)
            // the SDK takes the router's address as an argument
            .env_remove("ZENOH_CONFIG_OVERRIDE")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        let input = child.stdin.take();
        Self {
            child,
            input,
            lines,
        }
    }

    /// Waits for its next line.
    fn line(&self) -> String {
        self.lines.recv_timeout(PATIENCE).unwrap()
    }

    /// Repeats an action until a line arrives.
    async fn line_after(&self, mut act: impl AsyncFnMut()) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            act().await;
            match self.lines.recv_timeout(Duration::from_millis(500)) {
                Err(RecvTimeoutError::Timeout) if Instant::now() < end => {}
                line => break line.unwrap(),
            }
        }
    }

    fn say(&mut self, line: &str) {
        writeln!(self.input.as_mut().unwrap(), "{line}").unwrap();
    }
}

impl Drop for Sdk {
    fn drop(&mut self) {
        // its commands end with their input
        drop(self.input.take());
        self.child.wait().ok();
    }
}

#[test]
fn topics_reach_the_sdk_and_come_from_it() {
    let Some(python) = python() else { return };
    let name = "sdk_nodes::topics_reach_the_sdk_and_come_from_it";
    with_router(name, async |router: &str| {
        let (_context, node) = wm_node("ours", &[]);
        let publisher = node.publisher::<Text>("/of_wm", Qos::reliable(5)).unwrap();
        let listener = Sdk::start(&python, router, &["echo", "/of_wm"]);
        assert_eq!(listener.line(), "ready");
        soon("the SDK", publisher.wait_for_subscribers(1)).await;
        for (length, letter) in [(3, "a"), (LARGE, "b")] {
            let data = letter.repeat(length);
            publisher.publish(&Text { data }).unwrap();
            let head = letter.repeat(length.min(8));
            assert_eq!(listener.line(), format!("{length} {head}"));
        }

        let mut subscription = node
            .subscription::<Text>("/of_sdk", Qos::reliable(5))
            .unwrap();
        let mut talker = Sdk::start(&python, router, &["say", "/of_sdk"]);
        assert_eq!(talker.line(), "ready");
        soon("the SDK", subscription.wait_for_publishers(1)).await;
        // the publisher of the SDK does not wait for subscriptions: its first texts may be lost
        let received = async {
            loop {
                talker.say(&format!("{LARGE} c"));
                let next = subscription.recv();
                let limit = Duration::from_millis(500);
                if let Ok(received) = tokio::time::timeout(limit, next).await {
                    break received.unwrap();
                }
            }
        };
        let received = soon("a text of the SDK", received).await;
        assert_eq!(received.message.data, "c".repeat(LARGE));
    });
}

/// Without nodes of wm: if it fails, so do the tests with them, and not because of them.
#[test]
fn hiroz_and_the_sdk_meet_through_the_router() {
    let Some(python) = python() else { return };
    let name = "sdk_nodes::hiroz_and_the_sdk_meet_through_the_router";
    with_router(name, async |router: &str| {
        let node = hiroz_node("theirs");
        let publisher = node.create_pub::<types::Text>("/of_hiroz").build().unwrap();
        let listener = Sdk::start(&python, router, &["echo", "/of_hiroz"]);
        assert_eq!(listener.line(), "ready");
        assert!(publisher.wait_for_subscription(1, PATIENCE).await);
        // hiroz counts a subscription before the router has a route to it: its first texts may be lost
        let publish = async || {
            let data = "d".repeat(LARGE);
            publisher
                .async_publish(&types::Text { data })
                .await
                .unwrap();
        };
        assert_eq!(
            listener.line_after(publish).await,
            format!("{LARGE} dddddddd")
        );
    });
}

#[test]
fn late_sdk_gets_a_latched_message() {
    let Some(python) = python() else { return };
    let name = "sdk_nodes::late_sdk_gets_a_latched_message";
    with_router(name, async |router: &str| {
        let (_context, node) = wm_node("ours", &[]);
        let publisher = node.publisher::<Text>("/latched", Qos::latched(1)).unwrap();
        let data = "kept".to_owned();
        publisher.publish(&Text { data }).unwrap();
        // the SDK asks for the history once, maybe before it has a route: then another one comes
        let is_told = (0..10).any(|_| {
            let late = Sdk::start(&python, router, &["echo", "/latched", ":1:,1:,:,:,,"]);
            let mut lines = std::iter::from_fn(|| late.lines.recv_timeout(LATE).ok()).take(2);
            lines.any(|line| line == "4 kept")
        });
        assert!(is_told);
    });
}

#[test]
fn services_work_in_both_directions() {
    let Some(python) = python() else { return };
    let name = "sdk_nodes::services_work_in_both_directions";
    with_router(name, async |router: &str| {
        let (_context, node) = wm_node("ours", &[]);
        let mut service = node.service::<SetBool>("/of_wm").unwrap();
        let mut caller = Sdk::start(&python, router, &["call", "/of_wm"]);
        assert_eq!(caller.line(), "ready");
        for data in [true, false] {
            caller.say(&data.to_string());
            let call = soon("a call of the SDK", service.recv()).await.unwrap();
            let response = Outcome {
                success: true,
                message: format!("was {}", call.request.data),
            };
            call.respond(&response).unwrap();
            assert_eq!(caller.line(), format!("True was {data}"));
        }

        let client = node.client::<SetBool>("/of_sdk").unwrap();
        let server = Sdk::start(&python, router, &["serve", "/of_sdk"]);
        assert_eq!(server.line(), "ready");
        soon("server of the SDK", client.wait_for_service()).await;
        let request = SetBoolRequest { data: true };
        let answer = soon("an answer", client.call(&request)).await.unwrap();
        assert_eq!(
            (answer.success, answer.message.as_str()),
            (true, "was true")
        );
    });
}

#[test]
fn sdk_sees_qos_and_type_hash() {
    let Some(python) = python() else { return };
    let name = "sdk_nodes::sdk_sees_qos_and_type_hash";
    with_router(name, async |router: &str| {
        let (_context, node) = wm_node("ours", &[]);
        let _publisher = node
            .publisher::<Text>("/of_wm", Qos::best_effort(7))
            .unwrap();
        let graph = Sdk::start(&python, router, &["graph", "/of_wm"]).line();
        let hash = TypeDescription::of::<Text>().unwrap().hash().to_string();
        for part in [
            "\"publisher_count\": 1",
            "\"node_name\": \"ours\"",
            "\"topic_type\": \"std_msgs/msg/String\"",
            &hash,
            "\"qos\": \"2::,7:,:,:,,\"",
        ] {
            assert!(graph.contains(part), "{part}: {graph}");
        }
    });
}
