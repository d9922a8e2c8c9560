//! What a node says on its standard streams, in processes of their own: this test's binary started again for one of
//! the `child_` functions.

use crate::fresh_domain::fresh_domain;
use std::{
    io::{BufRead as _, BufReader, Write as _},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use wm_ros::{Error, Node, NodeArgs};

/// The capacity of a pipe on Linux \[byte\].
const CAPACITY: usize = 64 * 1024;
/// More lines than may wait for a reader.
const LINES: usize = 10_000;

/// Starts the ignored test `child`, whose standard error goes to `stderr`.
fn start(child: &str, stderr: impl Into<Stdio>) -> Child {
    let domain = fresh_domain();
    let child = format!("output::{child}");
    Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", &child, "--nocapture"])
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(stderr)
        .spawn()
        .unwrap()
}

/// Runs the ignored test `child` to its end; its exit code and standard error.
fn run(child: &str) -> (Option<i32>, String) {
    let output = start(child, Stdio::piped()).wait_with_output().unwrap();
    (
        output.status.code(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

/// Runs a node, and ends the process as a node's `main` does.
fn node(body: impl AsyncFnOnce(Node) -> Result<(), Error>) -> ! {
    let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
    let code = match wm_ros::run("talker", "/wm", &args, body) {
        Ok(()) => 0,
        Err(error) => {
            wm_ros::logging::last_words(format_args!("ended: {error}"));
            1
        }
    };
    std::process::exit(code)
}

#[test]
#[ignore = "started by the_oldest_lines_go_where_nobody_reads"]
fn child_that_says_much() {
    node(async |_| {
        for line in 0..LINES {
            tracing::info!("line {line} {}", "x".repeat(80));
        }
        println!("said");
        let mut go_on = String::new();
        std::io::stdin().read_line(&mut go_on).unwrap();
        Ok(())
    })
}

#[test]
fn the_oldest_lines_go_where_nobody_reads() {
    let (reader, mut writer) = std::io::pipe().unwrap();
    writer.write_all(&[b'.'; CAPACITY]).unwrap();
    let mut child = start("child_that_says_much", writer);
    let mut stdout = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(
        stdout.any(|line| line.unwrap() == "said"),
        "the child stands still"
    );
    let last = format!("line {} ", LINES - 1);
    let mut text = String::new();
    let mut reader = BufReader::new(reader);
    while !text.contains(&last) {
        assert!(
            reader.read_line(&mut text).unwrap() > 0,
            "the last line is missing"
        );
    }
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());

    let lines: Vec<&str> = text.trim_start_matches('.').lines().collect();
    let note = lines
        .iter()
        .position(|line| line.contains("lines were dropped here"))
        .unwrap();
    // Before the note comes the line that was being written, after it an unbroken rest.
    let number = |line: &&str| -> Option<usize> {
        line.split_once("line ")?.1.split(' ').next()?.parse().ok()
    };
    let rest: Vec<usize> = lines[note..].iter().filter_map(number).collect();
    assert_eq!(rest, (LINES - rest.len()..LINES).collect::<Vec<_>>());
}

#[test]
#[ignore = "started by a_peers_string_stays_in_its_line"]
fn child_that_repeats_a_peer() {
    node(async |_| {
        let peer = "camera\n[ERROR] [1.0] [wm.planner]: forged\u{1b}[2J";
        tracing::warn!(frame_id = peer, "unknown frame {peer}");
        Ok(())
    })
}

#[test]
fn a_peers_string_stays_in_its_line() {
    let (code, stderr) = run("child_that_repeats_a_peer");
    assert_eq!(code, Some(0), "{stderr}");
    assert!(!stderr.contains('\u{1b}'), "{stderr:?}");
    assert!(
        !stderr.lines().any(|line| line.starts_with("[ERROR]")),
        "{stderr}"
    );
    let escaped =
        r"unknown frame camera\n[ERROR] [1.0] [wm.planner]: forged\u{1b}[2J frame_id=camera\n";
    assert!(stderr.contains(escaped), "{stderr}");
}

#[test]
#[ignore = "started by a_panic_of_a_thread_ends_the_process_in_order"]
fn child_whose_thread_panics() {
    node(async |node: Node| {
        std::thread::Builder::new()
            .name("worker".to_owned())
            .spawn(|| panic!("out of luck"))
            .unwrap();
        node.shutdown().wait().await;
        wm_ros::logging::last_words("closed");
        Ok(())
    })
}

#[test]
fn a_panic_of_a_thread_ends_the_process_in_order() {
    let (code, stderr) = run("child_whose_thread_panics");
    assert_eq!(code, Some(1), "{stderr}");
    let said = |text: &str| {
        stderr
            .lines()
            .position(|line| line.contains(text))
            .unwrap_or(usize::MAX)
    };
    assert!(
        stderr
            .lines()
            .any(|line| line.starts_with("[ERROR]") && line.contains("[wm.talker]")),
        "{stderr}"
    );
    let order = [
        said("thread `worker` panicked at"),
        said("closed"),
        said("ended: thread `worker` panicked"),
    ];
    assert!(order.is_sorted() && order[2] < usize::MAX, "{stderr}");
}

#[test]
#[ignore = "started by a_process_that_hangs_after_a_panic_is_ended"]
fn child_that_hangs_after_a_panic() {
    node(async |_| {
        std::thread::spawn(|| panic!("out of luck"));
        loop {
            std::thread::park();
        }
    })
}

#[test]
fn a_process_that_hangs_after_a_panic_is_ended() {
    let start = Instant::now();
    let (code, stderr) = run("child_that_hangs_after_a_panic");
    assert_eq!(code, Some(101), "{stderr}");
    assert!(start.elapsed() < Duration::from_secs(30));
}
