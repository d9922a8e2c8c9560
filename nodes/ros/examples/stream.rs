//! One end of a stream of samples, to measure a middleware between processes: `benches/middlewares.py` starts both ends.
//!
//! `stream send BYTES HZ COUNT QOS [LINGER_S]` waits for a subscription, publishes COUNT samples, and stays for LINGER_S.
//! `stream receive SECONDS QOS` counts what arrives until nothing has come for SECONDS. QOS is best_effort, reliable or
//! latched. Each prints one line of JSON. A latency is from before a sample is encoded until its bytes are received.

use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use wm_ros::{Node, NodeArgs, Qos};

type Failure = Box<dyn std::error::Error>;

const TOPIC: &str = "/stream";
/// Any type will do: the bytes are not decoded.
const TYPE: &str = "std_msgs/msg/String";
/// The header of CDR and the time of sending.
const PREFIX: usize = 12;

fn main() -> Result<(), Failure> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    let words: Vec<String> = args.rest().to_vec();
    let name = words.first().cloned().unwrap_or_default();
    wm_ros::run(&name, "/", &args, async |node: Node| -> Result<(), Error> {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let line = match words[..] {
            ["send", bytes, rate, count, qos] => send(&node, bytes, rate, count, qos, "0").await,
            ["send", bytes, rate, count, qos, linger] => {
                send(&node, bytes, rate, count, qos, linger).await
            }
            ["receive", seconds, qos] => receive(&node, seconds, qos).await,
            _ => Err("expected: send BYTES HZ COUNT QOS [LINGER_S], or receive SECONDS QOS".into()),
        };
        println!("{}", line.map_err(|error| Error(error.to_string()))?);
        Ok(())
    })
    .map_err(Failure::from)
}

#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Error(String);

impl From<wm_ros::Error> for Error {
    fn from(error: wm_ros::Error) -> Self {
        Self(error.to_string())
    }
}

fn qos_of(name: &str) -> Result<Qos, Failure> {
    match name {
        "best_effort" => Ok(Qos::best_effort(5)),
        "reliable" => Ok(Qos::reliable(10)),
        "latched" => Ok(Qos::latched(1)),
        other => Err(format!("{other}: expected best_effort, reliable or latched").into()),
    }
}

async fn send(
    node: &Node,
    bytes: &str,
    rate: &str,
    count: &str,
    qos: &str,
    linger: &str,
) -> Result<String, Failure> {
    let (bytes, rate): (usize, f64) = (bytes.parse()?, rate.parse()?);
    let (count, linger): (usize, f64) = (count.parse()?, linger.parse()?);
    let publisher = node.raw_publisher(TOPIC, TYPE, qos_of(qos)?)?;
    if qos != "latched" {
        publisher.wait_for_subscribers(1).await;
    }
    let mut tick = tokio::time::interval(Duration::from_secs_f64(1.0 / rate));
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut calls = Vec::with_capacity(count);
    for _ in 0..count {
        tick.tick().await;
        let mut sample = vec![7; bytes.max(PREFIX)];
        sample.splice(..4, [0, 1, 0, 0]);
        sample.splice(4..PREFIX, now_ns()?.to_le_bytes());
        let began = Instant::now();
        publisher.publish(Bytes::from(sample))?;
        calls.push(began.elapsed().as_secs_f64() * 1e3);
    }
    tokio::time::sleep(Duration::from_secs_f64(linger)).await;
    Ok(format!(
        "{{\"sent\": {count}, \"dropped\": {}, {}, \"resident_kib\": {}}}",
        publisher.dropped(),
        quantiles("call_ms", &mut calls),
        resident_kib()
    ))
}

async fn receive(node: &Node, seconds: &str, qos: &str) -> Result<String, Failure> {
    let patience = Duration::from_secs_f64(seconds.parse()?);
    let mut subscription = node.raw_subscription(TOPIC, TYPE, qos_of(qos)?)?;
    let began = Instant::now();
    let mut first_ms = None;
    let mut latencies = Vec::new();
    while let Ok(Some(received)) = tokio::time::timeout(patience, subscription.recv()).await {
        let sent = received.message.get(4..PREFIX).ok_or("a short sample")?;
        let sent = i64::from_le_bytes(sent.try_into()?);
        latencies.push((now_ns()? - sent) as f64 / 1e6);
        first_ms.get_or_insert_with(|| began.elapsed().as_secs_f64() * 1e3);
    }
    Ok(format!(
        "{{\"received\": {}, \"lost\": {}, \"dropped\": {}, {}, \"first_ms\": {}, \"resident_kib\": {}}}",
        latencies.len(),
        subscription.lost(),
        subscription.dropped(),
        quantiles("latency_ms", &mut latencies),
        first_ms.map_or("null".into(), |ms| format!("{ms:.1}")),
        resident_kib()
    ))
}

fn quantiles(name: &str, values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let of = |q: f64| {
        let last = values.len().saturating_sub(1) as f64;
        let value = values.get((q * last).round() as usize).copied();
        value.map_or("null".into(), |value| format!("{value:.2}"))
    };
    format!(
        "\"{name}\": [{}, {}, {}, {}]",
        of(0.5),
        of(0.95),
        of(0.99),
        of(1.0)
    )
}

fn now_ns() -> Result<i64, Failure> {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
    Ok(i64::try_from(now.as_nanos())?)
}

/// Resident memory of this process; 0 if the system does not tell.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default(); // not Linux
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1));
    number.and_then(|number| number.parse().ok()).unwrap_or(0)
}
