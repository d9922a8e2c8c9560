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

/// How a chunk joins the one before where the two speak of the same moments (the `aggregate_fn` of LeRobot's asynchronous
/// inference, <https://huggingface.co/docs/lerobot/async>).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChunkMerging {
    /// The newer one holds.
    #[default]
    Latest,
    /// 0.3 of the older one and 0.7 of the newer one.
    Weighted,
    /// The mean of both.
    Average,
}

impl ChunkMerging {
    /// By its name in a parameter: `latest`, `weighted` or `average`.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "latest" => Some(Self::Latest),
            "weighted" => Some(Self::Weighted),
            "average" => Some(Self::Average),
            _ => None,
        }
    }

    /// The weight of the newer chunk.
    fn weight(self) -> f32 {
        match self {
            Self::Latest => 1.0,
            Self::Weighted => 0.7,
            Self::Average => 0.5,
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

    /// The entry of a moment that the chunk speaks of: none before its first action, or once its last one is over.
    fn covering(&self, stamp_ns: i64) -> Option<&PhysicalAction> {
        let (entry_ns, action) = self.at(stamp_ns)?;
        (stamp_ns < entry_ns.saturating_add(self.period_ns)).then_some(action)
    }

    /// Blends the values with those of the `older` chunk at the moments that both speak of.
    fn merge(&mut self, older: &Self, merging: ChunkMerging) {
        let weight = merging.weight();
        if weight == 1.0 {
            return;
        }
        // The nearest entry of the older chunk, not the one that has just begun: stamps jitter.
        let half_ns = older.period_ns / 2;
        for (index, action) in self.actions.iter_mut().enumerate() {
            // Below MAX_CHUNK.
            let entry_ns = self
                .stamp_ns
                .saturating_add(self.period_ns.saturating_mul(index as i64));
            let Some(before) = older.covering(entry_ns.saturating_add(half_ns)) else {
                continue;
            };
            for (new, old) in action.values.iter_mut().zip(before.values) {
                *new = old + weight * (*new - old);
            }
        }
    }
}

/// Actions by stamp, as many as fit a span of time, and the newest chunk.
#[derive(Clone, Debug)]
pub(super) struct Actions {
    taken: BTreeMap<i64, PhysicalAction>,
    chunk: Option<Chunk>,
    merging: ChunkMerging,
    span_ns: i64,
}

impl Actions {
    pub(super) fn new(span_ns: i64) -> Self {
        Self {
            taken: BTreeMap::new(),
            chunk: None,
            merging: ChunkMerging::default(),
            span_ns,
        }
    }

    pub(super) fn set_merging(&mut self, merging: ChunkMerging) {
        self.merging = merging;
    }

    /// Whether an action or a chunk speaks of this moment: nothing is held there.
    pub(super) fn is_given(&self, slot_ns: i64, tolerance_ns: i64) -> bool {
        let near = slot_ns.saturating_sub(tolerance_ns)..=slot_ns.saturating_add(tolerance_ns);
        let is_announced = |chunk: &Chunk| {
            chunk
                .covering(slot_ns.saturating_add(tolerance_ns))
                .is_some()
        };
        self.taken.range(near).next().is_some() || self.chunk.as_ref().is_some_and(is_announced)
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
        let mut newer = Chunk {
            stamp_ns: chunk.header.stamp.to_nanos(),
            period_ns,
            actions,
        };
        if let Some(older) = &self.chunk {
            newer.merge(older, self.merging);
        }
        self.chunk = Some(newer);
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
