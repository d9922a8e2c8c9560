//! The bridge and the Zenoh client of PyPI, `eclipse-zenoh`, which does not know ROS.

use crate::harness::{Process, Site, bridge, fresh_domain, fresh_endpoint, root, soon, text};
use std::{
    io::{BufRead as _, BufReader},
    path::PathBuf,
    process::{Child, Command, Stdio},
};
use wm_msgs::{
    cdr,
    std_msgs::String as Text,
    wm_msgs::{Reset, ResetRequest, ResetResponse},
};
use wm_ros::Qos;

/// The Python with the client; `None` (with a message) without `tests/setup_ros2`.
fn python() -> Option<PathBuf> {
    let python = root().join(".venv/tools/bin/python");
    let has_zenoh = Command::new(&python).args(["-c", "import zenoh"]).status();
    if has_zenoh.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    eprintln!("skipped: no eclipse-zenoh under .venv; run tests/setup_ros2 (tests/run does)");
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// A run of `peer.py`.
struct Peer {
    child: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Peer {
    fn start(python: &PathBuf, args: &[&str]) -> Self {
        let mut child = Command::new(python)
            .arg(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/tests/processes/peer.py"
            ))
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self { child, output }
    }

    /// Waits for a line; the peer gives up after 30 s.
    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }

    /// Closes its input, which ends some of its commands.
    fn finish(mut self) {
        drop(self.child.stdin.take());
        let status = self.child.wait().unwrap();
        assert!(status.success(), "peer.py: {status}");
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}

struct Side {
    python: PathBuf,
    endpoint: String,
    site: Site,
    _bridge: Process,
}

fn side() -> Option<Side> {
    let python = python()?;
    let (domain, endpoint) = (fresh_domain(), fresh_endpoint());
    Some(Side {
        python,
        _bridge: bridge(domain, &["--listen", &endpoint]),
        site: Site::join(domain),
        endpoint,
    })
}

impl Side {
    fn peer(&self, args: &[&str]) -> Peer {
        Peer::start(&self.python, &[&[self.endpoint.as_str()], args].concat())
    }
}

/// The tokens of a kind that a client sees.
fn tokens_of(side: &Side, kind: &str) -> Vec<String> {
    let mut peer = side.peer(&["announced", kind]);
    std::iter::from_fn(|| Some(peer.line()).filter(|line| !line.is_empty())).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A message's CDR as hexadecimal. Its length is a multiple of four; DDS would pad other lengths.
fn padded(message: &impl serde::Serialize) -> String {
    let mut bytes = cdr::to_bytes(message).unwrap();
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    hex(&bytes)
}

#[tokio::test(flavor = "multi_thread")]
async fn python_client_subscribes_and_publishes() {
    let Some(side) = side() else { return };
    let said = side
        .site
        .node
        .publisher::<Text>("said", Qos::reliable(10))
        .unwrap();
    let mut subscriber = side.peer(&["subscribe", "wm/said"]);
    soon("connecting", said.wait_for_subscribers(1)).await;
    let message = text("a text");
    said.publish(&message).unwrap();
    assert_eq!(subscriber.line(), padded(&message));
    subscriber.finish();

    let mut heard = side
        .site
        .node
        .subscription::<Text>("heard", Qos::reliable(10))
        .unwrap();
    let message = text("an answer");
    let payload = padded(&message);
    let publisher = side.peer(&["publish", "wm/heard", &payload]);
    let received = soon("the message", heard.recv()).await.unwrap();
    assert_eq!(received.message, message);
    publisher.finish();

    // the tokens that the real bridge would see
    let of = |kind: &str, topic: &str| {
        let found = tokens_of(&side, kind);
        let wanted = format!("/@ros2_lv/{kind}/wm§{topic}/std_msgs§msg§String/:1:0:0,10");
        assert!(
            found.iter().any(|token| token.ends_with(&wanted)),
            "no {wanted} among {found:?}"
        );
    };
    of("MP", "said");
    of("MS", "heard");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_calls_a_service() {
    let Some(side) = side() else { return };
    let mut service = side.site.node.service::<Reset>("planner/reset").unwrap();
    let request = ResetRequest {
        seed: 7,
        keep_seed: true,
    };
    let payload = padded(&request);
    let mut caller = side.peer(&["call", "wm/planner/reset", &payload]);
    let call = soon("the call", service.recv()).await.unwrap();
    assert_eq!(call.request, request);
    let response = ResetResponse {
        success: true,
        message: "done".into(),
    };
    call.respond(&response).unwrap();
    assert_eq!(caller.line(), padded(&response));
    caller.finish();
    let tokens = tokens_of(&side, "SS");
    let wanted = "/@ros2_lv/SS/wm§planner§reset/wm_msgs§srv§Reset";
    assert!(
        tokens.iter().any(|token| token.ends_with(wanted)),
        "{tokens:?}"
    );

    // invalid CDR results in an error, and the service continues
    let mut caller = side.peer(&["call", "wm/planner/reset", "ffffffff"]);
    let line = caller.line();
    assert!(line.starts_with("error ") && line.contains("CDR"), "{line}");
}

#[tokio::test(flavor = "multi_thread")]
async fn node_calls_a_service_of_another_bridge() {
    let Some(side) = side() else { return };
    // the response equals the request, so both types have equal bytes
    let mut server = side.peer(&["serve", "wm/echo", "wm_msgs/srv/Reset"]);
    let client = side
        .site
        .node
        .raw_client("echo", "wm_msgs/srv/Reset")
        .unwrap();
    soon("finding the service", client.wait_for_service()).await;
    let request = ResetRequest {
        seed: 3,
        keep_seed: false,
    };
    let bytes = cdr::to_bytes(&request).unwrap();
    let answer = soon("the answer", client.call(bytes.into())).await.unwrap();
    assert_eq!(hex(&answer), padded(&request));
    let line = server.line();
    let (sent, attachment) = line.split_once(' ').unwrap();
    assert_eq!(sent, padded(&request));
    // "rqh", 16 bytes, little-endian
    assert!(attachment.starts_with("727168") && attachment.ends_with("01"));
    assert_eq!(attachment.len(), 2 * 20);
    server.finish();
}
