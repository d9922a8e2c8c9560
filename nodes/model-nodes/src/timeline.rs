//! What was observed and done, aligned in time.
//!
//! Frames and actions arrive at the camera's rate, each with its capture stamp; the transition model counts in model
//! steps of several camera frames. A [`Timeline`] holds the last few of both and answers which frames make the context
//! of an observation and which actions lie between them, by stamps alone: there is no clock, and what arrives when
//! makes no difference beyond what has arrived.
//!
//! Stamps are nanoseconds of the capture clock. A frame far behind the newest one, or far ahead of it, means that time
//! jumped (a bag that loops, a simulation that restarts, a camera that was away): everything observed before is flushed.

mod actions;
mod frames;

use std::sync::Arc;

use thiserror::Error;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk},
};

pub use actions::{ChunkMerging, MAX_CHUNK, PhysicalAction};
pub use frames::Frame;

use actions::Actions;
use frames::Frames;

/// How stamps make model steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// From one camera frame, and one action, to the next \[ns\].
    pub frame_period_ns: i64,
    /// Camera frames of one model step.
    pub frame_skip: usize,
    /// How far a stamp may lie from where it is looked for \[ns\].
    pub tolerance_ns: i64,
    /// How far a stamp must lie from the newest to mean that time jumped, not that a message was late or lost \[ns\].
    pub jump_ns: i64,
}

impl Timing {
    /// Timing of a camera with `frame_period_ns` between frames: a quarter of that as tolerance, a second as jump.
    pub fn new(frame_period_ns: i64, frame_skip: usize) -> Self {
        Self {
            frame_period_ns,
            frame_skip,
            tolerance_ns: frame_period_ns / 4,
            jump_ns: 1_000_000_000,
        }
    }

    /// One model step \[ns\].
    pub fn step_ns(&self) -> i64 {
        // A skip is a handful of frames.
        self.frame_period_ns.saturating_mul(self.frame_skip as i64)
    }

    /// Stamps of the actions within the model step that begins at `start_ns`.
    pub fn slots(self, start_ns: i64) -> impl Iterator<Item = i64> {
        (0..self.frame_skip as i64).map(move |index| start_ns + index * self.frame_period_ns)
    }
}

/// A policy answers a frame before it has passed the encoder, and may be slow, but not by this much \[ns\]: its clock is
/// not the frames'.
const FAR_AHEAD_NS: i64 = 60_000_000_000;

/// What a frame or an action did to the timeline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrival {
    /// Time jumped, and what was observed before is forgotten.
    pub flushed: bool,
    /// Camera frames that are missing between this frame and the one before.
    pub missed_frames: u64,
    /// A chunk that has come since the frame before, and had ended by then already: it says nothing.
    pub late_chunk: Option<LateChunk>,
}

/// A chunk that came after its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateChunk {
    /// Its stamp.
    pub stamp_ns: i64,
    /// When its last action ends.
    pub end_ns: i64,
    /// The newest frame when it came.
    pub newest_ns: i64,
}

impl std::fmt::Display for LateChunk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "action chunk of {} had ended {:.1} s before the newest frame, that of {}, when it came: stamp it with the stamp \
             of the image that it answers",
            seconds_of(self.stamp_ns),
            (self.newest_ns.saturating_sub(self.end_ns)) as f64 / 1e9,
            seconds_of(self.newest_ns)
        )
    }
}

/// Why a frame, an action or a chunk is left out.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum TimelineError {
    /// The same stamp again.
    #[error("frame of {} has already come: left out", seconds_of(*.stamp_ns))]
    Duplicate {
        /// Its stamp.
        stamp_ns: i64,
    },
    /// Older than the newest, by less than a jump of time.
    #[error("{what} of {} came after that of {}: out of order, left out", seconds_of(*.stamp_ns), seconds_of(*.newest_ns))]
    OutOfOrder {
        /// `frame` or `action chunk`.
        what: &'static str,
        /// Its stamp.
        stamp_ns: i64,
        /// The newest stamp before it.
        newest_ns: i64,
    },
    /// Values that are no action.
    #[error("{what}: {source}")]
    Action {
        /// Where it came from.
        what: String,
        /// What is wrong with it.
        source: wm_model::actions::ActionError,
    },
    /// A chunk that says nothing about when or what.
    #[error(
        "action chunk of {count} actions, {period_ns} ns apart: expected 1 to {MAX_CHUNK} actions and a positive period"
    )]
    Chunk {
        /// How many actions.
        count: usize,
        /// Their period \[ns\].
        period_ns: i64,
    },
    /// A chunk that begins so far ahead that it answers no frame that has come.
    #[error(
        "action chunk begins {} s after the newest frame, that of {}: stamp it with the stamp of the image that it answers",
        (*.stamp_ns - *.newest_ns) / 1_000_000_000, seconds_of(*.newest_ns)
    )]
    Ahead {
        /// Its stamp.
        stamp_ns: i64,
        /// The newest frame's.
        newest_ns: i64,
    },
}

impl TimelineError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Duplicate { .. } => "duplicate",
            Self::OutOfOrder { .. } => "out_of_order",
            Self::Ahead { .. } => "untimely_action",
            Self::Action { .. } | Self::Chunk { .. } => "malformed_action",
        }
    }
}

/// Why there is no context yet. None of these is a fault: each passes when more has arrived.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum Wait {
    /// No frame at all.
    #[error("no frame has come yet")]
    NoFrame,
    /// The history is still short.
    #[error("{have} of {need} context frames have come")]
    Context {
        /// Context frames at hand.
        have: usize,
        /// Context frames that the model needs.
        need: usize,
    },
    /// A frame that the context needs is missing.
    #[error("the frame of {} is missing: a gap in the context", seconds_of(*.missing_ns))]
    Gap {
        /// Where it should be.
        missing_ns: i64,
    },
    /// Nothing says what the robot does.
    #[error("no action has come for {} or before", seconds_of(*.needed_ns))]
    NoAction {
        /// The moment whose action is needed.
        needed_ns: i64,
    },
}

/// Context of one observation.
#[derive(Clone, Debug)]
pub struct Context {
    /// Frames one model step apart, oldest first; the last one is the observation.
    pub frames: Vec<Frame>,
    /// The camera-rate actions between each frame and the next: one list of `frame_skip` a gap.
    pub actions: Vec<Vec<PhysicalAction>>,
}

/// The last frames and actions.
#[derive(Clone, Debug)]
pub struct Timeline {
    timing: Timing,
    context_frames: usize,
    frames: Frames,
    actions: Actions,
    late_chunk: Option<LateChunk>,
    epoch: u64,
}

impl Timeline {
    /// An empty timeline that keeps what a context of `context_frames` (at least 1) needs.
    pub fn new(timing: Timing, context_frames: usize) -> Self {
        let context_frames = context_frames.max(1);
        // Contexts are a handful of frames.
        let span_ns = timing.step_ns().saturating_mul(context_frames as i64);
        Self {
            timing,
            context_frames,
            frames: Frames::new(span_ns),
            actions: Actions::new(span_ns.saturating_add(timing.jump_ns)),
            late_chunk: None,
            epoch: 0,
        }
    }

    /// The same timeline, whose overlapping chunks are merged by `merging`.
    #[must_use]
    pub fn with_chunk_merging(mut self, merging: ChunkMerging) -> Self {
        self.actions.set_merging(merging);
        self
    }

    /// How stamps make model steps.
    pub fn timing(&self) -> Timing {
        self.timing
    }

    /// Counts up with every flush: what was computed from another epoch is of the past.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Takes the frame captured at `stamp`.
    ///
    /// # Errors
    /// [`TimelineError::Duplicate`], [`TimelineError::OutOfOrder`].
    pub fn frame(
        &mut self,
        stamp: Time,
        frame_id: &str,
        values: Arc<[f32]>,
    ) -> Result<Arrival, TimelineError> {
        let stamp_ns = stamp.to_nanos();
        let mut arrival = Arrival::default();
        if let Some(newest_ns) = self.frames.newest().map(|frame| frame.stamp_ns) {
            let is_ahead = stamp_ns > newest_ns.saturating_add(self.timing.jump_ns);
            if is_ahead {
                // Actions stay: the last one is held for as long as no other comes.
                self.frames.clear();
                self.epoch += 1;
                arrival.flushed = true;
            } else if self.is_jump(stamp_ns, newest_ns) {
                self.flush_around(stamp_ns);
                arrival.flushed = true;
            } else if stamp_ns == newest_ns {
                return Err(TimelineError::Duplicate { stamp_ns });
            } else if stamp_ns < newest_ns {
                return Err(TimelineError::OutOfOrder {
                    what: "frame",
                    stamp_ns,
                    newest_ns,
                });
            } else {
                let period_ns = self.timing.frame_period_ns.max(1);
                let periods = (stamp_ns - newest_ns + period_ns / 2) / period_ns;
                arrival.missed_frames = u64::try_from(periods - 1).unwrap_or(0);
            }
        }
        // Where time jumped back, the chunk was of the time that begins.
        let late_chunk = self.late_chunk.take();
        arrival.late_chunk = late_chunk.filter(|late| late.end_ns <= stamp_ns);
        self.frames.push(Frame {
            stamp_ns,
            frame_id: frame_id.into(),
            values,
        });
        Ok(arrival)
    }

    /// Takes an action; one of the same stamp replaces the earlier one.
    ///
    /// # Errors
    /// [`TimelineError::Action`].
    pub fn action(&mut self, action: &Action) -> Result<Arrival, TimelineError> {
        let parsed = PhysicalAction::parse(action, || "action".into())?;
        let mut arrival = Arrival::default();
        if self
            .actions
            .newest_ns()
            .is_some_and(|newest_ns| self.is_jump(parsed.stamp_ns, newest_ns))
        {
            self.flush_around(parsed.stamp_ns);
            arrival.flushed = true;
        }
        self.actions.insert(parsed);
        Ok(arrival)
    }

    /// Takes the actions to come; they replace those of the chunk before, or are merged with them
    /// ([`Self::with_chunk_merging`]).
    ///
    /// # Errors
    /// [`TimelineError::Chunk`], [`TimelineError::Action`], [`TimelineError::OutOfOrder`], [`TimelineError::Ahead`].
    pub fn chunk(&mut self, chunk: &ActionChunk) -> Result<(), TimelineError> {
        let stamp_ns = chunk.header.stamp.to_nanos();
        if let Some(frame) = self.frames.newest() {
            let newest_ns = frame.stamp_ns;
            if stamp_ns > newest_ns.saturating_add(FAR_AHEAD_NS) {
                return Err(TimelineError::Ahead {
                    stamp_ns,
                    newest_ns,
                });
            }
        }
        if let Some(newest_ns) = self.actions.chunk_stamp_ns()
            && stamp_ns < newest_ns
            && !self.is_jump(stamp_ns, newest_ns)
        {
            return Err(TimelineError::OutOfOrder {
                what: "action chunk",
                stamp_ns,
                newest_ns,
            });
        }
        self.actions.set_chunk(chunk)?;
        let span_ns = chunk
            .period
            .to_nanos()
            .saturating_mul(chunk.actions.len() as i64); // at most MAX_CHUNK
        let end_ns = stamp_ns.saturating_add(span_ns);
        let newest = self.frames.newest().map(|frame| frame.stamp_ns);
        self.late_chunk = newest
            .filter(|newest_ns| end_ns <= *newest_ns)
            .map(|newest_ns| LateChunk {
                stamp_ns,
                end_ns,
                newest_ns,
            });
        Ok(())
    }

    /// Takes note that the node's clock jumped back to `now`; whether that flushed anything. What has already come by
    /// the new time stays.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let now_ns = now.to_nanos();
        let newest = self.frames.newest().map(|frame| frame.stamp_ns);
        let newest = newest.max(self.actions.newest_ns());
        if !newest.is_some_and(|newest_ns| self.is_jump(now_ns, newest_ns)) {
            return false;
        }
        self.flush_around(now_ns);
        true
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.frames.clear();
        self.actions.clear();
        self.late_chunk = None;
        self.epoch += 1;
    }

    /// The frame of the deltas of the newest action; empty where none has come.
    pub fn base_frame(&self) -> Arc<str> {
        self.actions.base_frame()
    }

    /// The newest frame.
    pub fn newest(&self) -> Option<&Frame> {
        self.frames.newest()
    }

    /// The frame nearest to a stamp, where one lies within `tolerance_ns`.
    pub fn near(&self, stamp_ns: i64, tolerance_ns: i64) -> Option<&Frame> {
        self.frames.near(stamp_ns, tolerance_ns)
    }

    /// Context of the newest frame.
    ///
    /// # Errors
    /// [`Wait`] says what is missing.
    pub fn context(&self) -> Result<Context, Wait> {
        let newest = self.frames.newest().ok_or(Wait::NoFrame)?;
        let mut frames = vec![newest.clone()];
        for back in 1..self.context_frames {
            let wanted_ns = newest.stamp_ns - self.timing.step_ns() * back as i64;
            match self.frames.near(wanted_ns, self.timing.tolerance_ns) {
                Some(frame) => frames.push(frame.clone()),
                None if self.frames.reach_back_to(wanted_ns) => {
                    return Err(Wait::Gap {
                        missing_ns: wanted_ns,
                    });
                }
                None => {
                    return Err(Wait::Context {
                        have: frames.len(),
                        need: self.context_frames,
                    });
                }
            }
        }
        frames.reverse();
        let mut actions = Vec::with_capacity(frames.len() - 1);
        for frame in frames.iter().take(frames.len() - 1) {
            actions.push(self.actions_of_step(frame.stamp_ns)?);
        }
        Ok(Context { frames, actions })
    }

    /// The camera-rate actions of the model step that begins at `start_ns`: each the action of that moment, else what
    /// the chunk says, else the last one before, held.
    ///
    /// # Errors
    /// [`Wait::NoAction`].
    pub fn actions_of_step(&self, start_ns: i64) -> Result<Vec<PhysicalAction>, Wait> {
        let at = |slot_ns| {
            self.actions
                .at(slot_ns, self.timing.tolerance_ns)
                .ok_or(Wait::NoAction { needed_ns: slot_ns })
        };
        self.timing.slots(start_ns).map(at).collect()
    }

    /// Whether an action or a chunk has come that speaks of the moment `slot_ns`; else the last one is held there.
    pub fn is_given(&self, slot_ns: i64) -> bool {
        self.actions.is_given(slot_ns, self.timing.tolerance_ns)
    }

    fn is_jump(&self, stamp_ns: i64, newest_ns: i64) -> bool {
        stamp_ns < newest_ns.saturating_sub(self.timing.jump_ns)
    }

    /// Forgets what was observed before time jumped to `stamp_ns`. Actions outrun frames, which pass through the
    /// encoder first: those around the new time belong to it and stay.
    fn flush_around(&mut self, stamp_ns: i64) {
        self.frames.clear();
        self.actions.retain_around(stamp_ns, self.timing.jump_ns);
        self.epoch += 1;
    }
}

/// A stamp as people read it.
pub fn seconds(stamp: Time) -> String {
    format!("{}.{:09} s", stamp.sec, stamp.nanosec)
}

fn seconds_of(stamp_ns: i64) -> String {
    seconds(Time::from_nanos(stamp_ns))
}

#[cfg(test)]
mod tests;
