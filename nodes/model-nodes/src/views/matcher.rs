//! Frames of several cameras, matched by their stamps.
//!
//! The first camera is the reference. As in training, each of its frames gets the nearest frame of every other camera, at most
//! the tolerance away. Unlike in training, a frame is used once: of two reference frames with the same nearest frame, the
//! nearer one gets it. No frame waits for a later one that cannot be nearer: the next stamp of a camera is expected one usual
//! gap after its last.

mod gaps;
mod queue;

use crate::encoder::JUMP_NS;
use queue::{Partner, Queue, Reference};

/// The limits of a match.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// Most time between the stamps of a reference frame and its partner \[ns\]; at least 0.
    pub tolerance_ns: i64,
    /// Most time that a frame waits for those of other cameras, by the stamps that arrive meanwhile \[ns\]; at least 0.
    pub longest_wait_ns: i64,
    /// Most frames of a camera that wait; at least 1.
    pub queue: usize,
}

/// Why a frame is in no picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DropReason {
    /// Its camera is faster than the others. No loss.
    Surplus,
    /// Its stamp is not later than that of the frame before.
    OutOfOrder,
    /// It waited for frames of a time that ended with a jump.
    TimeJump,
    /// The camera of this index has no frame within the tolerance, or none that is not another frame's partner.
    Unmatched {
        /// Index of the camera.
        missing: usize,
        /// Stamp of its nearest frame relative to this one \[ns\]; `None` if none waits.
        nearest_ns: Option<i64>,
    },
}

/// A frame that is in no picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameDrop<T> {
    /// Index of its camera.
    pub camera: usize,
    /// Its stamp \[ns\].
    pub stamp_ns: i64,
    /// Why.
    pub reason: DropReason,
    /// The frame.
    pub frame: T,
}

/// Frames of one moment, one of each camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Match<T> {
    /// Stamp of the reference frame \[ns\].
    pub stamp_ns: i64,
    /// The frames, in the order of the cameras.
    pub frames: Vec<T>,
    /// Their stamps relative to the reference frame's \[ns\]; the first is 0.
    pub offsets_ns: Vec<i64>,
}

/// The effects of a frame's arrival.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival<T> {
    /// In the order of their stamps.
    pub matches: Vec<Match<T>>,
    /// In the order in which they were dropped.
    pub drops: Vec<FrameDrop<T>>,
}

/// The waiting frames of all cameras.
#[derive(Clone, Debug)]
pub struct Matcher<T> {
    rules: Rules,
    reference: Queue<T>,
    others: Vec<Queue<T>>,
}

/// The fate of the first waiting reference frame.
enum Fate {
    /// One index for each other camera, with the offset.
    Matched(Vec<(usize, i64)>),
    Dropped(DropReason),
    Waiting,
}

impl<T> Matcher<T> {
    /// Without a frame, for `cameras` cameras (at least 1).
    pub fn new(rules: Rules, cameras: usize) -> Self {
        Self {
            rules,
            reference: Queue::new(),
            others: (1..cameras).map(|_| Queue::new()).collect(),
        }
    }

    /// Takes a frame of the camera with this index. An unknown index is that of the reference.
    pub fn arrive(&mut self, camera: usize, stamp_ns: i64, frame: T) -> Arrival<T> {
        let mut arrival = Arrival {
            matches: Vec::new(),
            drops: Vec::new(),
        };
        let dropped = |stamp_ns, frame, reason| FrameDrop {
            camera,
            stamp_ns,
            reason,
            frame,
        };
        let queue = self.queue(camera);
        if let Some(newest_ns) = queue.newest_ns()
            && stamp_ns <= newest_ns
        {
            if newest_ns.saturating_sub(stamp_ns) <= JUMP_NS {
                let drop = dropped(stamp_ns, frame, DropReason::OutOfOrder);
                arrival.drops.push(drop);
                return arrival;
            }
            let stale = queue.restart().into_iter();
            let stale =
                stale.map(|(stamp_ns, frame)| dropped(stamp_ns, frame, DropReason::TimeJump));
            arrival.drops.extend(stale);
        }
        queue.push(stamp_ns, frame);
        self.settle(&mut arrival);
        self.tidy(&mut arrival);
        arrival
    }

    /// Drops all waiting frames of a camera, whose next frame is of another time or another camera.
    pub fn restart(&mut self, camera: usize) -> Vec<FrameDrop<T>> {
        let waiting = self.queue(camera).restart().into_iter();
        let drops = waiting.map(|(stamp_ns, frame)| FrameDrop {
            camera,
            stamp_ns,
            reason: DropReason::TimeJump,
            frame,
        });
        drops.collect()
    }

    /// Number of cameras.
    pub fn cameras(&self) -> usize {
        1 + self.others.len()
    }

    /// Number of waiting frames of all cameras.
    pub fn waiting(&self) -> usize {
        let others: usize = self.others.iter().map(Queue::len).sum();
        self.reference.len() + others
    }

    fn queue(&mut self, camera: usize) -> &mut Queue<T> {
        let other = camera.checked_sub(1);
        match other.and_then(|other| self.others.get_mut(other)) {
            Some(queue) => queue,
            None => &mut self.reference,
        }
    }

    /// The newest stamp of all cameras.
    fn newest_ns(&self) -> Option<i64> {
        let others = self.others.iter().filter_map(Queue::newest_ns);
        others.chain(self.reference.newest_ns()).max()
    }

    fn is_overdue(&self, stamp_ns: i64) -> bool {
        let newest_ns = self.newest_ns();
        newest_ns.is_some_and(|newest_ns| {
            newest_ns.saturating_sub(stamp_ns) > self.rules.longest_wait_ns
        })
    }

    /// Settles the reference frames in their order, until one has to wait.
    fn settle(&mut self, arrival: &mut Arrival<T>) {
        while let Some(reference) = self.reference.reference() {
            match self.fate(reference) {
                Fate::Waiting => return,
                Fate::Dropped(reason) => {
                    let frame = self.reference.pop().into_iter();
                    arrival
                        .drops
                        .extend(frame.map(|(stamp_ns, frame)| FrameDrop {
                            camera: 0,
                            stamp_ns,
                            reason,
                            frame,
                        }));
                }
                Fate::Matched(partners) => self.take(&partners, arrival),
            }
        }
    }

    fn fate(&self, reference: Reference) -> Fate {
        let Rules {
            tolerance_ns,
            queue,
            ..
        } = self.rules;
        let stamp_ns = reference.stamp_ns;
        let is_overdue = self.is_overdue(stamp_ns) || self.reference.len() > queue;
        let mut partners = Vec::with_capacity(self.others.len());
        let (mut is_waiting, mut is_surplus) = (false, false);
        for (index, other) in self.others.iter().enumerate() {
            match other.partner(reference, tolerance_ns) {
                Partner::Found { index, offset_ns } => partners.push((index, offset_ns)),
                Partner::Possible(found) if is_overdue => match found {
                    Some(found) => partners.push(found),
                    None => return self.unmatched(stamp_ns, 1 + index, other),
                },
                Partner::Possible(_) => is_waiting = true,
                Partner::Surplus => is_surplus = true,
                Partner::Missing => return self.unmatched(stamp_ns, 1 + index, other),
            }
        }
        match (is_surplus, is_waiting) {
            (true, _) => Fate::Dropped(DropReason::Surplus),
            (false, true) => Fate::Waiting,
            (false, false) => Fate::Matched(partners),
        }
    }

    fn unmatched(&self, stamp_ns: i64, missing: usize, other: &Queue<T>) -> Fate {
        Fate::Dropped(DropReason::Unmatched {
            missing,
            nearest_ns: other.nearest_known_ns(stamp_ns),
        })
    }

    /// Takes the first reference frame and its partners out of the queues.
    fn take(&mut self, partners: &[(usize, i64)], arrival: &mut Arrival<T>) {
        let Some((stamp_ns, frame)) = self.reference.pop() else {
            return;
        };
        let (mut frames, mut offsets_ns) = (vec![frame], vec![0]);
        for (camera, (other, (index, offset_ns))) in (1..).zip(self.others.iter_mut().zip(partners))
        {
            let (earlier, taken) = other.take(*index);
            let surplus = earlier.into_iter().map(|(stamp_ns, frame)| FrameDrop {
                camera,
                stamp_ns,
                reason: DropReason::Surplus,
                frame,
            });
            arrival.drops.extend(surplus);
            frames.extend(taken);
            offsets_ns.push(*offset_ns);
        }
        arrival.matches.push(Match {
            stamp_ns,
            frames,
            offsets_ns,
        });
    }

    /// Drops frames of other cameras that no reference frame can take any more, and those beyond the queue's length.
    fn tidy(&mut self, arrival: &mut Arrival<T>) {
        let Rules {
            tolerance_ns,
            longest_wait_ns,
            queue,
        } = self.rules;
        let newest_ns = self.newest_ns();
        // Reference frames come in the order of their stamps.
        let reference_ns = self.reference.first_ns().or(self.reference.newest_ns());
        let is_late = |since_ns: Option<i64>| {
            let silent = newest_ns.zip(since_ns);
            silent.is_none_or(|(newest_ns, since_ns)| {
                newest_ns.saturating_sub(since_ns) > longest_wait_ns
            })
        };
        let is_reference_silent = is_late(self.reference.newest_ns());
        for (camera, other) in (1..).zip(&mut self.others) {
            while let Some(first_ns) = other.first_ns() {
                let is_past = reference_ns.is_some_and(|reference_ns| {
                    first_ns < reference_ns.saturating_sub(tolerance_ns)
                });
                let is_overdue = is_reference_silent && is_late(Some(first_ns));
                if !(is_past || is_overdue || other.len() > queue) {
                    break;
                }
                let reason = match is_reference_silent && !is_past {
                    false => DropReason::Surplus,
                    true => DropReason::Unmatched {
                        missing: 0,
                        nearest_ns: self.reference.nearest_known_ns(first_ns),
                    },
                };
                let frame = other.pop().into_iter();
                arrival
                    .drops
                    .extend(frame.map(|(stamp_ns, frame)| FrameDrop {
                        camera,
                        stamp_ns,
                        reason,
                        frame,
                    }));
            }
        }
    }
}

#[cfg(test)]
mod tests;
