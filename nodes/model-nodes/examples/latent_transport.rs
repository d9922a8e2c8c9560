//! How latents go from node to node: loss, latency and memory, from one participant to another by DDS on loopback, as
//! between processes, and within one participant in memory.
//!
//! `cargo run --release -p wm_model_nodes --example latent_transport -- [HEIGHT WIDTH CHANNELS [RATE_HZ [SECONDS [best_effort|reliable]]]]`
//!
//! Without arguments: 16x16x1024 in f16, 512 KiB, at 5 Hz for 10 s, with the nodes' own QoS. A latency is from before
//! the values are made a message until they are values again.

use std::{
    fs,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use wm_model::LatentSpace;
use wm_msgs::{std_msgs::Header, wm_msgs::Latent};
use wm_ros::{Context, Environment, Middleware, Node, NodeArgs, Qos, Reach, Subscription};
use wm_wire::latent_message::{LATENT_QOS, LatentDtype, decode_latent, encode_latent};

/// After the last latent, how long a late one may take.
const PATIENCE: Duration = Duration::from_secs(2);

struct Settings {
    space: LatentSpace,
    rate: f64,
    seconds: f64,
    qos: Qos,
}

impl Settings {
    fn read() -> Result<Self> {
        let words: Vec<String> = std::env::args().skip(1).collect();
        let number = |index: usize, default: f64| -> Result<f64> {
            let Some(word) = words.get(index) else {
                return Ok(default);
            };
            word.parse().with_context(|| format!("\"{word}\""))
        };
        Ok(Self {
            space: LatentSpace {
                name: "transport".into(),
                hash: "00".repeat(32),
                height: number(0, 16.0)? as usize,
                width: number(1, 16.0)? as usize,
                channels: number(2, 1024.0)? as usize,
            },
            rate: number(3, 5.0)?.max(0.01),
            seconds: number(4, 10.0)?,
            qos: match words.get(5).map(String::as_str) {
                None => LATENT_QOS,
                Some("best_effort") => Qos::sensor_data(),
                Some("reliable") => Qos::reliable(5),
                Some(other) => bail!("\"{other}\"; expected best_effort or reliable"),
            },
        })
    }
}

fn main() -> Result<()> {
    let settings = Settings::read()?;
    let environment = Environment {
        domain_id: 60 + (std::process::id() % 10) as u16,
        reach: Reach::Localhost,
        middleware: Middleware::from_env()?,
    };
    println!(
        "{} bytes, {}, {} Hz, net.core.rmem_max {}",
        settings.space.elements() * LatentDtype::F16.size(),
        settings.qos,
        settings.rate,
        fs::read_to_string("/proc/sys/net/core/rmem_max")
            .unwrap_or_default()
            .trim(),
    );
    let [here, there] = [Context::new(&environment)?, Context::new(&environment)?];
    for (how, receiver) in [("by DDS", &there), ("in memory", &here)] {
        println!("{how}: {}", measure(&settings, &here, receiver)?);
    }
    for context in [here, there] {
        context.shutdown().trigger();
        context.close();
    }
    Ok(())
}

fn measure(settings: &Settings, here: &Context, there: &Context) -> Result<String> {
    let args = NodeArgs::parse(Vec::<String>::new())?;
    let node = |context, name| Node::new(context, name, wm_ros::NAMESPACE, &args);
    let (sender, receiver) = (node(here, "sender")?, node(there, "receiver")?);
    let publisher = sender.publisher::<Latent>("latent", settings.qos)?;
    let subscription = receiver.subscription::<Latent>("latent", settings.qos)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;

    let count = (settings.rate * settings.seconds).round().max(1.0) as usize;
    let (space, values) = (settings.space.clone(), values(&settings.space));
    let before = resident_kib();
    let received = runtime.block_on(async {
        publisher.wait_for_subscribers(1).await;
        subscription.wait_for_publishers(1).await;
        let receiving = tokio::spawn(receive(subscription, space.clone(), count));
        let mut tick = tokio::time::interval(Duration::from_secs_f64(1.0 / settings.rate));
        for _ in 0..count {
            tick.tick().await;
            let header = Header {
                stamp: sender.now(),
                frame_id: "camera".into(),
            };
            publisher.publish(&encode_latent(&values, &space, LatentDtype::F16, header)?)?;
        }
        receiving.await.context("the receiver")?
    })?;
    let (mut latencies, lost) = received;
    latencies.sort_by(f64::total_cmp);
    let part = |q: f64| {
        let last = latencies.len().saturating_sub(1) as f64;
        latencies.get((q * last).round() as usize).copied()
    };
    let ms = |q| part(q).unwrap_or(f64::NAN);
    Ok(format!(
        "n {count}, lost {}, gaps counted {lost}, p50 {:.2} ms, p95 {:.2} ms, p99 {:.2} ms, memory + {} KiB",
        count - latencies.len(),
        ms(0.5),
        ms(0.95),
        ms(0.99),
        resident_kib().saturating_sub(before),
    ))
}

/// Latencies \[ms\] of what came, and how many gaps the subscription saw.
async fn receive(
    mut subscription: Subscription<Latent>,
    space: LatentSpace,
    count: usize,
) -> Result<(Vec<f64>, u64)> {
    let mut latencies = Vec::with_capacity(count);
    let mut last = Instant::now();
    while latencies.len() < count && last.elapsed() < PATIENCE {
        let Ok(received) = tokio::time::timeout(PATIENCE, subscription.recv()).await else {
            break;
        };
        let Some(received) = received else { break };
        decode_latent(&received.message, &space)?;
        let sent_ns = received.message.header.stamp.to_nanos();
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH)?;
        // Nanoseconds since 1970 fit into 64 bits until 2262.
        latencies.push((now.as_nanos() as i64 - sent_ns) as f64 / 1e6);
        last = Instant::now();
    }
    Ok((latencies, subscription.lost()))
}

/// Values that f16 holds, none like its neighbour.
fn values(space: &LatentSpace) -> Vec<f32> {
    (0..space.elements())
        .map(|index| (index % 2039) as f32 / 512.0 - 2.0)
        .collect()
}

/// Resident memory of this process.
fn resident_kib() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1));
    number
        .and_then(|number| number.parse().ok())
        .unwrap_or_default()
}
