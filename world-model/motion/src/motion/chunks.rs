//! Announced actions, in chunks.

use std::{collections::VecDeque, sync::Arc};

use super::piece::Piece;
use crate::actions::{ActionError, ActionSpace};

/// Most actions of a chunk.
pub const MAX_CHUNK: usize = 1024;
/// Least and greatest time between actions of a chunk \[ns\].
const PERIODS_NS: std::ops::RangeInclusive<i64> = 1_000_000..=60_000_000_000;
/// Most pieces kept of all chunks.
const MAX_PIECES: usize = 4 * MAX_CHUNK;

/// Announced actions: the first starts at `stamp_ns`, each takes `period_ns`.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    stamp_ns: i64,
    period_ns: i64,
    actions: Vec<Arc<[f32]>>,
}

impl Chunk {
    /// A chunk of actions of `space`.
    ///
    /// # Errors
    /// [`ActionError::Chunk`] for an invalid count or period, and those of [`ActionSpace::check`] for the first invalid
    /// action.
    pub fn new(
        space: &ActionSpace,
        stamp_ns: i64,
        period_ns: i64,
        actions: Vec<Arc<[f32]>>,
    ) -> Result<Self, ActionError> {
        let count = actions.len();
        if !(1..=MAX_CHUNK).contains(&count) || !PERIODS_NS.contains(&period_ns) {
            return Err(ActionError::Chunk { count, period_ns });
        }
        for action in &actions {
            space.check(action)?;
        }
        Ok(Self {
            stamp_ns,
            period_ns,
            actions,
        })
    }

    /// Start of the first action.
    pub fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    /// End of the last action.
    pub fn end_ns(&self) -> i64 {
        // At most MAX_CHUNK actions of a minute each: no overflow.
        self.stamp_ns
            .saturating_add(self.period_ns * self.actions.len() as i64)
    }

    fn pieces(&self) -> impl Iterator<Item = Piece> {
        (0_i64..).zip(&self.actions).map(|(index, values)| {
            let start_ns = self.stamp_ns.saturating_add(self.period_ns * index);
            Piece {
                start_ns,
                end_ns: start_ns.saturating_add(self.period_ns),
                span_ns: self.period_ns,
                values: Arc::clone(values),
                is_held: false,
            }
        })
    }
}

/// How a chunk joins earlier ones for the same times (the `aggregate_fn` of LeRobot's asynchronous inference,
/// <https://huggingface.co/docs/lerobot/async>).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChunkMerging {
    /// The newer chunk replaces the older one.
    #[default]
    Latest,
    /// 0.3 of the older chunk and 0.7 of the newer one.
    Weighted,
    /// The mean of both.
    Average,
}

impl ChunkMerging {
    /// By parameter value: `latest`, `weighted` or `average`.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "latest" => Some(Self::Latest),
            "weighted" => Some(Self::Weighted),
            "average" => Some(Self::Average),
            _ => None,
        }
    }

    /// Weight of the newer chunk.
    fn weight(self) -> f32 {
        match self {
            Self::Latest => 1.0,
            Self::Weighted => 0.7,
            Self::Average => 0.5,
        }
    }
}

/// The announced actions of all chunks, in order and without overlap.
#[derive(Clone, Debug)]
pub(super) struct ChunkTimeline {
    pieces: VecDeque<Piece>,
    stamp_ns: Option<i64>,
    merging: ChunkMerging,
    keep_ns: i64,
}

impl ChunkTimeline {
    pub fn new(keep_ns: i64) -> Self {
        Self {
            pieces: VecDeque::new(),
            stamp_ns: None,
            merging: ChunkMerging::default(),
            keep_ns,
        }
    }

    pub fn keep_for(&mut self, keep_ns: i64) {
        self.keep_ns = keep_ns;
    }

    pub fn set_merging(&mut self, merging: ChunkMerging) {
        self.merging = merging;
    }

    pub fn stamp_ns(&self) -> Option<i64> {
        self.stamp_ns
    }

    pub fn set(&mut self, chunk: Chunk, space: &ActionSpace) {
        let mut newer: Vec<Piece> = chunk.pieces().collect();
        self.blend(&mut newer, space);
        let begin_ns = chunk.stamp_ns;
        self.pieces.retain(|piece| piece.start_ns < begin_ns);
        if let Some(last) = self.pieces.back_mut() {
            last.end_ns = last.end_ns.min(begin_ns);
        }
        self.pieces.extend(newer);
        let oldest_ns = begin_ns.saturating_sub(self.keep_ns);
        while self.pieces.len() > MAX_PIECES
            || self
                .pieces
                .front()
                .is_some_and(|piece| piece.end_ns < oldest_ns)
        {
            self.pieces.pop_front();
        }
        self.stamp_ns = Some(begin_ns);
    }

    /// Blends each piece with the announced one at its middle, since stamps jitter.
    fn blend(&self, newer: &mut [Piece], space: &ActionSpace) {
        let weight = self.merging.weight();
        if weight == 1.0 {
            return;
        }
        for piece in newer {
            let middle_ns = piece.start_ns.saturating_add(piece.span_ns / 2);
            let covers = |older: &&Piece| (older.start_ns..older.end_ns).contains(&middle_ns);
            let Some(older) = self.pieces.iter().find(covers) else {
                continue;
            };
            let pace = piece.span_ns as f32 / older.span_ns as f32;
            let values = piece.values.iter().zip(older.values.iter());
            let blended = values
                .zip(space.dimensions())
                .map(|((new, old), dimension)| {
                    let old = if dimension.kind.is_delta() {
                        old * pace
                    } else {
                        *old
                    };
                    old + weight * (new - old)
                });
            piece.values = blended.collect();
        }
    }

    /// Start of the nearest piece, at most `slack_ns` from `stamp_ns`.
    pub fn start_near(&self, stamp_ns: i64, slack_ns: i64) -> Option<i64> {
        let starts = self.pieces.iter().map(|piece| piece.start_ns);
        let distance = |start_ns: &i64| start_ns.saturating_sub(stamp_ns).saturating_abs();
        starts
            .min_by_key(distance)
            .filter(|start_ns| distance(start_ns) <= slack_ns)
    }

    /// Announced pieces up to a time.
    pub fn before(&self, stamp_ns: i64) -> Vec<Piece> {
        let earlier = self.pieces.iter().filter(|piece| piece.start_ns < stamp_ns);
        earlier
            .map(|piece| Piece {
                end_ns: piece.end_ns.min(stamp_ns),
                ..piece.clone()
            })
            .collect()
    }

    /// Announced pieces from a time on.
    pub fn after(&self, stamp_ns: i64) -> Vec<Piece> {
        let later = self.pieces.iter().filter(|piece| piece.end_ns > stamp_ns);
        later
            .map(|piece| Piece {
                start_ns: piece.start_ns.max(stamp_ns),
                ..piece.clone()
            })
            .collect()
    }

    pub fn retain_around(&mut self, stamp_ns: i64, margin_ns: i64) {
        let begin_ns = self.stamp_ns.unwrap_or(i64::MIN);
        if begin_ns.saturating_sub(stamp_ns).saturating_abs() > margin_ns {
            self.clear();
        } else {
            // Pieces of earlier chunks lie in the past.
            self.pieces.retain(|piece| piece.start_ns >= begin_ns);
        }
    }

    pub fn clear(&mut self) {
        self.pieces.clear();
        self.stamp_ns = None;
    }
}
