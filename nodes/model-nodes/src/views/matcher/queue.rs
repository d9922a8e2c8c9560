//! The waiting frames of one camera, by ascending stamps.

use std::collections::VecDeque;

use super::gaps::Gaps;

/// A camera whose gaps are so many times the reference's is slower.
const SLOWER: f64 = 1.1;
/// A gap of so many usual ones has lost a frame.
const LOSS: f64 = 1.5;

/// The search result for a reference frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Partner {
    /// No later frame can be nearer.
    Found {
        /// In the queue.
        index: usize,
        /// Its stamp relative to the reference frame's \[ns\].
        offset_ns: i64,
    },
    /// A later frame may be nearer than this one (index and offset), if any.
    Possible(Option<(usize, i64)>),
    /// None, because this camera is slower than the reference.
    Surplus,
    /// No frame within the tolerance is left for it, nor can one come.
    Missing,
}

/// The rate of the reference camera, at a frame of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    /// Stamp of the frame \[ns\].
    pub stamp_ns: i64,
    /// Stamp of the next frame, arrived or expected; `None` if it is not known \[ns\].
    pub next_ns: Option<i64>,
    /// The usual gap \[ns\]; `None` if it is not known.
    pub gap_ns: Option<i64>,
}

/// The waiting frames of one camera.
#[derive(Clone, Debug)]
pub(super) struct Queue<T> {
    waiting: VecDeque<(i64, T)>,
    newest_ns: Option<i64>,
    /// Stamp of the last frame that was taken out.
    taken_ns: Option<i64>,
    gaps: Gaps,
}

/// The distance of two stamps \[ns\].
fn distance(a_ns: i64, b_ns: i64) -> u64 {
    a_ns.abs_diff(b_ns)
}

impl<T> Queue<T> {
    pub fn new() -> Self {
        Self {
            waiting: VecDeque::new(),
            newest_ns: None,
            taken_ns: None,
            gaps: Gaps::default(),
        }
    }

    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Stamp of the newest frame, also after it has left.
    pub fn newest_ns(&self) -> Option<i64> {
        self.newest_ns
    }

    /// Stamp of the first waiting frame.
    pub fn first_ns(&self) -> Option<i64> {
        self.waiting.front().map(|(stamp_ns, _)| *stamp_ns)
    }

    /// The first waiting frame as the reference.
    pub fn reference(&self) -> Option<Reference> {
        let next = self.waiting.get(1).map(|(stamp_ns, _)| *stamp_ns);
        Some(Reference {
            stamp_ns: self.first_ns()?,
            next_ns: next.or_else(|| self.expected_ns()),
            gap_ns: self.gaps.usual_ns(),
        })
    }

    /// The expected stamp of the next frame; `None` before the second frame.
    fn expected_ns(&self) -> Option<i64> {
        let (newest_ns, gap_ns) = self.newest_ns.zip(self.gaps.usual_ns())?;
        Some(newest_ns.saturating_add(gap_ns))
    }

    /// Adds a frame, whose stamp is above the newest.
    pub fn push(&mut self, stamp_ns: i64, frame: T) {
        if let Some(newest_ns) = self.newest_ns {
            self.gaps.push(stamp_ns.saturating_sub(newest_ns));
        }
        self.newest_ns = Some(stamp_ns);
        self.waiting.push_back((stamp_ns, frame));
    }

    /// Takes the first frame.
    pub fn pop(&mut self) -> Option<(i64, T)> {
        let taken = self.waiting.pop_front()?;
        self.taken_ns = Some(taken.0);
        Some(taken)
    }

    /// Takes the frame at `index` for a match, and the earlier ones.
    pub fn take(&mut self, index: usize) -> (Vec<(i64, T)>, Option<T>) {
        let earlier = self.waiting.drain(..index.min(self.waiting.len()));
        let earlier = earlier.collect();
        (earlier, self.pop().map(|(_, frame)| frame))
    }

    /// Starts anew; returns the frames that waited.
    pub fn restart(&mut self) -> VecDeque<(i64, T)> {
        std::mem::replace(self, Self::new()).waiting
    }

    /// Stamp of the nearest waiting frame, or else of the newest, relative to `stamp_ns` \[ns\].
    pub fn nearest_known_ns(&self, stamp_ns: i64) -> Option<i64> {
        let nearest = self.nearest(stamp_ns).map(|(_, found_ns)| found_ns);
        let found_ns = nearest.or(self.newest_ns)?;
        Some(found_ns.saturating_sub(stamp_ns))
    }

    /// Index and stamp of the waiting frame that is nearest to a time; of two, the earlier one.
    fn nearest(&self, stamp_ns: i64) -> Option<(usize, i64)> {
        let after = self
            .waiting
            .partition_point(|(own_ns, _)| *own_ns < stamp_ns);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let near = near.filter_map(|index| Some((index, self.waiting.get(index)?.0)));
        near.min_by_key(|(_, own_ns)| distance(*own_ns, stamp_ns))
    }

    /// The partner of a reference frame.
    pub fn partner(&self, reference: Reference, tolerance_ns: i64) -> Partner {
        let Reference {
            stamp_ns, next_ns, ..
        } = reference;
        let tolerance = tolerance_ns.unsigned_abs();
        let found = self
            .nearest(stamp_ns)
            .filter(|(_, own_ns)| distance(*own_ns, stamp_ns) <= tolerance);
        let is_passed = self
            .newest_ns
            .is_some_and(|newest_ns| newest_ns >= stamp_ns);
        let Some((index, own_ns)) = found else {
            return match is_passed {
                false => Partner::Possible(None),
                true if self.is_slower(reference) && !self.lacks(stamp_ns) => Partner::Surplus,
                true => Partner::Missing,
            };
        };
        let offset_ns = own_ns.saturating_sub(stamp_ns);
        let own = distance(own_ns, stamp_ns);
        let is_later_nearer = || {
            let expected_ns = self.expected_ns();
            expected_ns.is_none_or(|expected_ns| distance(expected_ns, stamp_ns) < own)
        };
        if !is_passed && is_later_nearer() {
            return Partner::Possible(Some((index, offset_ns)));
        }
        let is_of_next =
            next_ns.is_some_and(|next_ns| next_ns > stamp_ns && distance(next_ns, own_ns) < own);
        match is_of_next {
            true if self.is_slower(reference) => Partner::Surplus,
            true => Partner::Missing,
            false => Partner::Found { index, offset_ns },
        }
    }

    /// Whether this camera is slower than the reference; also if one of the rates is not known, since nothing shows a loss.
    fn is_slower(&self, reference: Reference) -> bool {
        let gaps = self.gaps.usual_ns().zip(reference.gap_ns);
        gaps.is_none_or(|(own_ns, reference_ns)| own_ns as f64 > SLOWER * reference_ns as f64)
    }

    /// Whether a frame is lost between the frames before and after this time.
    fn lacks(&self, stamp_ns: i64) -> bool {
        let after = self
            .waiting
            .partition_point(|(own_ns, _)| *own_ns < stamp_ns);
        let stamp_of = |index: usize| self.waiting.get(index).map(|(stamp_ns, _)| *stamp_ns);
        let before_ns = after.checked_sub(1).and_then(stamp_of).or(self.taken_ns);
        let span_ns = before_ns
            .zip(stamp_of(after))
            .map(|(before_ns, after_ns)| after_ns.saturating_sub(before_ns));
        span_ns
            .zip(self.gaps.usual_ns())
            .is_none_or(|(span_ns, gap_ns)| span_ns as f64 > LOSS * gap_ns as f64)
    }
}
