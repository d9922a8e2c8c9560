//! How long a latent of 512 KiB takes from one node to two others of the same process, in microseconds.
//!
//! `cargo run --release -p wm_ros --example handover`

use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use wm_msgs::wm_msgs::Latent;
use wm_ros::{Error, Node, NodeArgs, Qos};

const LEN: usize = 512 << 10;
const COUNT: usize = 2000;
/// As often as latents come from a fast camera, so that nothing queues up.
const PERIOD: Duration = Duration::from_millis(2);

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    args.expect_no_rest()?;
    wm_ros::run("handover", "/wm", &args, body)
}

async fn body(node: Node) -> Result<(), Error> {
    node.seal_parameters()?;
    let qos = Qos::best_effort(5);
    let publisher = node.publisher::<Latent>("handover", qos)?;
    let mut one = node.subscription::<Latent>("handover", qos)?;
    let mut two = node.subscription::<Latent>("handover", qos)?;
    let latent = Arc::new(Latent {
        data: vec![1; LEN],
        ..Latent::default()
    });
    let mut taken = Vec::with_capacity(COUNT);
    for _ in 0..COUNT {
        let begin = Instant::now();
        publisher.publish_shared(Arc::clone(&latent))?;
        for subscription in [&mut one, &mut two] {
            if subscription.recv_shared().await.is_none() {
                return Ok(());
            }
        }
        taken.push(begin.elapsed().as_micros());
        tokio::time::sleep(PERIOD).await;
    }
    taken.sort_unstable();
    let percentile = |part: usize| taken.get(COUNT * part / 100).copied().unwrap_or(0);
    println!(
        "{LEN} bytes to two subscriptions, n = {COUNT}: p50 {} us, p95 {} us, p99 {} us",
        percentile(50),
        percentile(95),
        percentile(99)
    );
    Ok(())
}
