//! Waiting: for other nodes, for acknowledgements, for a moment.

use super::Player;
use anyhow::Result;
use std::time::Duration;
use tokio::time::{Instant, Interval};
use tracing::warn;

/// The first message waits until the graph has not changed for this long.
const QUIET: Duration = Duration::from_millis(500);

impl Player<'_> {
    /// Waits until the topics of the parameter `wait_for` have a publisher and a subscriber, at most for `wait_timeout`.
    pub(super) async fn wait_for_others(&self) {
        if self.settings.parameters.wait_for.is_empty() {
            return;
        }
        let missing = || {
            let mut missing = Vec::new();
            for topic in &self.settings.parameters.wait_for {
                match (
                    self.node.count_publishers(topic),
                    self.node.count_subscribers(topic),
                ) {
                    (Ok(0), _) => missing.push(format!("a publisher of {topic}")),
                    (_, Ok(0)) => missing.push(format!("a subscriber of {topic}")),
                    (Err(problem), _) | (_, Err(problem)) => missing.push(problem.to_string()),
                    _ => {}
                }
            }
            missing
        };
        let mut changes = self.node.graph_changes();
        let all_there = async {
            while !missing().is_empty() {
                // After an error the graph does not change: the timeout or the shutdown ends the wait.
                if changes.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
            }
            // Further subscribers may still discover this node. A node creates its endpoints one after another, so a
            // graph without changes is complete.
            while let Ok(Ok(())) = tokio::time::timeout(QUIET, changes.changed()).await {}
        };
        if tokio::time::timeout(self.settings.parameters.wait_timeout, all_there)
            .await
            .is_err()
        {
            let waited = self.settings.parameters.wait_timeout.as_secs_f64();
            match missing().as_slice() {
                [] => warn!("starting after {waited:.1} s although the graph is still changing"),
                missing => warn!(
                    "starting after {waited:.1} s without {}",
                    missing.join(", ")
                ),
            }
        }
    }

    /// Waits for the acknowledgements of reliable subscribers, as the parameter `wait_for_all_acked` specifies.
    pub(super) async fn wait_for_acknowledgments(&self) -> Result<()> {
        let Some(limit) = self.settings.acknowledgment() else {
            return Ok(());
        };
        let begin = Instant::now();
        for (topic, track) in &self.playlist.tracks {
            let left = limit.saturating_sub(begin.elapsed());
            if track.is_reliable && !track.publisher.wait_for_acknowledgments(left).await? {
                warn!(
                    "{topic}: not all subscribers have acknowledged all messages after {:.1} s",
                    limit.as_secs_f64()
                );
            }
        }
        Ok(())
    }
}

/// Waits for the next tick; forever without a clock.
pub(super) async fn tick(ticks: &mut Option<Interval>) {
    match ticks {
        Some(ticks) => {
            ticks.tick().await;
        }
        None => std::future::pending().await,
    }
}

/// tokio's timers count whole milliseconds and end late. The thread itself sleeps the last milliseconds, so that a frame is
/// published at the time of its stamp.
const TIMER_STEPS: Duration = Duration::from_millis(2);

pub(super) async fn sleep_until(moment: Option<Instant>) {
    let Some(moment) = moment else {
        return std::future::pending().await;
    };
    if let Some(early) = moment.checked_sub(TIMER_STEPS) {
        tokio::time::sleep_until(early).await;
    }
    std::thread::sleep(moment.saturating_duration_since(Instant::now()));
}
