//! The last actions taken and the chunk of those to come.

use std::{collections::BTreeMap, sync::Arc};

use wm_model::actions::{PHYSICAL_DIM, physical};
use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::Header,
    wm_msgs::{Action, ActionChunk},
};

use super::TimelineError;

/// Most actions of a chunk: beyond any policy's horizon.
pub const MAX_CHUNK: usize = 1024;

/// An action that has been checked: seven finite values.
#[derive(Clone, Debug, PartialEq)]
pub struct PhysicalAction {
    /// When it is taken \[ns\].
    pub stamp_ns: i64,
    /// The frame of its deltas.
    pub frame_id: Arc<str>,
    /// dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper 0 closed to 1 open.
    pub values: [f32; PHYSICAL_DIM],
}

impl AsRef<[f32]> for PhysicalAction {
    fn as_ref(&self) -> &[f32] {
        &self.values
    }
}

impl PhysicalAction {
    /// Checks a message's values; `what` names it in the error.
    pub(super) fn parse(
        action: &Action,
        what: impl FnOnce() -> String,
    ) -> Result<Self, TimelineError> {
        let values = physical(&action.values).map_err(|source| TimelineError::Action {
            what: what(),
            source,
        })?;
        Ok(Self {
            stamp_ns: action.header.stamp.to_nanos(),
            frame_id: action.header.frame_id.as_str().into(),
            values,
        })
    }

    /// The message.
    pub fn to_message(&self) -> Action {
        Action {
            header: Header {
                stamp: Time::from_nanos(self.stamp_ns),
                frame_id: self.frame_id.to_string(),
            },
            values: self.values.to_vec(),
        }
    }
}

#[derive(Clone, Debug)]
struct Chunk {
    stamp_ns: i64,
    period_ns: i64,
    actions: Vec<PhysicalAction>,
}

impl Chunk {
    /// The last entry at or before a stamp.
    fn at(&self, stamp_ns: i64) -> Option<(i64, &PhysicalAction)> {
        let since_ns = stamp_ns
            .checked_sub(self.stamp_ns)
            .filter(|since_ns| *since_ns >= 0)?;
        let last = self.actions.len().checked_sub(1)?;
        let index = usize::try_from(since_ns / self.period_ns)
            .unwrap_or(last)
            .min(last);
        // Below MAX_CHUNK.
        let entry_ns = self
            .stamp_ns
            .saturating_add(self.period_ns.saturating_mul(index as i64));
        Some((entry_ns, self.actions.get(index)?))
    }
}

/// Actions by stamp, as many as fit a span of time, and the newest chunk.
#[derive(Clone, Debug)]
pub(super) struct Actions {
    taken: BTreeMap<i64, PhysicalAction>,
    chunk: Option<Chunk>,
    span_ns: i64,
}

impl Actions {
    pub(super) fn new(span_ns: i64) -> Self {
        Self {
            taken: BTreeMap::new(),
            chunk: None,
            span_ns,
        }
    }

    pub(super) fn newest_ns(&self) -> Option<i64> {
        self.taken.last_key_value().map(|(stamp_ns, _)| *stamp_ns)
    }

    pub(super) fn base_frame(&self) -> Arc<str> {
        let newest = self.taken.last_key_value();
        newest.map_or_else(|| "".into(), |(_, action)| Arc::clone(&action.frame_id))
    }

    pub(super) fn chunk_stamp_ns(&self) -> Option<i64> {
        self.chunk.as_ref().map(|chunk| chunk.stamp_ns)
    }

    pub(super) fn insert(&mut self, action: PhysicalAction) {
        self.taken.insert(action.stamp_ns, action);
        let Some(newest_ns) = self.newest_ns() else {
            return;
        };
        // The last one before the span stays too: it may be held into it.
        let oldest_ns = newest_ns.saturating_sub(self.span_ns);
        while self
            .taken
            .keys()
            .nth(1)
            .is_some_and(|second_ns| *second_ns <= oldest_ns)
        {
            self.taken.pop_first();
        }
    }

    pub(super) fn set_chunk(&mut self, chunk: &ActionChunk) -> Result<(), TimelineError> {
        let (count, period_ns) = (chunk.actions.len(), chunk.period.to_nanos());
        if count == 0 || count > MAX_CHUNK || period_ns <= 0 {
            return Err(TimelineError::Chunk { count, period_ns });
        }
        let parse = |(index, action)| {
            PhysicalAction::parse(action, || format!("action {index} of a chunk"))
        };
        let actions = chunk
            .actions
            .iter()
            .enumerate()
            .map(parse)
            .collect::<Result<_, _>>()?;
        self.chunk = Some(Chunk {
            stamp_ns: chunk.header.stamp.to_nanos(),
            period_ns,
            actions,
        });
        Ok(())
    }

    /// The action of a moment, its stamp set to that moment: the latest of the actions taken and of the chunk's that
    /// is not after it; what was really taken wins over what was announced for the same moment.
    pub(super) fn at(&self, slot_ns: i64, tolerance_ns: i64) -> Option<PhysicalAction> {
        let until_ns = slot_ns.saturating_add(tolerance_ns);
        let taken = self
            .taken
            .range(..=until_ns)
            .next_back()
            .map(|(stamp_ns, action)| (*stamp_ns, action));
        let announced = self.chunk.as_ref().and_then(|chunk| chunk.at(until_ns));
        let (_, action) = match (taken, announced) {
            (Some(taken), Some(announced))
                if announced.0 > taken.0.saturating_add(tolerance_ns) =>
            {
                announced
            }
            (Some(taken), _) => taken,
            (None, announced) => announced?,
        };
        Some(PhysicalAction {
            stamp_ns: slot_ns,
            ..action.clone()
        })
    }

    /// Keeps what lies within `margin_ns` of a stamp.
    pub(super) fn retain_around(&mut self, stamp_ns: i64, margin_ns: i64) {
        let near = |other_ns: i64| (other_ns.saturating_sub(stamp_ns)).abs() <= margin_ns;
        self.taken.retain(|other_ns, _| near(*other_ns));
        self.chunk = self.chunk.take().filter(|chunk| near(chunk.stamp_ns));
    }

    pub(super) fn clear(&mut self) {
        self.taken.clear();
        self.chunk = None;
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.taken.len()
    }
}
