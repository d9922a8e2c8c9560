//! What a player waits for: other nodes, acknowledgements, moments.

use super::Player;
use anyhow::Result;
use std::time::Duration;
use tokio::time::{Instant, Interval};
use tracing::warn;

/// How long the graph must not change before the first message, if the player waits for other nodes.
const QUIET: Duration = Duration::from_millis(500);

impl Player<'_> {
    /// Waits, but not for ever, until the topics named in `wait_for` have a publisher and a subscriber.
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
                // With an error the graph is gone: the timeout or the shutdown ends the wait.
                if changes.changed().await.is_err() {
                    std::future::pending::<()>().await;
                }
            }
            // A topic may have further subscribers, and they have yet to discover this node. A node makes its endpoints one
            // after another, so a quiet graph is complete.
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

    /// Waits until reliable subscribers have everything, where that is wanted.
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

/// The next tick of the clock; pending without one.
pub(super) async fn tick(ticks: &mut Option<Interval>) {
    match ticks {
        Some(ticks) => {
            ticks.tick().await;
        }
        None => std::future::pending().await,
    }
}

/// tokio's timers count whole milliseconds and end after the moment: the thread itself sleeps the last ones, so that a
/// frame leaves at the time of its stamp.
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
