//! Executed actions, each until the next one.

use std::{collections::BTreeMap, sync::Arc};

use super::{MotionSettings, piece::Piece};

/// Most actions kept.
const MAX_ACTIONS: usize = 8192;
/// Gaps from which the duration of the newest action is estimated.
const RECENT_GAPS: usize = 9;

#[derive(Clone, Debug)]
pub(super) struct ExecutedActions {
    actions: BTreeMap<i64, Arc<[f32]>>,
    settings: MotionSettings,
}

impl ExecutedActions {
    pub fn new(settings: MotionSettings) -> Self {
        Self {
            actions: BTreeMap::new(),
            settings,
        }
    }

    pub fn keep_for(&mut self, keep_ns: i64) {
        self.settings.keep_ns = keep_ns;
    }

    pub fn newest_ns(&self) -> Option<i64> {
        self.actions.last_key_value().map(|(stamp_ns, _)| *stamp_ns)
    }

    pub fn insert(&mut self, stamp_ns: i64, values: Arc<[f32]>) {
        self.actions.insert(stamp_ns, values);
        let Some(newest_ns) = self.newest_ns() else {
            return;
        };
        // The last action before that time stays: it reaches into the kept time.
        let oldest_ns = newest_ns.saturating_sub(self.settings.keep_ns);
        let is_past = |actions: &BTreeMap<i64, _>| {
            actions
                .keys()
                .nth(1)
                .is_some_and(|second| *second <= oldest_ns)
        };
        while self.actions.len() > MAX_ACTIONS || is_past(&self.actions) {
            self.actions.pop_first();
        }
    }

    pub fn pieces(&self) -> Vec<Piece> {
        let longest_ns = self.settings.longest_ns;
        let following = self.actions.keys().skip(1).copied().map(Some);
        let mut pieces = Vec::with_capacity(self.actions.len() + 1);
        for ((start_ns, values), next_ns) in self.actions.iter().zip(following.chain([None])) {
            let span_ns = match next_ns {
                Some(next_ns) => next_ns.saturating_sub(*start_ns).min(longest_ns),
                None => self.newest_span_ns(),
            };
            pieces.push(Piece {
                start_ns: *start_ns,
                end_ns: start_ns.saturating_add(span_ns),
                span_ns: span_ns.max(1),
                values: Arc::clone(values),
                is_held: false,
            });
        }
        pieces
    }

    /// Duration of the newest action: the median of the last gaps, since stamps jitter and messages are lost.
    fn newest_span_ns(&self) -> i64 {
        let stamps: Vec<i64> = self
            .actions
            .keys()
            .rev()
            .take(RECENT_GAPS)
            .copied()
            .collect();
        let mut gaps: Vec<i64> = stamps
            .iter()
            .zip(stamps.iter().skip(1))
            .map(|(later, earlier)| later.saturating_sub(*earlier))
            .filter(|gap_ns| *gap_ns <= self.settings.longest_ns)
            .collect();
        gaps.sort_unstable();
        let median = gaps.get(gaps.len() / 2);
        median.copied().unwrap_or(self.settings.period_ns).max(1)
    }

    pub fn retain_around(&mut self, stamp_ns: i64, margin_ns: i64) {
        self.actions
            .retain(|other_ns, _| other_ns.saturating_sub(stamp_ns).saturating_abs() <= margin_ns);
    }

    pub fn clear(&mut self) {
        self.actions.clear();
    }
}
