//! Unread terminals: a full pipe must not block nodes or their end.

use std::{
    io::{PipeReader, Read as _, Write as _},
    path::Path,
    process::Stdio,
    time::Duration,
};

use wm_bag::BagReader;
use wm_msgs::{diagnostic_msgs::DiagnosticArray, std_msgs};
use wm_ros::Qos;

use crate::harness::{Process, Signal, fresh_domain, join, wm};

/// Far longer than a working node needs; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(60);
/// How soon a node ends after a signal, on a busy machine.
const GONE: Duration = Duration::from_secs(10);
/// The capacity of a pipe on Linux \[byte\].
const CAPACITY: usize = 64 * 1024;

/// A full pipe that nothing reads.
fn full_pipe() -> (PipeReader, Stdio) {
    let (reader, mut writer) = std::io::pipe().expect("a pipe");
    writer.write_all(&[b'.'; CAPACITY]).expect("room in it");
    (reader, writer.into())
}

/// Starts `wm` on full pipes, lets it record the topic /told, and ends it.
async fn records_with_unread_output(args: &[&str], bag: &Path) {
    let domain_id = fresh_domain();
    let (_context, node) = join(domain_id, "observer");
    let told = node
        .publisher::<std_msgs::String>("/told", Qos::reliable(10))
        .expect("a publisher");
    let mut diagnostics = node
        .subscription::<DiagnosticArray>("/diagnostics", Qos::reliable(10))
        .expect("a subscription");

    let (out, err) = (full_pipe(), full_pipe());
    let mut command = wm(domain_id, args);
    command.stdout(out.1).stderr(err.1);
    let process = Process::start_with_output(command);
    let recorded = async {
        loop {
            let array = diagnostics.recv().await.expect("the observer runs").message;
            let own = array
                .status
                .iter()
                .filter(|status| status.name == "wm/recorder");
            let values = own.flat_map(|status| &status.values);
            let is_told = |key: &str| key == "received /told [total]";
            if values
                .into_iter()
                .any(|pair| is_told(&pair.key) && pair.value != "0")
            {
                return;
            }
            let data = "told".to_owned();
            told.publish(&std_msgs::String { data }).expect("a message");
        }
    };
    tokio::time::timeout(PATIENCE, recorded)
        .await
        .expect("a recorder that records");

    process.signal(Signal::INT);
    let (status, _) = process.finish(GONE);
    assert!(status.success(), "ended with {status}");
    assert!(BagReader::open(bag).expect("a bag").message_count() > 0);

    // the earlier output is still there, and nothing was added
    let mut text = Vec::new();
    let (mut reader, _) = err;
    reader.read_to_end(&mut text).expect("what is in the pipe");
    assert_eq!(text.len(), CAPACITY);
}

#[tokio::test(flavor = "current_thread")]
async fn node_with_unread_output_works_and_ends() {
    let scratch = tempfile::tempdir().expect("a temporary directory");
    let bag = scratch.path().join("bag");
    let output = format!("output:={}", bag.display());
    let args = [
        "recorder",
        "--ros-args",
        "-p",
        &output,
        "-p",
        "topics:=[/told]",
    ];
    records_with_unread_output(&args, &bag).await;
}

#[tokio::test(flavor = "current_thread")]
async fn launch_with_unread_output_works_and_ends() {
    let scratch = tempfile::tempdir().expect("a temporary directory");
    let bag = scratch.path().join("bag");
    let file = scratch.path().join("record.launch.yaml");
    let text = format!(
        "launch:\n- node:\n    pkg: wm_nodes\n    exec: recorder\n    namespace: wm\n    output: screen\n    param:\n    \
         - {{name: output, value: {:?}}}\n    - {{name: topics, value: [/told]}}\n",
        bag.display().to_string()
    );
    std::fs::write(&file, text).expect("a launch file");
    records_with_unread_output(&["launch", &file.display().to_string()], &bag).await;
}
