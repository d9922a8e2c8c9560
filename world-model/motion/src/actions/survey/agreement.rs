//! Compares actions with the state changes that follow them.

use super::{Hint, moments::Moments};
use crate::actions::{ActionSpace, Kind};

/// Greatest shift between actions and states that is tried \[frames\].
const SHIFTS: i64 = 3;
const SHIFT_COUNT: usize = 2 * SHIFTS as usize + 1;
/// Fewer pairs are not evidence.
const LEAST_PAIRS: u64 = 8;

/// Sums over all episodes that have states.
#[derive(Clone, Debug, Default)]
pub(super) struct Agreement {
    pairs: u64,
    /// Sums of |action - next state| and of |action - state change| \[m\].
    from_state: f64,
    from_change: f64,
    /// Sums per axis.
    axes: [Products; 3],
    /// Sums of action times state change, by shift from -[`SHIFTS`] on \[frames\].
    shifted: [f64; SHIFT_COUNT],
    gripper: Moments,
}

#[derive(Clone, Copy, Debug, Default)]
struct Products {
    action: f64,
    change: f64,
    both: f64,
}

impl Agreement {
    pub fn add<A: AsRef<[f32]>, S: AsRef<[f32]>>(
        &mut self,
        space: &ActionSpace,
        actions: &[A],
        states: &[S],
    ) {
        let of_kind = |wanted: fn(Kind) -> bool| {
            let dimensions = space.dimensions().iter().enumerate();
            let found = dimensions.filter(move |(_, dimension)| wanted(dimension.kind));
            found.map(|(index, _)| index).collect::<Vec<_>>()
        };
        let value = |row: Option<&[f32]>, index: usize| {
            row.and_then(|row| row.get(index)).copied().map(f64::from)
        };
        let state = |frame: usize, index| value(states.get(frame).map(AsRef::as_ref), index);
        let change = |frame: usize, index| Some(state(frame + 1, index)? - state(frame, index)?);
        let translations = of_kind(|kind| kind == Kind::TranslationDelta);
        for (frame, action) in actions.iter().enumerate() {
            let action = Some(action.as_ref());
            for (axis, index) in translations.iter().take(3).enumerate() {
                let (Some(taken), Some(changed), Some(next)) = (
                    value(action, *index),
                    change(frame, *index),
                    state(frame + 1, *index),
                ) else {
                    continue;
                };
                self.pairs += 1;
                self.from_state += (taken - next).abs();
                self.from_change += (taken - changed).abs();
                if let Some(products) = self.axes.get_mut(axis) {
                    products.action += taken * taken;
                    products.change += changed * changed;
                    products.both += taken * changed;
                }
                for (slot, shift) in self.shifted.iter_mut().zip(-SHIFTS..) {
                    let later = i64::try_from(frame)
                        .ok()
                        .and_then(|frame| frame.checked_add(shift));
                    let later = later.and_then(|later| usize::try_from(later).ok());
                    if let Some(changed) = later.and_then(|later| change(later, *index)) {
                        *slot += taken * changed;
                    }
                }
            }
            for index in of_kind(Kind::is_gripper).into_iter().take(1) {
                if let (Some(taken), Some(next)) = (value(action, index), state(frame + 1, index)) {
                    self.gripper.add(taken, next);
                }
            }
        }
    }

    /// Whether actions are nearer to the next state than to the state change.
    pub fn is_absolute(&self) -> bool {
        self.pairs >= LEAST_PAIRS
            && self.from_state < 0.5 * self.from_change
            // 5 mm on average: a robot that hardly moves near its base's origin is no evidence.
            && self.from_change > 0.005 * self.pairs as f64
    }

    /// Whether the gripper closes when its action opens.
    pub fn is_gripper_opposed(&self) -> bool {
        self.gripper.count >= LEAST_PAIRS as f64 && self.gripper.correlation() < -0.5
    }

    /// Frames by which the state follows the actions; `None` if at once.
    pub fn lag(&self) -> Option<i64> {
        if self.pairs < LEAST_PAIRS {
            return None;
        }
        let total = |part: fn(&Products) -> f64| self.axes.iter().map(part).sum::<f64>();
        let scale = (total(|axis| axis.action) * total(|axis| axis.change)).sqrt();
        let now = self.shifted.get(SHIFTS.unsigned_abs() as usize)?;
        let shifts = self.shifted.iter().zip(-SHIFTS..);
        let (best, shift) = shifts.max_by(|(a, _), (b, _)| a.total_cmp(b))?;
        // Steady motion in one direction has similar sums at all shifts.
        (shift != 0 && *best > 0.6 * scale && *best > now.abs() * 1.2).then_some(shift)
    }

    /// Axes along which state change and action differ in size.
    pub fn scales(&self, space: &ActionSpace) -> Vec<Hint> {
        let translations = space.dimensions().iter();
        let translations = translations.filter(|d| d.kind == Kind::TranslationDelta);
        let axes = translations.zip(&self.axes);
        let hint = |(dimension, axis): (&crate::actions::Dimension, &Products)| {
            if self.pairs < LEAST_PAIRS || axis.action <= 0.0 || axis.change <= 0.0 {
                return None;
            }
            let correlation = axis.both / (axis.action * axis.change).sqrt();
            let factor = axis.both / axis.action;
            let is_other = !(0.6..=1.6).contains(&factor) && correlation.abs() > 0.7;
            is_other.then(|| Hint::Scale {
                column: dimension.name.clone(),
                factor,
            })
        };
        axes.filter_map(hint).collect()
    }
}
