//! The state of an arm over time.

use std::collections::BTreeMap;

use wm_bag::{BagError, BagMessage};
use wm_motion::actions::{ActionSpace, Dimension, Kind};
use wm_msgs::{Message as _, geometry_msgs::PoseStamped, sensor_msgs::JointState};

/// Limit of samples of a joint or the pose: an hour at 50 Hz.
const SAMPLES_LIMIT: usize = 180_000;
const JOINTS_LIMIT: usize = 64;
/// Samples further than this do not count at a time \[ns\].
const NEAR_NS: i64 = 500_000_000;
/// Endings of a dimension's name after its joint's name.
const ENDINGS: [&str; 4] = ["_vel", "_velocity", "_delta", ".pos"];

/// Topics of an arm's pose, in the order of preference.
pub const POSE_TOPICS: [&str; 2] = ["/arm/end_effector_pose", "/wm/ee_pose"];
/// Topic of the joints.
pub const JOINTS_TOPIC: &str = "/joint_states";

/// The pose of an end effector: position \[m\] and unit quaternion x y z w.
type Pose = ([f64; 3], [f64; 4]);

/// Poses and joints of a recording.
#[derive(Clone, Debug, Default)]
pub struct StateLog {
    poses: Vec<(i64, Pose)>,
    joints: BTreeMap<String, Vec<(i64, f64)>>,
}

impl StateLog {
    /// Adds a state message at its stamp, converted by `at_ns`.
    ///
    /// # Errors
    /// The bytes are not of the message's type.
    pub fn take(
        &mut self,
        message: &BagMessage,
        at_ns: impl FnOnce(i64) -> i64,
    ) -> Result<(), BagError> {
        if *message.type_name == PoseStamped::ros_name() {
            let stamped: PoseStamped = message.decode()?;
            let (position, turn) = (stamped.pose.position, stamped.pose.orientation);
            if self.poses.len() < SAMPLES_LIMIT {
                let at_ns = at_ns(stamped.header.stamp.to_nanos());
                let position = [position.x, position.y, position.z];
                self.poses
                    .push((at_ns, (position, [turn.x, turn.y, turn.z, turn.w])));
            }
        } else if *message.type_name == JointState::ros_name() {
            let state: JointState = message.decode()?;
            let at_ns = at_ns(state.header.stamp.to_nanos());
            for (name, position) in state.name.iter().zip(&state.position) {
                let is_known = self.joints.contains_key(name);
                if is_known || self.joints.len() < JOINTS_LIMIT {
                    let samples = self.joints.entry(name.clone()).or_default();
                    if samples.len() < SAMPLES_LIMIT {
                        samples.push((at_ns, *position));
                    }
                }
            }
        }
        Ok(())
    }

    /// The state of each dimension of `space` over time.
    #[must_use]
    pub fn path(mut self, space: &ActionSpace) -> StatePath {
        self.poses.sort_by_key(|(at_ns, _)| *at_ns);
        for samples in self.joints.values_mut() {
            samples.sort_by_key(|(at_ns, _)| *at_ns);
        }
        let turns = self.turns();
        // Number of earlier values of this kind.
        let mut axes: BTreeMap<&'static str, usize> = BTreeMap::new();
        let mut axis = |group| {
            let count = axes.entry(group).or_default();
            *count += 1;
            *count - 1
        };
        let columns = space
            .dimensions()
            .iter()
            .map(|dimension| match dimension.kind {
                Kind::TranslationDelta => self.position(axis("translation")),
                Kind::Position => self.position(axis("position")),
                Kind::Velocity if dimension.unit == "m/s" => self.position(axis("velocity")),
                Kind::RotationDelta | Kind::Velocity => {
                    let axis = axis("rotation");
                    let angle =
                        |(at_ns, angles): &(i64, [f64; 3])| Some((*at_ns, *angles.get(axis)?));
                    turns.iter().filter_map(angle).collect()
                }
                _ => self.joint(dimension),
            });
        StatePath(columns.collect())
    }

    fn position(&self, axis: usize) -> Vec<(i64, f64)> {
        let value = |(at_ns, (position, _)): &(i64, Pose)| Some((*at_ns, *position.get(axis)?));
        self.poses.iter().filter_map(value).collect()
    }

    fn joint(&self, dimension: &Dimension) -> Vec<(i64, f64)> {
        let name = dimension.name.as_str();
        let shorter = ENDINGS
            .iter()
            .filter_map(|ending| name.strip_suffix(ending));
        let mut names = std::iter::once(name).chain(shorter);
        names
            .find_map(|name| self.joints.get(name))
            .cloned()
            // An unknown joint has no samples.
            .unwrap_or_default()
    }

    /// Cumulated rotation vectors about the axes of the base \[rad\]: for small turns between poses, roll, pitch and yaw.
    fn turns(&self) -> Vec<(i64, [f64; 3])> {
        let mut sum = [0.0; 3];
        let mut before: Option<[f64; 4]> = None;
        let turned = self.poses.iter().map(|(at_ns, (_, turn))| {
            let vector = before.map_or([0.0; 3], |before| rotation_between(before, *turn));
            before = Some(*turn);
            for (sum, angle) in sum.iter_mut().zip(vector) {
                *sum += angle;
            }
            (*at_ns, sum)
        });
        turned.collect()
    }
}

/// The rotation vector from one unit quaternion (x y z w) to another, in the fixed frame \[rad\].
fn rotation_between([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 3] {
    // b times the conjugate of a.
    let w = bw * aw + bx * ax + by * ay + bz * az;
    let vector = [
        -bw * ax + bx * aw - by * az + bz * ay,
        -bw * ay + by * aw - bz * ax + bx * az,
        -bw * az + bz * aw - bx * ay + by * ax,
    ];
    let length = vector.iter().map(|value| value * value).sum::<f64>().sqrt();
    // q and -q are the same turn: take the shorter way.
    let angle = 2.0 * length.atan2(w.abs()) * if w < 0.0 { -1.0 } else { 1.0 };
    vector.map(|value| {
        if length > 0.0 {
            value / length * angle
        } else {
            0.0
        }
    })
}

/// The state of each dimension over time, in the units of the action space.
#[derive(Clone, Debug)]
pub struct StatePath(Vec<Vec<(i64, f64)>>);

impl StatePath {
    /// The state at a time, interpolated; NaN without near samples.
    #[must_use]
    pub fn at(&self, at_ns: i64) -> Vec<f32> {
        let value = |samples: &Vec<(i64, f64)>| {
            let after = samples.partition_point(|(sample_ns, _)| *sample_ns < at_ns);
            let near = |index: usize| {
                let sample = samples.get(index).copied();
                sample.filter(|(sample_ns, _)| sample_ns.abs_diff(at_ns) <= NEAR_NS.unsigned_abs())
            };
            let (before, after) = (after.checked_sub(1).and_then(near), near(after));
            let value = match (before, after) {
                (Some((from_ns, from)), Some((to_ns, to))) if to_ns > from_ns => {
                    let share = (at_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
                    from + (to - from) * share
                }
                (Some((_, value)), _) | (None, Some((_, value))) => value,
                (None, None) => f64::NAN,
            };
            // Single precision, as actions.
            value as f32
        };
        self.0.iter().map(value).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// The quaternion of a turn about one axis.
    fn about(axis: usize, angle: f64) -> [f64; 4] {
        let mut turn = [0.0, 0.0, 0.0, (angle / 2.0).cos()];
        turn[axis] = (angle / 2.0).sin();
        turn
    }

    #[test]
    fn turn_is_a_vector_about_the_axes_of_the_base() {
        let start = about(2, 0.5);
        // Half a radian about z, then 0.1 rad about the fixed x.
        let [x, y, z, w] = start;
        let (s, c) = (0.05_f64.sin(), 0.05_f64.cos());
        let turned = [c * x + s * w, c * y - s * z, c * z + s * y, c * w - s * x];
        let vector = rotation_between(start, turned);
        assert!((vector[0] - 0.1).abs() < 1e-9, "{vector:?}");
        assert!(
            vector[1].abs() < 1e-9 && vector[2].abs() < 1e-9,
            "{vector:?}"
        );
        let opposite = rotation_between(start, turned.map(|value| -value));
        assert!((opposite[0] - 0.1).abs() < 1e-9, "{opposite:?}");
    }

    #[test]
    fn positions_are_interpolated_between_near_samples() {
        let mut log = StateLog::default();
        for (index, x) in [(0, 0.1), (1, 0.2), (2, 0.4)] {
            log.poses
                .push((index * 200_000_000, ([x, 0.0, 0.3], about(0, 0.0))));
        }
        let path = log.path(&ActionSpace::bridge());
        let x = |at_ms: i64| path.at(at_ms * 1_000_000)[0];
        assert!((x(100) - 0.15).abs() < 1e-6 && (x(300) - 0.3).abs() < 1e-6);
        assert!((x(600) - 0.4).abs() < 1e-6 && x(1000).is_nan());
        assert!((path.at(0)[2] - 0.3).abs() < 1e-6 && path.at(0)[6].is_nan());
    }

    #[test]
    fn joints_are_found_by_dimension_names() {
        let joint = |name: &str, kind| Dimension {
            name: name.into(),
            unit: "rad".into(),
            kind,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let dimensions = vec![
            joint("joint_0_vel", Kind::JointDelta),
            joint("joint_1", Kind::JointPosition),
            joint("joint_9", Kind::JointPosition),
        ];
        let space = ActionSpace::new("joints".into(), 10.0, dimensions).unwrap();
        let mut log = StateLog::default();
        log.joints.insert("joint_0".into(), vec![(0, 1.0)]);
        log.joints.insert("joint_1".into(), vec![(0, 2.0)]);
        let at = log.path(&space).at(0);
        assert!(at[..2] == [1.0, 2.0] && at[2].is_nan());
    }
}
