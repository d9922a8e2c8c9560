//! Chunks and plans that are offered for execution.

use wm_msgs::wm_msgs::{Action, ActionChunk, Plan};
use wm_wire::stamp::{AHEAD_NS, FutureStamp};

use super::{Moment, Refusal, refusal::stamp_of};

/// The source of an offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A policy, or a bag.
    Chunk,
    /// A planner.
    Plan,
}

impl Source {
    /// In a sentence.
    pub fn name(self) -> &'static str {
        match self {
            Self::Chunk => "chunk",
            Self::Plan => "plan",
        }
    }
}

/// When the first action of a chunk or plan begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// At its stamp: the first actions of a late one are skipped.
    Stamp,
    /// At its reception: for policies that publish no times, or take longer than their stamps say.
    Reception,
}

/// A chunk or a plan, as received.
#[derive(Clone, Debug, PartialEq)]
pub struct Offer {
    /// Its source.
    pub source: Source,
    /// Of the message; of a plan, of its first action \[ns\].
    pub stamp_ns: i64,
    /// Decides which offer is newer: a chunk's stamp; the stamp of the frame from which a plan was made \[ns\].
    pub made_ns: i64,
    /// Capture time of the frame that it responds to; a chunk may have none \[ns\].
    pub capture_ns: Option<i64>,
    /// When its first action begins, by the node's clock \[ns\].
    pub begin_ns: i64,
    /// Duration of each action \[ns\].
    pub period_ns: i64,
    /// The frame of its motions.
    pub frame_id: String,
    /// Epoch of the planner's history; a chunk has none.
    pub epoch: Option<u64>,
    /// Values of the actions, in physical units.
    pub actions: Vec<Vec<f32>>,
}

impl Offer {
    /// A policy's chunk.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: a time is malformed.
    pub fn of_chunk(chunk: &ActionChunk) -> Result<Self, Refusal> {
        let stamp_ns = stamp_of("the chunk", chunk.header.stamp)?;
        let capture_ns = stamp_of("timing.capture", chunk.timing.capture)?;
        Ok(Self {
            source: Source::Chunk,
            stamp_ns,
            made_ns: stamp_ns,
            // With zero, the policy does not name its frame.
            capture_ns: Some(capture_ns).filter(|capture_ns| *capture_ns != 0),
            begin_ns: stamp_ns,
            period_ns: Refusal::expect_span("period", chunk.period)?,
            frame_id: chunk.header.frame_id.clone(),
            epoch: None,
            actions: checked_values(&chunk.actions)?,
        })
    }

    /// A planner's plan. The stamp of its header is that of the observed frame; its actions say when they begin.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: a time is malformed.
    pub fn of_plan(plan: &Plan) -> Result<Self, Refusal> {
        let first = plan
            .actions
            .first()
            .map_or(&plan.header, |action| &action.header);
        let stamp_ns = stamp_of("the first action", first.stamp)?;
        let made_ns = stamp_of("the plan", plan.header.stamp)?;
        Ok(Self {
            source: Source::Plan,
            stamp_ns,
            made_ns,
            capture_ns: Some(made_ns),
            begin_ns: stamp_ns,
            period_ns: Refusal::expect_span("period", plan.period)?,
            frame_id: first.frame_id.clone(),
            epoch: Some(plan.epoch),
            actions: checked_values(&plan.actions)?,
        })
    }

    /// Capture time of the frame that it responds to, or its stamp \[ns\].
    pub fn seen_ns(&self) -> i64 {
        self.capture_ns.unwrap_or(self.stamp_ns)
    }

    /// Checks that its frame is not of the future, by a clock that may be late.
    ///
    /// # Errors
    /// [`Refusal::Future`].
    pub(super) fn expect_captured(&self, now: Moment) -> Result<(), Refusal> {
        let now_ns = now.stamp_ns.saturating_add(now.late_ns);
        let Some(capture_ns) = self.capture_ns else {
            return Ok(());
        };
        let what = match self.source {
            Source::Chunk => "timing.capture",
            Source::Plan => "the plan's frame",
        };
        Ok(FutureStamp::refuse(what, capture_ns, now_ns, AHEAD_NS)?)
    }

    /// When its last action ends \[ns\].
    pub fn end_ns(&self) -> i64 {
        // At most MAX_CHUNK.
        let count = i64::try_from(self.actions.len()).unwrap_or(i64::MAX);
        let span_ns = self.period_ns.saturating_mul(count);
        self.begin_ns.saturating_add(span_ns)
    }

    /// When an action begins \[ns\].
    pub fn start_ns(&self, index: usize) -> i64 {
        // At most MAX_CHUNK.
        let index = i64::try_from(index).unwrap_or(i64::MAX);
        self.begin_ns
            .saturating_add(self.period_ns.saturating_mul(index))
    }
}

/// Values of actions, in physical units.
pub(super) fn values(actions: &[Action]) -> Vec<Vec<f32>> {
    actions.iter().map(|action| action.values.clone()).collect()
}

fn checked_values(actions: &[Action]) -> Result<Vec<Vec<f32>>, Refusal> {
    for action in actions {
        stamp_of("an action", action.header.stamp)?;
    }
    Ok(values(actions))
}
