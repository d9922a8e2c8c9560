//! A policy in Rust: for every camera image two candidate chunks, of which it then takes the one that the evaluator finds
//! nearer to the goal; without an evaluator, or a goal, the first.
//!
//!     cargo run --release -p wm_model_nodes --example policy

use std::time::Duration;

use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    sensor_msgs::CompressedImage,
    wm_msgs::{Action, ActionCandidates, ActionChunk, Assessment, Timing},
};
use wm_ros::{Error, Node, NodeArgs, Publisher, Qos, Subscription};

/// The camera's period, and that of the actions \[ns\].
const PERIOD_NS: i64 = 200_000_000;
/// Camera-rate actions of a chunk: two steps of the embedded default.
const ACTIONS: i64 = 4;
/// How long an assessment is worth waiting for: less than a model step.
const PATIENCE: Duration = Duration::from_millis(300);

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    wm_ros::run(
        "policy",
        "/wm",
        &args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            let mut images = node.subscription::<CompressedImage>(
                "/camera/image_raw/compressed",
                Qos::best_effort(1),
            )?;
            let mut assessments =
                node.subscription::<Assessment>("assessment", Qos::reliable(10))?;
            let candidates =
                node.publisher::<ActionCandidates>("action_candidates", Qos::reliable(10))?;
            let chunks = node.publisher::<ActionChunk>("action_chunk", Qos::reliable(10))?;
            while let Some(received) = images.recv().await {
                let capture = received.message.header.stamp;
                let start = node.now();
                let mut offered = ActionCandidates {
                    policy: "two_ways".into(),
                    chunks: [0.01, -0.01].map(|sway| chunk(capture, sway)).into(),
                    ..ActionCandidates::default()
                };
                offered.header.stamp = capture;
                for chunk in &mut offered.chunks {
                    chunk.timing = Timing {
                        capture,
                        receive: received.received,
                        start,
                        end: node.now(),
                    };
                }
                let best = choose(&candidates, &offered, &mut assessments).await?;
                if let Some(chunk) = offered.chunks.get(best) {
                    chunks.publish(chunk)?;
                }
            }
            Ok(())
        },
    )
}

/// A chunk that moves the gripper sideways by `sway` \[m\] a frame, stamped with the image that it answers.
fn chunk(capture: Time, sway: f32) -> ActionChunk {
    let mut chunk = ActionChunk {
        period: RosDuration::from_nanos(PERIOD_NS),
        ..ActionChunk::default()
    };
    chunk.header.stamp = capture;
    chunk.header.frame_id = "base_link".into();
    for index in 0..ACTIONS {
        let mut action = Action {
            header: chunk.header.clone(),
            values: vec![0.0, sway, 0.0, 0.0, 0.0, 0.0, 1.0],
        };
        action.header.stamp = Time::from_nanos(capture.to_nanos() + index * PERIOD_NS);
        chunk.actions.push(action);
    }
    chunk
}

/// The candidate that the evaluator finds best, where it answers in time and knows a goal; else the first.
async fn choose(
    candidates: &Publisher<ActionCandidates>,
    offered: &ActionCandidates,
    assessments: &mut Subscription<Assessment>,
) -> Result<usize, Error> {
    candidates.publish(offered)?;
    if assessments.publishers() == 0 {
        return Ok(0);
    }
    let answer = async {
        while let Some(received) = assessments.recv().await {
            if received.message.candidates_stamp == offered.header.stamp {
                return usize::try_from(received.message.best).ok();
            }
        }
        None
    };
    let best = tokio::time::timeout(PATIENCE, answer).await;
    Ok(best.ok().flatten().unwrap_or(0))
}
