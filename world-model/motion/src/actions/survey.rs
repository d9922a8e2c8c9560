//! Checks the ranges of recorded actions against their kinds and units.

mod agreement;
mod comparison;
mod finding;
mod moments;

use std::fmt;

use super::{ActionSpace, Dimension, Kind, limits::Unit};
use agreement::Agreement;
pub use comparison::{StateComparison, StateRelation};
pub use finding::{Cause, Contradiction, Hint};

/// Longest net translation along one axis in an episode \[m\]. Beyond it, the "deltas" are positions.
const LONGEST_WAY: f64 = 2.5;
/// Longest net rotation in an episode \[rad\]: two turns.
const LONGEST_TURN: f64 = 4.0 * std::f64::consts::PI;
/// Greatest net speed over an episode \[m/s\].
const MEAN_SPEED: f64 = 1.0;
/// Shorter episodes have no meaningful mean speed.
const LEAST_ACTIONS: usize = 5;
/// Share of the range by which measured openings overshoot closed and open.
const GRIPPER_SLACK: f32 = 0.1;

/// Greatest rounding error of zero motion \[m, rad\].
const IDLE: f32 = 1e-6;
/// Least change of a state above noise \[m, rad\].
const LEAST_CHANGE: f32 = 2e-3;

/// A closed range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Least value.
    pub low: f32,
    /// Greatest value.
    pub high: f32,
}

impl Range {
    const EMPTY: Self = Self {
        low: f32::INFINITY,
        high: f32::NEG_INFINITY,
    };

    fn add(&mut self, value: f32) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    fn magnitude(self) -> f32 {
        self.low.abs().max(self.high.abs())
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", Rounded(self.low), Rounded(self.high))
    }
}

/// Prints three significant digits.
struct Rounded(f32);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = f64::from(self.0);
        if !value.is_finite() {
            return write!(f, "{value}");
        }
        // Smaller values are rounding errors.
        if value.abs() < 1e-9 {
            return write!(f, "0");
        }
        // The exponent of an f32 is within -45 to 38.
        let place = 10f64.powi(2 - value.abs().log10().floor() as i32);
        let rounded = (value * place).round() / place;
        match (1e-4..1e7).contains(&rounded.abs()) {
            true => write!(f, "{rounded}"),
            false => write!(f, "{value:.2e}"),
        }
    }
}

/// Measurements of one value of the actions.
#[derive(Clone, Debug)]
struct Column {
    range: Range,
    /// Greatest change between consecutive actions.
    step: f32,
    /// Greatest net motion of an episode, and greatest net motion per second.
    net: f64,
    net_speed: f64,
    /// Episodes in which the gripper moves by more than half of its range, and those of them that begin closed.
    moving: usize,
    begins_low: usize,
}

/// Ranges of the actions of a data set, episode by episode.
#[derive(Clone, Debug)]
pub struct ActionSurvey {
    space: ActionSpace,
    rate: f64,
    columns: Vec<Column>,
    episodes: usize,
    /// Episodes whose first action alone is zero.
    first_zero: usize,
    agreement: Agreement,
}

impl ActionSurvey {
    /// An empty survey for actions of `space`, recorded at `rate` \[Hz\].
    #[must_use]
    pub fn new(space: ActionSpace, rate: f64) -> Self {
        let column = Column {
            range: Range::EMPTY,
            step: 0.0,
            net: 0.0,
            net_speed: 0.0,
            moving: 0,
            begins_low: 0,
        };
        Self {
            columns: vec![column; space.len()],
            space,
            rate,
            episodes: 0,
            first_zero: 0,
            agreement: Agreement::default(),
        }
    }

    /// Measures an episode: `actions` (T, values of the space) and `states` (T, the same values as poses; empty if
    /// unknown).
    pub fn add<A: AsRef<[f32]>, S: AsRef<[f32]>>(&mut self, actions: &[A], states: &[S]) {
        if actions.is_empty() {
            return;
        }
        self.episodes += 1;
        let seconds = actions.len() as f64 / self.rate;
        let dimensions = self.space.dimensions().iter();
        for (index, (column, dimension)) in self.columns.iter_mut().zip(dimensions).enumerate() {
            let values = actions
                .iter()
                .filter_map(|action| action.as_ref().get(index).copied());
            let (mut own, mut sum, mut before) = (Range::EMPTY, 0.0, None);
            for value in values {
                own.add(value);
                sum += f64::from(value);
                if let Some(before) = before.replace(value) {
                    column.step = column.step.max((value - before).abs());
                }
            }
            column.range.add(own.low);
            column.range.add(own.high);
            if actions.len() >= LEAST_ACTIONS {
                column.net = column.net.max(sum.abs());
                column.net_speed = column.net_speed.max(sum.abs() / seconds);
            }
            let (closed, open) = ends(dimension);
            let half = (open - closed).abs() / 2.0;
            if dimension.kind.is_gripper() && own.high - own.low > half {
                column.moving += 1;
                let first = actions
                    .first()
                    .and_then(|action| action.as_ref().get(index));
                let is_closed = first.is_some_and(|v| (v - closed).abs() < (v - open).abs());
                column.begins_low += usize::from(is_closed);
            }
        }
        self.first_zero += usize::from(self.is_first_idle(actions, states));
        self.agreement.add(&self.space, actions, states);
    }

    /// Whether only the first action is zero, although the state changes (if known).
    fn is_first_idle<A: AsRef<[f32]>, S: AsRef<[f32]>>(&self, actions: &[A], states: &[S]) -> bool {
        let is_motion = |index: usize| {
            let dimension = self.space.dimensions().get(index);
            dimension.is_some_and(|dimension| dimension.kind.is_motion())
        };
        let is_still = |action: &A| {
            let mut motion = (0..)
                .zip(action.as_ref())
                .filter(|(index, _)| is_motion(*index));
            motion.all(|(_, value)| value.abs() < IDLE)
        };
        let has_moved = match states {
            [first, second, ..] => {
                let pairs = first.as_ref().iter().zip(second.as_ref());
                let mut motion = (0..).zip(pairs).filter(|(index, _)| is_motion(*index));
                motion.any(|(_, (before, after))| (after - before).abs() > LEAST_CHANGE)
            }
            _ => true,
        };
        has_moved && actions.first().is_some_and(is_still) && !actions.iter().all(is_still)
    }

    #[must_use]
    /// Measured episodes.
    pub fn episodes(&self) -> usize {
        self.episodes
    }

    /// Contradictions between values and kinds, at most one per column.
    #[must_use]
    pub fn contradictions(&self) -> Vec<Contradiction> {
        let mut found: Vec<Contradiction> = Vec::new();
        if self.episodes == 0 {
            return found;
        }
        let is_absolute = self.agreement.is_absolute();
        for (dimension, column) in self.space.dimensions().iter().zip(&self.columns) {
            let cause = match dimension.kind {
                kind if kind.is_gripper() => gripper_cause(dimension, column.range),
                Kind::TranslationDelta if is_absolute => Some(Cause::Absolute),
                _ => self.motion_cause(dimension, column),
            };
            let Some(cause) = cause else { continue };
            found.push(Contradiction {
                column: dimension.name.clone(),
                unit: dimension.unit.clone(),
                kind: dimension.kind,
                rate: self.rate,
                measured: column.range,
                expected: self.expected(dimension),
                cause,
            });
        }
        found
    }

    fn expected(&self, dimension: &Dimension) -> Range {
        if dimension.kind.is_gripper() {
            let (closed, open) = ends(dimension);
            return Range {
                low: closed,
                high: open,
            };
        }
        let limit = dimension.limit_over(self.rate.recip());
        Range {
            low: -limit,
            high: limit,
        }
    }

    /// Why a value of motion or position contradicts its kind.
    fn motion_cause(&self, dimension: &Dimension, column: &Column) -> Option<Cause> {
        let (limit, most) = (
            dimension.limit_over(self.rate.recip()),
            column.range.magnitude(),
        );
        let unit = Unit::parse(&dimension.unit);
        let (si, longest) = match unit {
            Some(Unit::Length(si)) => (si, LONGEST_WAY),
            Some(Unit::Angle(si)) => (si, LONGEST_TURN),
            None => (1.0, f64::INFINITY),
        };
        let is_far = column.net * si > longest
            || (matches!(unit, Some(Unit::Length(_))) && column.net_speed * si > MEAN_SPEED);
        let is_smooth = column.step < most / 2.0;
        if dimension.kind.is_delta() && is_far && is_smooth {
            return Some(Cause::Absolute);
        }
        if most <= limit {
            return None;
        }
        Some(match (unit, f64::from(most)) {
            _ if dimension.kind.is_delta() && is_smooth && column.step <= limit => Cause::Absolute,
            (Some(Unit::Length(1.0)), 10.0..=10_000.0) => Cause::Millimetres,
            (Some(Unit::Angle(1.0)), 12.0..=1000.0) => Cause::Degrees,
            (_, ..=1.05) if dimension.kind.is_motion() => Cause::Normalised,
            _ => Cause::TooFar,
        })
    }

    /// Unusual but possible findings.
    #[must_use]
    pub fn hints(&self) -> Vec<Hint> {
        let mut hints = Vec::new();
        for (dimension, column) in self.space.dimensions().iter().zip(&self.columns) {
            if !dimension.kind.is_gripper() || gripper_cause(dimension, column.range).is_some() {
                continue;
            }
            let (closed, open) = ends(dimension);
            let range = (open - closed).abs();
            let span = column.range.high - column.range.low;
            let reaches = |end: f32| {
                (column.range.low - end)
                    .abs()
                    .min((column.range.high - end).abs())
                    < 0.1 * range
            };
            if span > 0.0 && (!reaches(open) || !reaches(closed)) {
                hints.push(Hint::GripperRange {
                    column: dimension.name.clone(),
                    measured: column.range,
                });
            }
            // Four of five episodes.
            if column.moving > 0 && column.begins_low * 5 >= column.moving * 4 {
                hints.push(Hint::GripperInverted {
                    column: dimension.name.clone(),
                    begin_closed: column.begins_low,
                    episodes: column.moving,
                    measured: column.range,
                });
            }
        }
        if self.agreement.is_gripper_opposed() && !hints.iter().any(Hint::is_inverted) {
            let columns = self.space.dimensions().iter().zip(&self.columns);
            let gripper = columns
                .into_iter()
                .find(|(dimension, _)| dimension.kind.is_gripper());
            hints.extend(gripper.map(|(_, column)| Hint::GripperOpposed {
                measured: column.range,
            }));
        }
        if self.first_zero * 5 >= self.episodes * 4 && self.episodes > 0 {
            hints.push(Hint::FirstZero {
                zero: self.first_zero,
                episodes: self.episodes,
            });
        }
        if !self.agreement.is_absolute() {
            hints.extend(self.agreement.lag().map(|frames| Hint::Lag { frames }));
            hints.extend(self.agreement.scales(&self.space));
        }
        hints
    }
}

/// The values of a closed and of an open gripper.
fn ends(dimension: &Dimension) -> (f32, f32) {
    match dimension.kind {
        Kind::GripperContinuous => (dimension.offset, dimension.offset + dimension.scale.recip()),
        _ => (0.0, 1.0),
    }
}

fn gripper_cause(dimension: &Dimension, measured: Range) -> Option<Cause> {
    let (closed, open) = ends(dimension);
    let slack = (open - closed).abs() * GRIPPER_SLACK;
    let (least, most) = (closed.min(open) - slack, closed.max(open) + slack);
    if measured.low >= least && measured.high <= most {
        return None;
    }
    let (low, high) = (measured.low, measured.high);
    let (closed, open) = if low < -GRIPPER_SLACK {
        let is_unit = low >= -1.1 && high <= 1.1;
        if is_unit { (-1.0, 1.0) } else { (low, high) }
    } else {
        // Percent, byte and per mille ranges.
        let full = [100.0, 255.0, 1000.0];
        let full = full.into_iter().find(|full| high > 10.0 && high <= *full);
        (0.0, full.unwrap_or(high))
    };
    Some(Cause::Gripper { closed, open })
}

/// The ranges in order.
impl fmt::Display for ActionSurvey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plural = if self.episodes == 1 { "" } else { "s" };
        let rate = (self.rate * 100.0).round() / 100.0;
        write!(
            f,
            "actions of {} episode{plural} at {rate} Hz:",
            self.episodes
        )?;
        let columns = self.space.dimensions().iter().zip(&self.columns);
        for (index, (dimension, column)) in columns.enumerate() {
            let comma = if index == 0 { "" } else { "," };
            write!(f, "{comma} {} {}", dimension.name, column.range)?;
            if dimension.unit != "1" {
                write!(f, " {}", dimension.unit)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
