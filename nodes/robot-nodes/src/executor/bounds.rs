//! Bounds of a single action.

use std::{ops::RangeInclusive, time::Duration};

use wm_motion::{actions::Kind, motion::MAX_CHUNK};

use super::{Joints, Layout, Offer, Refusal};

/// How far beyond 0 and 1 the opening of a gripper may lie: policies regress it.
const GRIPPER_SLACK: f32 = 0.1;

/// Bounds of a single action.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Greatest translation along an axis in an [`Self::interval`] \[m\].
    pub translation: f64,
    /// Greatest rotation about an axis in an [`Self::interval`] \[rad\].
    pub rotation: f64,
    /// Greatest motion of each joint in an [`Self::interval`] \[rad or m\].
    pub joints: Vec<f64>,
    /// The time of these bounds. A longer action, such as a planner's, may move further.
    pub interval: Duration,
    /// Least and greatest duration.
    pub periods: RangeInclusive<Duration>,
}

impl Bounds {
    /// Checks all actions of an offer. Positions of joints count as motions from the ones before, the first from `places`, and
    /// must be within `limits` \[rad or m\].
    ///
    /// # Errors
    /// [`Refusal`] names the first that is at fault.
    pub fn check(
        &self,
        offer: &Offer,
        layout: &Layout,
        joints: Option<&Joints>,
    ) -> Result<(), Refusal> {
        let count = offer.actions.len();
        if !(1..=MAX_CHUNK).contains(&count) {
            return Err(Refusal::Count(count));
        }
        // A negative period has no unsigned form, and is none.
        let period = u64::try_from(offer.period_ns).map(Duration::from_nanos);
        let period_s = offer.period_ns as f64 / 1e9;
        if !period.is_ok_and(|period| self.periods.contains(&period)) {
            return Err(Refusal::Period {
                period_s,
                least_s: self.periods.start().as_secs_f64(),
                most_s: self.periods.end().as_secs_f64(),
            });
        }
        let mut actions = offer.actions.iter().enumerate();
        actions
            .try_for_each(|(index, values)| self.check_action(index, values, period_s, layout))?;
        match joints {
            None => Ok(()),
            Some(joints) => self.check_places(offer, period_s, layout, joints),
        }
    }

    /// The checks that depend on the actions before.
    fn check_places(
        &self,
        offer: &Offer,
        period_s: f64,
        layout: &Layout,
        joints: &Joints,
    ) -> Result<(), Refusal> {
        let intervals = period_s / self.interval.as_secs_f64();
        let mut before = joints.places();
        for (index, values) in offer.actions.iter().enumerate() {
            let Some(places) = layout.positions(values) else {
                return Ok(());
            };
            let each = places.as_slice().iter().zip(joints.names());
            for (axis, ((place, name), (least, most))) in each.zip(joints.limits()).enumerate() {
                if !(*least..=*most).contains(place) {
                    return Err(Refusal::Place {
                        index,
                        name: name.clone(),
                        place: *place,
                        least: *least,
                        most: *most,
                    });
                }
                let from = before.and_then(|before| before.as_slice().get(axis).copied());
                // The first action has no way.
                let way = place - from.unwrap_or(*place);
                // A joint without a bound may not move.
                let limit = self.joints.get(axis).copied().unwrap_or(0.0) * intervals;
                if way.abs() > limit * (1.0 + f64::from(f32::EPSILON)) {
                    return Err(Refusal::Way {
                        index,
                        name: name.clone(),
                        way,
                        limit,
                        period_s,
                    });
                }
            }
            before = Some(places);
        }
        Ok(())
    }

    fn check_action(
        &self,
        index: usize,
        values: &[f32],
        period_s: f64,
        layout: &Layout,
    ) -> Result<(), Refusal> {
        let intervals = period_s / self.interval.as_secs_f64();
        let space = layout.space();
        space
            .check(values)
            .map_err(|error| Refusal::Action { index, error })?;
        let mut joints = self.joints.iter();
        for (value, dimension) in values.iter().zip(space.dimensions()) {
            let name = || dimension.name.clone();
            let limit = match dimension.kind {
                Kind::TranslationDelta => self.translation * intervals,
                Kind::RotationDelta => self.rotation * intervals,
                // A joint without a bound may not move.
                Kind::JointDelta => joints.next().copied().unwrap_or(0.0) * intervals,
                Kind::JointPosition => continue,
                _ if (-GRIPPER_SLACK..=1.0 + GRIPPER_SLACK).contains(value) => continue,
                _ => {
                    return Err(Refusal::Gripper {
                        index,
                        name: name(),
                        value: *value,
                    });
                }
            };
            // A value that was written as f32 may lie beyond its own limit by the rounding.
            if f64::from(value.abs()) > limit * (1.0 + f64::from(f32::EPSILON)) {
                return Err(Refusal::Bounds {
                    index,
                    name: name(),
                    value: *value,
                    limit,
                    unit: dimension.unit.clone(),
                    period_s,
                });
            }
        }
        Ok(())
    }
}
