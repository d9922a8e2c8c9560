//! The messages that a player publishes.

use super::{BufferedMessage, Player};
use anyhow::Result;
use std::time::Duration;
use tokio::time::{Interval, MissedTickBehavior};
use tracing::{error, warn};
use wm_bag::BagMessage;
use wm_msgs::{builtin_interfaces::Time, rosgraph_msgs::Clock};
use wm_ros::frame_trace;

impl Player<'_> {
    /// Publishes time, goal and chunk before the messages from this log time on.
    pub(super) fn begin(&mut self, bag_ns: u64) -> Result<()> {
        // 292 years.
        let elapsed_ns = i64::try_from(self.epoch.elapsed().as_nanos()).unwrap_or(i64::MAX);
        self.epoch_ns = self.node.now().to_nanos().saturating_sub(elapsed_ns);
        // The clock first: nodes that follow it drop their old history.
        if self.settings.parameters.clock_hz > 0.0 {
            self.publish_clock(bag_ns)?;
        }
        self.publish_goal()?;
        // The first frame needs a chunk, even if no action precedes it.
        self.publish_chunk(bag_ns)
    }

    pub(super) fn publish_next(&mut self) -> Result<()> {
        let Some(BufferedMessage {
            message: Ok(message),
            ..
        }) = self.next.take()
        else {
            return Ok(());
        };
        if let Some(burst) = self.bursts.front_mut() {
            burst.published += 1;
        }
        if message.topic.as_ref() == self.settings.parameters.action_topic {
            self.publish_chunk(message.log_time_ns)?;
        }
        self.publish(&message)
    }

    /// The stamp to publish in place of `stamp_ns` in the bag.
    fn stamp_ns(&self, stamp_ns: i64) -> i64 {
        if self.settings.parameters.is_restamping {
            self.epoch_ns
                .saturating_add(self.playback.moment_ns(stamp_ns))
        } else {
            stamp_ns
        }
    }

    fn publish(&mut self, message: &BagMessage) -> Result<()> {
        let Some(track) = self.playlist.tracks.get(&message.topic) else {
            return Ok(());
        };
        let mut data = message.data.clone();
        let mut frame = None;
        if let Some(place) = track.stamp_place {
            let moved = place.restamp(&data, |stamp_ns| {
                let moved_ns = self.stamp_ns(stamp_ns);
                frame = track.is_camera.then(|| Time::from_nanos(moved_ns));
                moved_ns
            });
            match moved {
                Ok(moved) => data = moved,
                Err(problem) => {
                    let kept = self.kept_stamps.entry(message.topic.clone()).or_default();
                    if *kept == 0 {
                        warn!("{}: stamp kept: {problem}", message.topic);
                    }
                    *kept += 1;
                }
            }
        }
        let (publisher, is_clocked) = (track.publisher.clone(), track.is_clocked);
        if is_clocked {
            self.publish_clock(message.log_time_ns)?;
        }
        if let Some(frame) = frame {
            frame_trace::passed("image due", frame);
        }
        let published = publisher.publish(data);
        if let Some(frame) = frame {
            frame_trace::passed("image published", frame);
        }
        match published {
            Ok(()) => self.published += 1,
            // A malformed sample of one topic must not stop the other topics.
            Err(problem @ wm_ros::Error::Representation { .. }) => {
                let dropped = self.dropped.entry(message.topic.clone()).or_default();
                if *dropped == 0 {
                    error!("{}: message dropped: {problem}", message.topic);
                }
                *dropped += 1;
            }
            Err(problem) => return Err(problem.into()),
        }
        Ok(())
    }

    /// Publishes the chunk of the first action at or after this log time.
    fn publish_chunk(&self, log_time_ns: u64) -> Result<()> {
        if let (Some(publisher), Some(chunks)) = (&self.outlets.chunks, &self.playlist.chunks) {
            let rate = if self.settings.parameters.is_restamping {
                self.playback.rate()
            } else {
                1.0
            };
            let chunk = chunks.chunk(log_time_ns, rate, |stamp_ns| self.stamp_ns(stamp_ns));
            if let Some(chunk) = chunk {
                publisher.publish(&chunk)?;
            }
        }
        Ok(())
    }

    fn publish_goal(&self) -> Result<()> {
        if let (Some(publisher), Some(goal)) = (&self.outlets.goal, &self.playlist.goal) {
            let mut goal = goal.clone();
            goal.header.stamp = Time::from_nanos(self.stamp_ns(goal.header.stamp.to_nanos()));
            publisher.publish(&goal)?;
        }
        Ok(())
    }

    pub(super) fn clock_ticks(&self) -> Option<Interval> {
        if self.settings.parameters.clock_hz <= 0.0 {
            return None;
        }
        let mut ticks = tokio::time::interval(Duration::from_secs_f64(
            1.0 / self.settings.parameters.clock_hz,
        ));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        Some(ticks)
    }

    pub(super) fn publish_time(&mut self) -> Result<()> {
        let position_ns = self.playback.position_ns(self.epoch.elapsed());
        self.publish_clock(position_ns)
    }

    fn publish_clock(&mut self, bag_ns: u64) -> Result<()> {
        if let Some(clock) = &self.outlets.clock
            && let Some(clock_ns) = self.playback.clock_ns(bag_ns)
        {
            // The year 2262.
            let time_ns = i64::try_from(clock_ns).unwrap_or(i64::MAX);
            clock.publish(&Clock {
                clock: Time::from_nanos(time_ns),
            })?;
        }
        Ok(())
    }
}
