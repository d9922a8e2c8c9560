//! Frames of an episode: action, motion in the picture, state.

use crate::{pictures::IDLE, quantile::quantile};
use wm_motion::actions::{ActionSpace, Kind};

/// Quantile from which a value of a dimension is strong.
const STRONG: f64 = 0.9;
/// Limit of a value in standard deviations of its dimension: a single wrong value is not motion.
const DEVIATIONS_LIMIT: f32 = 5.0;

/// The effect of an action's value on the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// Changes the state: a delta by its value, a velocity by its value times the period.
    Change,
    /// A target that the state follows.
    Target,
    /// Opens or closes a gripper, whose motion is not compared.
    Gripper,
}

impl Effect {
    /// The effect of a value of this kind between two frames.
    pub fn of(kind: Kind) -> Self {
        if kind.is_gripper() {
            Self::Gripper
        } else if kind.is_motion() {
            Self::Change
        } else {
            Self::Target
        }
    }
}

/// Evenly spaced frames of one episode, each with the action up to the next frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Name of the episode or bag.
    pub name: String,
    width: usize,
    actions: Vec<f32>,
    /// Mean change of the picture since the previous frame \[levels\]; NaN if unknown.
    motion: Vec<f32>,
    /// The state in the units of the action's dimensions; NaN if unknown.
    state: Vec<f32>,
}

impl Episode {
    /// An episode without frames, for actions of `width` values.
    #[must_use]
    pub fn new(name: impl Into<String>, width: usize) -> Self {
        Self {
            name: name.into(),
            width: width.max(1),
            ..Self::default()
        }
    }

    /// Adds a frame: the action up to the next frame, the mean change of the picture since the previous frame \[levels\], and
    /// the state, with any origin. `None` is unknown.
    pub fn push(&mut self, action: &[f32], motion: Option<f32>, state: Option<&[f32]>) {
        let unknown = std::iter::repeat(f32::NAN);
        let row = |values: &[f32]| -> Vec<f32> {
            let values = values.iter().copied().chain(unknown.clone());
            values.take(self.width).collect()
        };
        self.actions.extend(row(action));
        self.state.extend(row(state.unwrap_or_default()));
        self.motion.push(motion.unwrap_or(f32::NAN));
    }

    /// The number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.motion.len()
    }

    /// Whether it has no frames.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.motion.is_empty()
    }

    /// The values of a dimension at each frame.
    fn column(&self, values: &[f32], dimension: usize) -> Vec<f32> {
        values
            .iter()
            .skip(dimension)
            .step_by(self.width)
            .copied()
            .collect()
    }

    /// The actions, a row for each frame.
    pub(crate) fn rows(&self) -> Vec<&[f32]> {
        self.actions.chunks_exact(self.width).collect()
    }

    /// The action's value of a dimension at each frame.
    pub(crate) fn actions(&self, dimension: usize) -> Vec<f32> {
        self.column(&self.actions, dimension)
    }

    /// The state's value of a dimension at each frame.
    pub(crate) fn state(&self, dimension: usize) -> Vec<f32> {
        self.column(&self.state, dimension)
    }

    /// The actions, a row for each frame.
    #[cfg(test)]
    pub(crate) fn actions_mut(&mut self) -> &mut [f32] {
        &mut self.actions
    }

    /// Commanded change of a dimension at each frame; for velocities, per second.
    pub(crate) fn changes(&self, dimension: usize, kind: Kind) -> Vec<f32> {
        let values = self.actions(dimension);
        match Effect::of(kind) {
            Effect::Change => values,
            Effect::Gripper => vec![0.0; values.len()],
            Effect::Target => differences(&values),
        }
    }

    /// The change of the picture from each frame to the next \[levels\].
    pub(crate) fn motion(&self) -> impl Iterator<Item = f32> {
        self.motion.iter().skip(1).copied()
    }
}

/// Differences between successive values; 0 for the first.
pub(crate) fn differences(values: &[f32]) -> Vec<f32> {
    let before = values.first().into_iter().chain(values);
    values
        .iter()
        .zip(before)
        .map(|(now, before)| now - before)
        .collect()
}

/// Speed at each frame: root of the sum of squares over the dimensions, each in standard deviations over all episodes.
pub(crate) fn speeds(episodes: &[Vec<Vec<f32>>]) -> Vec<Vec<f32>> {
    // 0 without episodes.
    let dimensions = episodes.iter().map(Vec::len).max().unwrap_or(0);
    let scales: Vec<f32> = (0..dimensions)
        .map(|dimension| {
            let values = episodes.iter().filter_map(|episode| episode.get(dimension));
            standard_deviation(values.flatten().copied())
        })
        .collect();
    let of_episode = |episode: &Vec<Vec<f32>>| {
        let frames = episode.first().map_or(0, Vec::len);
        let mut squares = vec![0.0_f32; frames];
        for (values, scale) in episode
            .iter()
            .zip(&scales)
            .filter(|(_, scale)| **scale > 0.0)
        {
            for (square, value) in squares.iter_mut().zip(values) {
                *square += (value.abs() / scale).min(DEVIATIONS_LIMIT).powi(2);
            }
        }
        squares.into_iter().map(f32::sqrt).collect()
    };
    episodes.iter().map(of_episode).collect()
}

/// The standard deviation of the finite values; 0 without values.
fn standard_deviation(values: impl Iterator<Item = f32> + Clone) -> f32 {
    let finite = || {
        values
            .clone()
            .filter(|value| value.is_finite())
            .map(f64::from)
    };
    let count = finite().count().max(1) as f64;
    let mean = finite().sum::<f64>() / count;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    // The values have single precision.
    variance.sqrt() as f32
}

/// Strong actions by dimension: the unit of a robot's activity.
#[derive(Clone, Debug)]
pub(crate) struct Strength(Vec<f32>);

impl Strength {
    /// Computes it from changes, by dimension.
    pub fn of(dimensions: impl Iterator<Item = Vec<f32>>) -> Self {
        let strong = dimensions.map(|values| {
            let magnitudes = || values.iter().map(|value| value.abs());
            let strong = quantile(magnitudes(), STRONG).filter(|strong| *strong > 0.0);
            // 0 without values: the dimension is then ignored.
            strong.or(quantile(magnitudes(), 1.0)).unwrap_or(0.0)
        });
        Self(strong.collect())
    }

    /// The activity of one action: 0 idle, 1 strong in at least one dimension.
    pub fn activity(&self, changes: impl Iterator<Item = f32>) -> f32 {
        let shares = changes.zip(&self.0).filter(|(_, strong)| **strong > 0.0);
        let shares = shares.map(|(change, strong)| change.abs() / strong);
        shares.fold(0.0, f32::max)
    }
}

/// The episodes of a data set or a bag, and their action space.
#[derive(Clone, Copy, Debug)]
pub struct Episodes<'a> {
    /// The episodes.
    pub episodes: &'a [Episode],
    /// The action space.
    pub space: &'a ActionSpace,
    /// Frame period \[s\].
    pub period_s: f64,
}

impl Episodes<'_> {
    /// Change of the state by a value of 1 in one period; velocities are integrated.
    pub(crate) fn change_of_one(&self, kind: Kind) -> f64 {
        if kind.is_velocity() {
            self.period_s
        } else {
            1.0
        }
    }

    pub(crate) fn frames(&self) -> usize {
        self.episodes.iter().map(Episode::len).sum()
    }

    /// Commanded changes by episode, dimension and frame.
    pub(crate) fn changes(&self) -> Vec<Vec<Vec<f32>>> {
        let dimensions = self.space.dimensions();
        let of_episode = |episode: &Episode| {
            let changes = (0..).zip(dimensions);
            changes
                .map(|(index, d)| episode.changes(index, d.kind))
                .collect()
        };
        self.episodes.iter().map(of_episode).collect()
    }

    /// The activity of the robot at each frame, by episode.
    pub(crate) fn activity(&self) -> Vec<Vec<f32>> {
        let changes = self.changes();
        let all = (0..self.space.len()).map(|dimension| {
            let values = changes.iter().filter_map(|episode| episode.get(dimension));
            values.flatten().copied().collect()
        });
        let strength = Strength::of(all);
        let of_episode = |episode: &Vec<Vec<f32>>| {
            let frames = episode.first().map_or(0, Vec::len);
            let at = |frame: usize| {
                // In range: all dimensions of an episode have the same length.
                let values = episode.iter().map(|v| v.get(frame).copied().unwrap_or(0.0));
                strength.activity(values)
            };
            (0..frames).map(at).collect()
        };
        changes.iter().map(of_episode).collect()
    }

    /// Whether the robot is idle at each frame, by episode: no action, and no motion in the picture, if known.
    pub(crate) fn idle(&self) -> Vec<Vec<bool>> {
        let activity = self.activity();
        let of_episode = |(episode, activity): (&Episode, &Vec<f32>)| {
            let motion = episode.motion().chain([f32::NAN]);
            let frames = activity.iter().zip(motion);
            // An unknown change of the picture does not decide.
            let is_idle =
                |(acts, moves): (&f32, f32)| *acts < IDLE && (moves.is_nan() || moves < 1.0);
            frames.map(is_idle).collect()
        };
        self.episodes
            .iter()
            .zip(&activity)
            .map(of_episode)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_motion::actions::Dimension;

    #[test]
    fn targets_count_by_their_change() {
        let mut episode = Episode::new("a", 2);
        for target in [0.1, 0.1, 0.4] {
            episode.push(&[target, 1.0], None, Some(&[target]));
        }
        let changes = episode.changes(0, Kind::JointPosition);
        assert_eq!(changes.len(), 3);
        assert!((changes[2] - 0.3).abs() < 1e-6 && changes[..2] == [0.0, 0.0]);
        for kind in [Kind::JointDelta, Kind::JointVelocity, Kind::Velocity] {
            assert_eq!(episode.changes(0, kind), [0.1, 0.1, 0.4]);
        }
        assert_eq!(episode.changes(1, Kind::GripperBinary), [0.0; 3]);
        assert!(episode.state(1).iter().all(|value| value.is_nan()));
    }

    #[test]
    fn activity_is_relative_to_strong_actions() {
        let joint = |name: &str| Dimension {
            name: name.into(),
            unit: "rad".into(),
            kind: Kind::JointDelta,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let space = ActionSpace::new("two".into(), 5.0, vec![joint("a"), joint("b")]);
        let space = space.unwrap();
        let mut episode = Episode::new("a", 2);
        for index in 0..20 {
            let strong = if index < 5 { 0.0 } else { 0.2 };
            episode.push(&[strong, 0.0], Some(f32::from(index > 3) * 5.0), None);
        }
        let episodes = Episodes {
            episodes: &[episode],
            space: &space,
            period_s: 0.2,
        };
        assert_eq!(episodes.activity()[0][4..6], [0.0, 1.0]);
        // The picture changes from frame 3.
        assert_eq!(episodes.idle()[0][..5], [true, true, true, false, false]);
        let changes = episodes.changes();
        let speeds = speeds(&changes);
        assert!(speeds[0][0] == 0.0 && speeds[0][10] > 1.0);
    }
}
