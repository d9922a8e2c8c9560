//! The episode of a policy that is attached by topics.

use std::sync::Arc;

use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::Header,
    wm_msgs::{Action, ActionChunk},
};

use wm_motion::{
    actions::ActionEncoding,
    motion::{Chunk, Motion, MotionSettings},
};

use crate::history::{ChunkMerging, HistoryError, Timing, period_of, stamp_of_other};

/// The state of an episode that is played through topics: the policy's actions for the coming steps.
#[derive(Clone, Debug)]
pub struct Attached {
    episode_id: String,
    encoding: ActionEncoding,
    motion: Motion,
    timing: Timing,
    base_frame: String,
    stamp_ns: i64,
}

impl Attached {
    /// An episode of actions as `encoding` takes them, whose first observation is of `begin`.
    pub fn new(
        episode_id: String,
        encoding: ActionEncoding,
        timing: Timing,
        merging: ChunkMerging,
        begin: Time,
    ) -> Self {
        let settings = MotionSettings::of_period(timing.frame_period_ns);
        Self {
            episode_id,
            encoding,
            motion: Motion::new(settings).with_merging(merging),
            timing,
            base_frame: String::new(),
            stamp_ns: begin.to_nanos(),
        }
    }

    /// The episode.
    pub fn episode_id(&self) -> &str {
        &self.episode_id
    }

    /// Takes an action, and returns whether it arrived in time. An action for a time that has passed, or far ahead, is
    /// dropped.
    ///
    /// # Errors
    /// [`HistoryError`] says what is wrong with it.
    pub fn action(&mut self, action: &Action) -> Result<bool, HistoryError> {
        let stamp_ns = stamp_of_other("action", action.header.stamp)?;
        let is_late = stamp_ns < self.stamp_ns - self.timing.tolerance_ns;
        if is_late || self.is_far_ahead(stamp_ns) {
            return Ok(false);
        }
        let values = self.parse(action, "action")?;
        self.base_frame.clone_from(&action.header.frame_id);
        self.motion.take(stamp_ns, values);
        Ok(true)
    }

    /// Takes the next actions, and returns whether any of them is still to come. A chunk far ahead is dropped.
    ///
    /// # Errors
    /// [`HistoryError`] says what is wrong with the chunk.
    pub fn chunk(&mut self, chunk: &ActionChunk) -> Result<bool, HistoryError> {
        let stamp_ns = stamp_of_other("action chunk", chunk.header.stamp)?;
        // What is far ahead must not be the newest, which no later one may precede.
        if self.is_far_ahead(stamp_ns) {
            return Ok(false);
        }
        let actions = chunk.actions.iter();
        let actions = actions.map(|action| self.parse(action, "action of a chunk"));
        let actions = actions.collect::<Result<_, _>>()?;
        let space = self.encoding.space();
        let parsed = Chunk::new(space, stamp_ns, period_of(chunk)?, actions);
        let parsed = parsed.map_err(HistoryError::Chunk)?;
        if let Some(newest_ns) = self.motion.announced_ns()
            && stamp_ns < newest_ns
        {
            return Err(HistoryError::OutOfOrder {
                what: "action chunk",
                stamp_ns,
                newest_ns,
            });
        }
        let end_ns = parsed.end_ns();
        self.base_frame.clone_from(&chunk.header.frame_id);
        self.motion.announce(parsed, space);
        Ok(end_ns > self.stamp_ns)
    }

    /// The actions of the next step, one per frame period, if the policy has sent them. With `hold`, its last action replaces
    /// missing ones.
    pub fn next(&self, hold: bool) -> Option<Vec<Action>> {
        let end_ns = self.timing.step_at(self.stamp_ns, 1);
        let step = self
            .motion
            .step(&self.encoding, self.stamp_ns, end_ns)
            .ok()?;
        let begins_given = step.intervals.first().is_some_and(|first| first.is_given);
        if !hold && !begins_given {
            return None;
        }
        let slots = self.timing.slots(self.stamp_ns);
        let actions = step
            .intervals
            .into_iter()
            .zip(slots)
            .map(|(interval, slot_ns)| Action {
                header: Header {
                    stamp: Time::from_nanos(slot_ns),
                    frame_id: self.base_frame.clone(),
                },
                values: interval.values,
            });
        Some(actions.collect())
    }

    /// Records the observation after the last step.
    pub fn observed(&mut self, stamp: Time) {
        self.stamp_ns = stamp.to_nanos();
    }

    fn is_far_ahead(&self, stamp_ns: i64) -> bool {
        stamp_ns > self.stamp_ns.saturating_add(self.timing.jump_ns)
    }

    fn parse(&self, action: &Action, what: &str) -> Result<Arc<[f32]>, HistoryError> {
        let checked = self.encoding.space().check(&action.values);
        checked.map_err(|source| HistoryError::Action {
            what: what.into(),
            source,
        })?;
        Ok(action.values.as_slice().into())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use wm_msgs::builtin_interfaces::Duration;

    use super::*;

    const PERIOD: i64 = 200_000_000;
    const START: i64 = 1_700_000_000_000_000_000;

    fn action(index: i64, value: f32) -> Action {
        let stamp = Time::from_nanos(START + index * PERIOD);
        Action {
            header: Header {
                stamp,
                frame_id: "base".into(),
            },
            values: vec![value; 7],
        }
    }

    fn attached() -> Attached {
        let timing = Timing::new(PERIOD, 2);
        Attached::new(
            "one".into(),
            ActionEncoding::default(),
            timing,
            ChunkMerging::Latest,
            Time::from_nanos(START),
        )
    }

    fn firsts(actions: Option<Vec<Action>>) -> Option<Vec<f32>> {
        let first = |action: &Action| action.values.first().copied().unwrap();
        actions.map(|actions| actions.iter().map(first).collect())
    }

    #[test]
    fn a_step_waits_for_its_action_and_holds_the_last_only_if_told() {
        let mut attached = attached();
        assert_eq!(attached.next(true), None);
        assert!(attached.action(&action(0, 0.1)).unwrap());
        assert_eq!(firsts(attached.next(false)), Some(vec![0.1, 0.1]));
        attached.observed(Time::from_nanos(START + 2 * PERIOD));
        assert_eq!(attached.next(false), None);
        assert_eq!(firsts(attached.next(true)), Some(vec![0.1, 0.1]));
        assert!(!attached.action(&action(0, 0.3)).unwrap(), "late");
        assert!(
            !attached.action(&action(50, 0.3)).unwrap(),
            "of another time"
        );
        assert_eq!(attached.next(false), None);
    }

    #[test]
    fn a_chunk_covers_its_steps_and_no_more() {
        let mut attached = attached();
        let chunk = ActionChunk {
            header: action(0, 0.0).header,
            period: Duration::from_nanos(PERIOD),
            actions: (0..4)
                .map(|index| action(index, index as f32 / 10.0))
                .collect(),
            ..ActionChunk::default()
        };
        assert!(attached.chunk(&chunk).unwrap());
        assert_eq!(firsts(attached.next(false)), Some(vec![0.0, 0.1]));
        attached.observed(Time::from_nanos(START + 2 * PERIOD));
        assert_eq!(firsts(attached.next(false)), Some(vec![0.2, 0.3]));
        attached.observed(Time::from_nanos(START + 4 * PERIOD));
        assert_eq!(attached.next(false), None);
        assert_eq!(firsts(attached.next(true)), Some(vec![0.3, 0.3]));
        assert!(!attached.chunk(&chunk).unwrap(), "all of it has passed");
    }

    #[test]
    fn a_second_of_nanoseconds_is_malformed() {
        let mut attached = attached();
        let mut bad = action(0, 0.1);
        bad.header.stamp.nanosec = 1_999_999_999;
        assert_eq!(attached.action(&bad).unwrap_err().reason(), "bad_stamp");
        let chunk = ActionChunk {
            header: bad.header,
            period: Duration::from_nanos(PERIOD),
            actions: vec![action(0, 0.1)],
            ..ActionChunk::default()
        };
        assert_eq!(attached.chunk(&chunk).unwrap_err().reason(), "bad_stamp");
        assert_eq!(attached.next(true), None);
    }

    #[test]
    fn a_chunk_of_another_clock_is_left_out_and_hinders_none() {
        let mut attached = attached();
        let mut chunk = ActionChunk {
            header: action(0, 0.0).header,
            period: Duration::from_nanos(PERIOD),
            actions: (0..2).map(|index| action(index, 0.5)).collect(),
            ..ActionChunk::default()
        };
        chunk.header.stamp = Time::from_nanos(START + 1_000_000 * PERIOD);
        assert!(!attached.chunk(&chunk).unwrap());
        assert_eq!(attached.next(true), None);
        chunk.header.stamp = Time::from_nanos(START);
        assert!(attached.chunk(&chunk).unwrap());
        assert_eq!(firsts(attached.next(false)), Some(vec![0.5, 0.5]));
    }
}
