use std::sync::Arc;

use wm_bag::{BagError, BagMessage};
use wm_motion::{
    actions::{ActionError, ActionSpace},
    joints::{JointActions, JointSample},
    motion::{Interval, Motion, MotionSettings},
};
use wm_msgs::{Message as _, sensor_msgs::JointState, wm_msgs::Action};

use super::unusable_bag::UnusableBag;

/// The actions of a recording, by their stamps.
#[derive(Debug, Default)]
pub(super) struct ActionLog {
    /// \[ns\], ascending after [`Self::sort`].
    stamps: Vec<i64>,
    /// `width` values per stamp: an hour at 100 Hz with seven dimensions takes 13 MB.
    values: Vec<f32>,
    width: usize,
    /// Stamps of implausible actions \[ns\].
    implausible: Vec<i64>,
    /// Description of the first one.
    first_implausible: Option<String>,
    /// Of a topic of joint states.
    joints: Option<JointActions>,
}

impl ActionLog {
    pub fn new(space: &ActionSpace) -> Self {
        Self {
            width: space.len(),
            ..Self::default()
        }
    }

    /// Whether this type has actions.
    pub fn reads(type_name: &str) -> bool {
        type_name == Action::ros_name() || type_name == JointState::ros_name()
    }

    /// Accepted types, for an error.
    pub fn types() -> String {
        format!("{} or {}", Action::ros_name(), JointState::ros_name())
    }

    /// Adds a message at the time `at_ns(stamp of its header)` \[ns\].
    ///
    /// # Errors
    /// [`UnusableBag::Lacks`] for an undecodable message, [`UnusableBag::Differs`] for one of another action space.
    pub fn push(
        &mut self,
        message: &BagMessage,
        space: &ActionSpace,
        at_ns: impl FnOnce(i64) -> i64,
    ) -> Result<(), UnusableBag> {
        let undecodable = |error: BagError| UnusableBag::Lacks(error.to_string());
        if *message.type_name == Action::ros_name() {
            let action: Action = message.decode().map_err(undecodable)?;
            let at_ns = at_ns(action.header.stamp.to_nanos());
            return self
                .insert(at_ns, &action.values, space)
                .map_err(UnusableBag::Differs);
        }
        let state: JointState = message.decode().map_err(undecodable)?;
        let at_ns = at_ns(state.header.stamp.to_nanos());
        let joints = self
            .joints
            .get_or_insert_with(|| JointActions::new(space.clone()));
        let taken = joints.take(JointSample {
            at_ns,
            names: &state.name,
            positions: &state.position,
            velocities: &state.velocity,
        });
        // A late message has no action of its own.
        if let Ok(Some(action)) = taken {
            self.insert(action.stamp_ns, &action.values, space)
                .map_err(UnusableBag::Differs)?;
        }
        Ok(())
    }

    fn insert(&mut self, at_ns: i64, values: &[f32], space: &ActionSpace) -> Result<(), String> {
        match space.check(values) {
            Ok(()) => {
                self.stamps.push(at_ns);
                self.values.extend(values);
            }
            Err(error @ ActionError::Length { .. }) => return Err(error.to_string()),
            Err(error) => {
                self.implausible.push(at_ns);
                self.first_implausible
                    .get_or_insert_with(|| format!("at {at_ns} ns: {error}"));
            }
        }
        Ok(())
    }

    /// Sorts the actions by stamp. Call it after the last message.
    ///
    /// # Errors
    /// A dimension without a joint of its name.
    pub fn sort(&mut self, space: &ActionSpace) -> Result<(), String> {
        if let Some(mut joints) = self.joints.take() {
            if let Some(missing) = joints.missing() {
                return Err(missing.to_string());
            }
            if let Some(last) = joints.finish() {
                self.insert(last.stamp_ns, &last.values, space)?;
            }
        }
        if !self.stamps.is_sorted() {
            let mut order: Vec<usize> = (0..self.stamps.len()).collect();
            order.sort_by_key(|index| self.stamps.get(*index).copied());
            let rows = order.iter().filter_map(|index| self.row(*index));
            self.values = rows.flatten().copied().collect();
            self.stamps.sort_unstable();
        }
        self.drop_too_fast(space);
        self.implausible.sort_unstable();
        Ok(())
    }

    /// Drops actions too fast for any arm in the time until the next one, or in the usual time if longer, since stamps
    /// jitter.
    fn drop_too_fast(&mut self, space: &ActionSpace) {
        let pairs = self.stamps.iter().zip(self.stamps.iter().skip(1));
        let mut gaps: Vec<i64> = pairs.map(|(at, next)| next.saturating_sub(*at)).collect();
        gaps.sort_unstable();
        let Some(usual_ns) = gaps.get(gaps.len() / 2).copied().filter(|gap| *gap > 0) else {
            return;
        };
        let nexts = self.stamps.iter().skip(1).map(Some).chain([None]);
        let found = self.stamps.iter().zip(nexts).enumerate();
        let found = found.filter_map(|(index, (at_ns, next_ns))| {
            let gap_ns = next_ns.map_or(usual_ns, |next_ns| next_ns.saturating_sub(*at_ns));
            // Gaps are far below 2^53 ns.
            let span_s = gap_ns.max(usual_ns) as f64 / 1e9;
            let error = space.check_over(self.row(index)?, span_s).err()?;
            Some((index, *at_ns, error.to_string()))
        });
        let found: Vec<(usize, i64, String)> = found.collect();
        let Some((_, at_ns, error)) = found.first() else {
            return;
        };
        self.first_implausible
            .get_or_insert_with(|| format!("at {at_ns} ns: {error}"));
        self.implausible
            .extend(found.iter().map(|(_, at_ns, _)| *at_ns));
        let mut is_dropped = vec![false; self.stamps.len()];
        for (index, _, _) in &found {
            if let Some(is_dropped) = is_dropped.get_mut(*index) {
                *is_dropped = true;
            }
        }
        let kept = |index: &usize| is_dropped.get(*index) == Some(&false);
        let rows = (0..self.stamps.len()).filter(kept);
        let rows = rows.filter_map(|index| self.row(index));
        self.values = rows.flatten().copied().collect();
        let stamps = self.stamps.iter().zip(&is_dropped);
        self.stamps = stamps
            .filter(|(_, dropped)| !**dropped)
            .map(|(at_ns, _)| *at_ns)
            .collect();
    }

    fn row(&self, index: usize) -> Option<&[f32]> {
        self.values
            .get(index * self.width..(index + 1) * self.width)
    }

    /// Actions with their stamps \[ns\], by time.
    pub fn rows(&self) -> impl Iterator<Item = (i64, &[f32])> + Clone {
        let rows = self.values.chunks_exact(self.width.max(1));
        self.stamps.iter().copied().zip(rows)
    }

    pub fn is_empty(&self) -> bool {
        self.stamps.is_empty()
    }

    /// Number of dropped actions, and a description of the first.
    pub fn implausible(&self) -> Option<(usize, &str)> {
        let first = self.first_implausible.as_deref()?;
        Some((self.implausible.len(), first))
    }

    /// Whether an action between `from_ns` and `to_ns` was dropped.
    fn is_doubtful(&self, from_ns: i64, to_ns: i64) -> bool {
        let first = self.implausible.partition_point(|at_ns| *at_ns < from_ns);
        self.implausible
            .get(first)
            .is_some_and(|at_ns| *at_ns <= to_ns)
    }
}

/// The motion of a robot over a recording, by time.
pub(super) struct Alignment<'a> {
    log: &'a ActionLog,
    space: &'a ActionSpace,
    motion: Motion,
    next: usize,
    period_ns: i64,
    /// Delay between the stamp and the effect of actions \[ns\].
    shift_ns: i64,
}

impl<'a> Alignment<'a> {
    /// Actions take effect `shift` periods after their stamps.
    pub fn new(log: &'a ActionLog, space: &'a ActionSpace, period_ns: i64, shift: i64) -> Self {
        Self {
            log,
            space,
            motion: Motion::new(MotionSettings::of_period(period_ns)),
            next: 0,
            period_ns,
            shift_ns: period_ns.saturating_mul(shift),
        }
    }

    /// Motion from `from_ns` to `to_ns`, at or after the last call; `None` if no action is known then. Velocities are those
    /// of the same motion in one period.
    pub fn between(&mut self, from_ns: i64, to_ns: i64) -> Option<Interval> {
        let from_ns = from_ns.saturating_sub(self.shift_ns);
        let to_ns = to_ns.saturating_sub(self.shift_ns);
        // Feeds actions in steps: `Motion` keeps a minute.
        let until_ns = to_ns.saturating_add(self.period_ns);
        while let Some(at_ns) = self.log.stamps.get(self.next)
            && *at_ns <= until_ns
            && let Some(values) = self.log.row(self.next)
        {
            self.motion.take(*at_ns, Arc::from(values));
            self.next += 1;
        }
        let mut interval = self.motion.between(self.space, from_ns, to_ns)?;
        let span_ns = to_ns.saturating_sub(from_ns);
        self.space.to_nominal(&mut interval.values, span_ns);
        let doubtful_from_ns = from_ns.saturating_sub(self.period_ns);
        interval.is_given &= !self.log.is_doubtful(doubtful_from_ns, to_ns);
        Some(interval)
    }
}
