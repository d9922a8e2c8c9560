//! Faults of other nodes: stopped and slow subscribers, killed nodes, shutdown. The test is a node of the graph and
//! sees what an operator sees.

// each test has its own runtime, in which nothing else takes the lock
#![allow(clippy::await_holding_lock)]

use std::{
    path::Path,
    time::{Duration, Instant},
};

use wm_bag::{BagReader, BagWriter, QosProfile, Reliability, WriterOptions};
use wm_msgs::{
    Message,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    std_msgs,
    wm_msgs::{Latent, Prediction},
};
use wm_ros::{Middleware, Qos, Subscription};

use crate::harness::{
    Process, Signal, bundled_bag, children, fresh_domain, join, looping_player, resident,
    wait_until, whole_suite, wm,
};

/// Far longer than a working suite needs; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(60);
const MIB: u64 = 1 << 20;
/// How soon a killed node works again, and how soon a node ends after a signal; longer if a busy machine starts it more
/// slowly.
const BACK: Duration = Duration::from_secs(5);
const GONE: Duration = Duration::from_secs(2);
/// How long a subscriber is stopped.
const STOP: Duration = Duration::from_secs(12);

async fn next<M: Message>(subscription: &mut Subscription<M>) -> M {
    let received = tokio::time::timeout(PATIENCE, subscription.recv()).await;
    received
        .unwrap_or_else(|_| panic!("nothing on {} for {PATIENCE:?}", subscription.topic()))
        .expect("the observer is not shut down")
        .message
}

/// Waits for a status of this name that satisfies a condition.
async fn diagnosed(
    diagnostics: &mut Subscription<DiagnosticArray>,
    name: &str,
    is_wanted: impl Fn(&DiagnosticStatus) -> bool,
) -> DiagnosticStatus {
    let start = Instant::now();
    loop {
        let array = next(diagnostics).await;
        let found = array.status.into_iter().find(|status| status.name == name);
        if let Some(status) = found.filter(|status| is_wanted(status)) {
            return status;
        }
        assert!(start.elapsed() < PATIENCE, "{name} is not as wanted");
    }
}

/// A topic of large messages.
struct Heavy {
    bytes: usize,
    hz: u64,
    qos: QosProfile,
    /// The largest growth of the publisher beyond the bytes it sends meanwhile \[byte\].
    growth: u64,
}

/// Two seconds of the topic, with numbered messages.
fn heavy_bag(path: &Path, heavy: &Heavy) {
    let mut bag = BagWriter::create(path, WriterOptions::default()).expect("a new bag");
    bag.add_topic::<std_msgs::String>("/heavy", heavy.qos)
        .expect("a new topic");
    for index in 0..2 * heavy.hz {
        let data = format!("{index:04}{}", "x".repeat(heavy.bytes));
        let message = std_msgs::String { data };
        let time_ns = 1_700_000_000_000_000_000 + index * 1_000_000_000 / heavy.hz;
        bag.write("/heavy", &message, time_ns).expect("a message");
    }
    bag.finish().expect("the end of the bag");
}

/// Twice a latent of the bundled model, at four times a camera's rate.
#[tokio::test(flavor = "current_thread")]
async fn stopped_reliable_subscriber_costs_only_missed_messages() {
    stopped_subscriber(Heavy {
        bytes: 8_192,
        hz: 20,
        qos: QosProfile::reliable(),
        growth: 8 * MIB,
    })
    .await;
}

/// Like native semantic latents: 16 x 16 x 1024 in f16 at 5 Hz.
#[tokio::test(flavor = "current_thread")]
async fn stopped_best_effort_subscriber_costs_its_publisher_nothing() {
    stopped_subscriber(Heavy {
        bytes: 524_288,
        hz: 5,
        qos: QosProfile::sensor_data(),
        growth: 8 * MIB,
    })
    .await;
}

async fn stopped_subscriber(heavy: Heavy) {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let (bag, recorded) = (dir.path().join("heavy"), dir.path().join("recorded"));
    heavy_bag(&bag, &heavy);
    let domain = fresh_domain();
    let (_context, node) = join(domain, "observer");
    let is_reliable = heavy.qos.reliability == Reliability::Reliable;
    let qos = |depth| match is_reliable {
        true => Qos::reliable(depth),
        false => Qos::best_effort(depth),
    };
    let mut others = node
        .subscription::<std_msgs::String>("/heavy", qos(1000))
        .expect("a subscription");
    let mut slow = node
        .subscription::<std_msgs::String>("/heavy", qos(2))
        .expect("a subscription");
    let player = Process::start(wm(
        domain,
        &["bag", "play", "--loop", &bag.to_string_lossy()],
    ));
    let record = ["bag", "record", "--compression-format", "none", "-o"];
    let what = [recorded.to_str().expect("a path in UTF-8"), "/heavy"];
    let recorder = Process::start(wm(domain, &[&record[..], &what].concat()));
    let file = recorded.join("recorded_0.mcap");
    let size = || file.metadata().map_or(0, |metadata| metadata.len());
    wait_until("a recording", PATIENCE, || size() > heavy.bytes as u64);
    // the publisher's memory while all receive: it reads its bag ahead, again and again
    let (before, _) = most_resident(&player, &mut others).await;
    recorder.signal(Signal::STOP);
    let (most, received) = most_resident(&player, &mut others).await;
    let (grown, sent) = (most.saturating_sub(before), received * heavy.bytes as u64);
    println!(
        "a subscriber stopped for {STOP:?}: {received} messages, {} MiB, sent to others; the publisher had {} MiB \
         at most, {} MiB before",
        sent / MIB,
        most / MIB,
        before / MIB
    );
    // a reliable publisher keeps missed messages up to its window; others keep nothing
    let kept = if is_reliable { sent } else { 0 };
    assert!(grown < kept + heavy.growth, "{} MiB", grown / MIB);
    let expected = STOP.as_secs() * heavy.hz;
    assert!(
        received > expected * 8 / 10,
        "{received} of {expected} came to the other subscriber"
    );
    assert_eq!((others.lost(), others.dropped()), (0, 0));

    // a subscriber that does not read keeps its queue, and then gets the newest messages
    assert!(slow.dropped() >= received, "{} dropped", slow.dropped());
    assert_eq!(slow.lost(), 0);
    let waiting = std::iter::from_fn(|| slow.try_recv()).count();
    assert_eq!(waiting, 2);

    recorder.signal(Signal::CONT);
    if Middleware::from_env().expect("a middleware of this build") == Middleware::Zenoh {
        recorder.signal(Signal::INT);
        let (status, _) = recorder.finish(Duration::from_secs(10));
        // 3: messages are missing, those of the stop
        assert!(matches!(status.code(), Some(0 | 3)), "{status}");
        let reader = BagReader::open(&recorded).expect("a recording");
        assert!(reader.messages().all(|message| message.is_ok()));
        return;
    }
    // the DDS library does not survive a stop: the node detects this and ends, and its supervisor restarts it
    let continued = Instant::now();
    let (status, _) = recorder.finish(Duration::from_secs(10));
    assert_eq!(status.code(), Some(1), "{status}");
    let reader = BagReader::open(&recorded).expect("what was recorded before the stop");
    assert!(reader.messages().all(|message| message.is_ok()));
    println!(
        "the stopped process has ended {:?} after it went on",
        continued.elapsed()
    );

    let mut newest = node
        .subscription::<std_msgs::String>("/heavy", qos(1))
        .expect("a subscription");
    next(&mut newest).await;
    println!(
        "a subscriber in its place has the newest after {:?}",
        continued.elapsed()
    );
    for _ in 0..heavy.hz {
        next(&mut others).await;
    }
    assert_eq!((others.lost(), others.dropped()), (0, 0));
}

/// Reads during the stop; returns the publisher's largest memory \[byte\] and the number of messages.
async fn most_resident(
    publisher: &Process,
    subscription: &mut Subscription<std_msgs::String>,
) -> (u64, u64) {
    let (start, mut most, mut received) = (Instant::now(), 0, 0);
    while start.elapsed() < STOP {
        next(subscription).await;
        received += 1;
        most = most.max(resident(publisher.pid()));
    }
    (most, received)
}

fn launch(domain: u16, arguments: &[&str]) -> Process {
    Process::start(wm(domain, &[&["launch"][..], arguments].concat()))
}

#[tokio::test(flavor = "current_thread")]
async fn killed_node_works_again_within_five_seconds() {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let output = dir.path().join("out");
    let domain = fresh_domain();
    let (_context, node) = join(domain, "observer");
    let mut latents = node
        .subscription::<Latent>("/wm/latent", Qos::best_effort(100))
        .expect("a subscription");
    let mut predictions = node
        .subscription::<Prediction>("/wm/predicted", Qos::best_effort(1000))
        .expect("a subscription");
    let start = Instant::now();
    let suite = launch(
        domain,
        &[
            "launch-configs/live.launch.yaml",
            &format!("output:={}", output.display()),
        ],
    );
    let _player = looping_player(domain);
    next(&mut predictions).await;
    let started_after = start.elapsed();
    let before = children(suite.pid());
    let find = |name: &str| {
        let named = before
            .iter()
            .find(|(_, command)| command.iter().any(|word| word == name));
        named.map(|(pid, _)| *pid).expect("a process of the launch")
    };

    rustix::process::kill_process(find("encoder"), Signal::KILL).expect("it runs");
    let killed = Instant::now();
    // messages and rollouts from before its end may still be on their way
    tokio::time::sleep(Duration::from_millis(300)).await;
    let mut last_ns = 0;
    while let Some(received) = latents.try_recv() {
        last_ns = received.message.header.stamp.to_nanos();
    }
    let is_new = |observed_ns: i64| {
        // the bag restarts every ten seconds
        observed_ns > last_ns || last_ns - observed_ns > 5_000_000_000
    };
    while !is_new(next(&mut predictions).await.observed_stamp.to_nanos()) {}
    let predicted_after = killed.elapsed();
    next(&mut latents).await;
    println!(
        "encoder killed: predictions of new frames after {predicted_after:?}, a bystander has a latent after {:?}; the \
         launch took {started_after:?}",
        killed.elapsed()
    );
    assert!(
        predicted_after < BACK.max(started_after),
        "{predicted_after:?}"
    );

    let after = children(suite.pid());
    for name in ["predictor", "decoder", "planner", "monitor"] {
        let (pid, _) = after
            .iter()
            .find(|(_, command)| command.iter().any(|word| word == name))
            .expect("it goes on");
        assert_eq!(*pid, find(name), "{name} is another process");
    }
    let said = suite.stderr();
    assert!(
        said.contains("encoder-1 failed: signal 9 (SIGKILL)")
            && said.contains("restarting encoder-1 (no. 1)"),
        "{said}"
    );
    suite.signal(Signal::INT);
    suite.finish(Duration::from_secs(20));
}

#[tokio::test(flavor = "current_thread")]
async fn node_reports_a_missing_killed_node() {
    let _alone = whole_suite();
    let domain = fresh_domain();
    let (_context, node) = join(domain, "observer");
    let mut diagnostics = node
        .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(100))
        .expect("a subscription");
    let encoder = Process::start(wm(domain, &["encoder"]));
    let _predictor = Process::start(wm(domain, &["predictor"]));
    let _player = looping_player(domain);
    let input = "wm/predictor: input latents";
    let is = |level: u8| move |status: &DiagnosticStatus| status.level == level;
    let comes = |status: &DiagnosticStatus| status.message == "latents come";
    diagnosed(&mut diagnostics, input, comes).await;

    encoder.signal(Signal::KILL);
    let killed = Instant::now();
    let warned = diagnosed(&mut diagnostics, input, is(DiagnosticStatus::WARN)).await;
    let warned_after = killed.elapsed();
    let status = diagnosed(&mut diagnostics, input, is(DiagnosticStatus::ERROR)).await;
    println!(
        "encoder killed: WARN after {warned_after:?}, ERROR after {:?}: {}",
        killed.elapsed(),
        status.message
    );
    assert!(
        status.message.contains("no latents on /wm/latent for"),
        "{status:?}"
    );
    assert!(
        warned.message.contains("silent") || warned.message.contains("start the encoder"),
        "{warned:?}"
    );
    // the node's own status, which simple tools show, has the same level
    let is_said = |status: &DiagnosticStatus| status.message.contains("no latents");
    let own = diagnosed(&mut diagnostics, "wm/predictor", is_said).await;
    assert_eq!(own.level, DiagnosticStatus::ERROR);

    let _encoder = Process::start(wm(domain, &["encoder"]));
    diagnosed(&mut diagnostics, input, comes).await;
}

#[test]
fn log_names_a_camera_on_another_topic() {
    let _alone = whole_suite();
    let domain = fresh_domain();
    let encoder = Process::start(wm(domain, &["encoder"]));
    let bag = bundled_bag();
    let front = "/camera/image_raw/compressed:=/front/image_raw/compressed";
    let play = ["bag", "play", "--loop", &bag.to_string_lossy(), "-m", front];
    let _player = Process::start(wm(domain, &play));
    wait_until("a warning", PATIENCE, || {
        encoder.stderr().contains("no camera images on")
    });
    let camera = "there are camera images on /front/image_raw/compressed";
    assert!(encoder.stderr().contains(camera));
}

#[tokio::test(flavor = "current_thread")]
async fn every_node_ends_within_two_seconds_of_either_signal() {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let bag = format!("bag:=\"{}\"", bundled_bag().display());
    for (index, signal) in [Signal::INT, Signal::TERM].into_iter().enumerate() {
        let domain = fresh_domain();
        let (_context, node) = join(domain, "observer");
        let mut diagnostics = node
            .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(100))
            .expect("a subscription");
        let output = |name: &str| format!("output:={}/{name}{index}", dir.path().display());
        let (recorded, report) = (output("bag"), output("report"));
        let nodes: [(&str, Vec<&str>); 7] = [
            ("encoder", vec![]),
            ("predictor", vec![]),
            ("decoder", vec![]),
            ("planner", vec![]),
            ("monitor", vec![report.as_str()]),
            ("recorder", vec![recorded.as_str(), "topics:=[/nothing]"]),
            ("player", vec![bag.as_str(), "loop:=true"]),
        ];
        let mut running = Vec::new();
        let start = Instant::now();
        for (name, parameters) in nodes {
            let mut args = vec![name, "--ros-args"];
            for parameter in parameters {
                args.extend(["-p", parameter]);
            }
            running.push((name, Process::start(wm(domain, &args))));
        }
        for (name, process) in running {
            // a managed node first loads its weights
            let is_active = |status: &DiagnosticStatus| {
                let message = status.message.as_str();
                !message.starts_with("unconfigured") && !message.starts_with("inactive")
            };
            diagnosed(&mut diagnostics, &format!("wm/{name}"), is_active).await;
            let started_after = start.elapsed();
            process.signal(signal);
            let asked = Instant::now();
            let (status, _) = process.finish(GONE.max(started_after));
            println!("{name}: gone {:?} after {signal:?}", asked.elapsed());
            // a monitor without predictions fails, but ends as fast
            let is_right = status.success() || (name == "monitor" && status.code() == Some(1));
            assert!(is_right, "{name} ended with {status} on {signal:?}");
        }
    }
}
