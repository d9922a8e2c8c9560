//! The episode that a policy plays by topics.

use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk},
};

use crate::timeline::{ChunkMerging, Timeline, TimelineError, Timing};

/// Where an episode stands that is played by topics: what the policy has said so far of the moments to come.
#[derive(Clone, Debug)]
pub struct Attached {
    episode_id: String,
    timeline: Timeline,
    timing: Timing,
    stamp_ns: i64,
}

impl Attached {
    /// An episode whose first observation is of `begin`.
    pub fn new(episode_id: String, timing: Timing, merging: ChunkMerging, begin: Time) -> Self {
        Self {
            episode_id,
            timeline: Timeline::new(timing, 1).with_chunk_merging(merging),
            timing,
            stamp_ns: begin.to_nanos(),
        }
    }

    /// The episode.
    pub fn episode_id(&self) -> &str {
        &self.episode_id
    }

    /// Takes an action; whether it came in time. One for a moment that has passed, or that is far ahead, is left out.
    ///
    /// # Errors
    /// [`TimelineError`] says what is wrong with it.
    pub fn action(&mut self, action: &Action) -> Result<bool, TimelineError> {
        let stamp_ns = action.header.stamp.to_nanos();
        let is_late = stamp_ns < self.stamp_ns - self.timing.tolerance_ns;
        if is_late || stamp_ns > self.stamp_ns.saturating_add(self.timing.jump_ns) {
            return Ok(false);
        }
        self.timeline.action(action).map(|_| true)
    }

    /// Takes the actions to come; whether any of them is still to come. A chunk that is far ahead is left out.
    ///
    /// # Errors
    /// [`TimelineError`] says what is wrong with the chunk.
    pub fn chunk(&mut self, chunk: &ActionChunk) -> Result<bool, TimelineError> {
        // Chunks are bounded; a period that is none is refused by the timeline.
        let span_ns = chunk
            .period
            .to_nanos()
            .saturating_mul(chunk.actions.len() as i64);
        let stamp_ns = chunk.header.stamp.to_nanos();
        let end_ns = stamp_ns.saturating_add(span_ns);
        // What is far ahead must not be the newest, which no later one may precede.
        if stamp_ns > self.stamp_ns.saturating_add(self.timing.jump_ns) {
            return Ok(false);
        }
        self.timeline.chunk(chunk)?;
        Ok(end_ns > self.stamp_ns)
    }

    /// The actions of the next step where the policy has said what it does now; with `hold`, its last action stands in
    /// where it has not.
    pub fn next(&self, hold: bool) -> Option<Vec<Action>> {
        if !hold && !self.timeline.is_given(self.stamp_ns) {
            return None;
        }
        let actions = self.timeline.actions_of_step(self.stamp_ns).ok()?;
        Some(actions.iter().map(|action| action.to_message()).collect())
    }

    /// Takes note of the observation that the last step led to.
    pub fn observed(&mut self, stamp: Time) {
        self.stamp_ns = stamp.to_nanos();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use wm_msgs::{builtin_interfaces::Duration, std_msgs::Header};

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
            actions: (0..4).map(|index| action(index, index as f32)).collect(),
            ..ActionChunk::default()
        };
        assert!(attached.chunk(&chunk).unwrap());
        assert_eq!(firsts(attached.next(false)), Some(vec![0.0, 1.0]));
        attached.observed(Time::from_nanos(START + 2 * PERIOD));
        assert_eq!(firsts(attached.next(false)), Some(vec![2.0, 3.0]));
        attached.observed(Time::from_nanos(START + 4 * PERIOD));
        assert_eq!(attached.next(false), None);
        assert_eq!(firsts(attached.next(true)), Some(vec![3.0, 3.0]));
        assert!(!attached.chunk(&chunk).unwrap(), "all of it has passed");
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
