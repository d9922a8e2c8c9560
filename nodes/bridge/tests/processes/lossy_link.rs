//! Two machines, as network namespaces, with 50 ms and 2 % loss between them.

use crate::harness::{Process, Site, bridge_inside, soon};
use bytes::Bytes;
use std::{
    fs::File,
    io::{BufRead as _, BufReader},
    os::fd::AsFd as _,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use wm_msgs::wm_msgs::{Reset, ResetRequest, ResetResponse};
use wm_ros::Qos;

const DELAY: Duration = Duration::from_millis(50);
const LOSS: f64 = 0.02;
const SEED: u32 = 7;

/// Messages of the size of a prediction, at the camera's rate.
const MESSAGES: usize = 60;
const PERIOD: Duration = Duration::from_millis(200);
const TYPE: &str = "std_msgs/msg/String";

fn ip(args: &[&str]) -> bool {
    let status = Command::new("ip").args(args).status();
    status.is_ok_and(|status| status.success())
}

/// Two namespaces and the link between them, until it is dropped.
struct Link {
    namespaces: [String; 2],
    relay: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Link {
    /// `None`, with a plain message, where this takes rights that the test does not have.
    fn new() -> Option<Self> {
        let skip = |reason: &str| eprintln!("skipped: the test over a lossy link {reason}");
        if !rustix::process::geteuid().is_root() {
            skip("needs root");
            return None;
        }
        if File::options()
            .read(true)
            .write(true)
            .open("/dev/net/tun")
            .is_err()
        {
            skip("needs /dev/net/tun");
            return None;
        }
        let namespaces = ["a", "b"].map(|end| format!("wm{}{end}", std::process::id()));
        for namespace in &namespaces {
            if !ip(&["netns", "add", namespace]) {
                skip("needs `ip netns add`");
                return None;
            }
        }
        let mut relay = Command::new("python3")
            .arg(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/tests/processes/link.py"
            ))
            .args(&namespaces)
            .args([
                DELAY.as_millis().to_string(),
                LOSS.to_string(),
                SEED.to_string(),
            ])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut link = Self {
            namespaces,
            output: BufReader::new(relay.stdout.take().unwrap()),
            relay,
        };
        assert_eq!(link.line(), "ready");
        Some(link)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }

    fn bridge(&self, end: usize, args: &[&str]) -> Process {
        let inside = ["ip", "netns", "exec", &self.namespaces[end]];
        // The same domain on both machines: they do not see each other but for the bridges.
        bridge_inside(&inside, 0, args)
    }

    /// A participant at that end: what it opens, and the threads that it starts, are of the namespace.
    fn site(&self, end: usize) -> Site {
        let path = format!("/run/netns/{}", self.namespaces[end]);
        let joining = std::thread::spawn(move || {
            let file = File::open(path).unwrap();
            rustix::thread::move_into_link_name_space(file.as_fd(), None).unwrap();
            Site::join(0)
        });
        joining.join().unwrap()
    }

    /// How many packets it carried and dropped.
    fn finish(mut self) -> (u64, u64) {
        drop(self.relay.stdin.take());
        let line = self.line();
        let (count, dropped) = line.split_once(' ').unwrap();
        (count.parse().unwrap(), dropped.parse().unwrap())
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        if matches!(self.relay.try_wait(), Ok(None)) {
            self.relay.kill().ok();
            self.relay.wait().ok();
        }
        for namespace in &self.namespaces {
            ip(&["netns", "delete", namespace]);
        }
    }
}

/// A string of `len` bytes that begins with its number, as CDR.
fn message(number: usize, len: usize) -> Bytes {
    let text = format!("{number:06}{}", "x".repeat(len - 6));
    let text = wm_msgs::std_msgs::String { data: text };
    let mut bytes = wm_msgs::cdr::to_bytes(&text).unwrap();
    // DDS fills up to this on its way.
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes.into()
}

#[tokio::test(flavor = "multi_thread")]
async fn predictions_at_5_hz_and_a_call_cross_50_ms_and_2_percent_loss() {
    let Some(link) = Link::new() else { return };
    let robot_bridge = link.bridge(0, &["--listen", "tcp/10.99.0.1:7447", "--allow", "/wm/.*"]);
    let desk_bridge = link.bridge(1, &["--connect", "tcp/10.99.0.1:7447", "--allow", "/wm/.*"]);
    let (robot, desk) = (link.site(0), link.site(1));

    let predicted = robot
        .node
        .raw_publisher("predicted", TYPE, Qos::reliable(10))
        .unwrap();
    let mut received = desk
        .node
        .raw_subscription("predicted", TYPE, Qos::reliable(100))
        .unwrap();
    let mut planner = robot.node.service::<Reset>("planner/reset").unwrap();
    let client = desk.node.client::<Reset>("planner/reset").unwrap();
    soon("connecting", async {
        predicted.wait_for_subscribers(1).await;
        received.wait_for_publishers(1).await;
        client.wait_for_service().await;
    })
    .await;

    let sending = tokio::spawn(async move {
        let mut ticks = tokio::time::interval(PERIOD);
        for number in 0..MESSAGES {
            ticks.tick().await;
            // 4 to 10 KB
            let len = 4000 + number * 100;
            predicted.publish(message(number, len)).unwrap();
        }
        predicted
    });
    let mut times = Vec::new();
    for number in 0..MESSAGES {
        let sample = soon("a prediction", received.recv()).await.unwrap();
        let expected = message(number, 4000 + number * 100);
        assert!(
            sample.message == expected,
            "prediction {number} came changed"
        );
        times.push(Instant::now());
    }
    soon("sending", sending).await.unwrap();
    let took = times[MESSAGES - 1] - times[0];
    let rate = (MESSAGES - 1) as f64 / took.as_secs_f64();
    let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let longest = gaps.max().unwrap();

    let answering = tokio::spawn(async move {
        let call = planner.recv().await.unwrap();
        let message = format!("seed {}", call.request.seed);
        let response = ResetResponse {
            success: true,
            message,
        };
        call.respond(&response).unwrap();
        planner
    });
    let request = ResetRequest {
        seed: 5,
        keep_seed: false,
    };
    let asked = Instant::now();
    let answer = soon("the answer", client.call(&request)).await.unwrap();
    let answered_in = asked.elapsed();
    assert_eq!(answer.message, "seed 5");
    soon("answering", answering).await.unwrap();

    drop((robot_bridge, desk_bridge));
    let (packets, dropped) = link.finish();
    eprintln!(
        "{MESSAGES} of {MESSAGES} predictions, {rate:.2} Hz, longest gap {longest:?}; a call in {answered_in:?}; \
         {dropped} of {packets} packets dropped"
    );
    assert!(
        dropped > 0 && packets > MESSAGES as u64,
        "nothing crossed the link"
    );
    assert!(
        answered_in >= 2 * DELAY,
        "the answer came in {answered_in:?}"
    );
    // All of them came, so the rate is the sender's but for the delay of the first or the last of them.
    assert!((4.5..5.5).contains(&rate), "{rate} Hz");
}
