//! Meanings in the names of values.

/// Words of velocities.
const VELOCITY: [&str; 10] = [
    "vel",
    "vels",
    "velocity",
    "velocities",
    "speed",
    "qd",
    "dq",
    "qdot",
    "qvel",
    "twist",
];
/// Words of changes.
const DELTA: [&str; 8] = [
    "delta",
    "deltas",
    "d",
    "diff",
    "change",
    "relative",
    "rel",
    "increment",
];
/// Words of states that are neither positions nor angles.
const NO_POSITION: [&str; 8] = [
    "effort",
    "efforts",
    "torque",
    "torques",
    "force",
    "tau",
    "acceleration",
    "accel",
];
/// Words that do not tell one value from another.
const PLAIN: [&str; 21] = [
    "pos",
    "position",
    "positions",
    "q",
    "qpos",
    "angle",
    "angles",
    "target",
    "targets",
    "goal",
    "cmd",
    "command",
    "commanded",
    "desired",
    "action",
    "actions",
    "state",
    "obs",
    "observation",
    "measured",
    "actual",
];
/// Words beside the axis of a hand.
const HAND: [&str; 18] = [
    "k",
    "ee",
    "eef",
    "tcp",
    "tool",
    "hand",
    "end",
    "effector",
    "endeffector",
    "pose",
    "arm",
    "left",
    "right",
    "robot",
    "base",
    "world",
    "cartesian",
    "cart",
];
/// Words of fingers.
const FINGER: [&str; 8] = [
    "finger", "fingers", "thumb", "index", "middle", "ring", "pinky", "little",
];

/// The part of a robot that a value describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// The hand along an axis.
    Axis,
    /// The hand about an axis.
    Turn,
    Finger,
    Joint,
}

/// The words of a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ValueName(Vec<String>);

impl ValueName {
    /// Splits at case, at digits, and at other characters: `kLeftElbow`, `joint_0_vel`, `shoulder.pos`, `qd1`.
    pub fn new(name: &str) -> Self {
        let mut words: Vec<String> = Vec::new();
        let mut before = ' ';
        for letter in name.chars() {
            let is_new = !before.is_alphanumeric()
                || before.is_ascii_digit() != letter.is_ascii_digit()
                || (before.is_lowercase() && letter.is_uppercase());
            before = letter;
            if !letter.is_alphanumeric() {
                continue;
            }
            if is_new {
                words.push(String::new());
            }
            if let Some(word) = words.last_mut() {
                word.extend(letter.to_lowercase());
            }
        }
        Self(words.into_iter().flat_map(split_axis).collect())
    }

    fn has(&self, words: &[&str]) -> bool {
        self.0.iter().any(|word| words.contains(&word.as_str()))
    }

    pub fn is_gripper(&self) -> bool {
        self.0.iter().any(|word| word.contains("grip"))
    }

    pub fn is_velocity(&self) -> bool {
        self.has(&VELOCITY)
    }

    pub fn is_delta(&self) -> bool {
        self.has(&DELTA)
    }

    pub fn is_degrees(&self) -> bool {
        self.has(&["deg", "degree", "degrees"])
    }

    /// Whether a state of this name may be a position or an angle.
    pub fn is_position(&self) -> bool {
        !self.is_velocity() && !self.has(&NO_POSITION)
    }

    /// The words that tell one value from another.
    pub fn core(&self) -> Vec<&str> {
        let words = self.0.iter().map(String::as_str);
        let is_core = |word: &&str| {
            let others = [&VELOCITY[..], &DELTA, &PLAIN];
            !others.iter().any(|words| words.contains(word))
        };
        words.filter(is_core).collect()
    }

    pub fn part(&self) -> Part {
        let mut words = self.core();
        words.retain(|word| !HAND.contains(word));
        match words.as_slice() {
            ["x" | "y" | "z"] => Part::Axis,
            ["roll" | "pitch" | "yaw" | "rx" | "ry" | "rz"] => Part::Turn,
            _ if self.has(&FINGER) => Part::Finger,
            _ => Part::Joint,
        }
    }
}

/// `dx` is a change of `x`, `vx` and `wx` are velocities.
fn split_axis(word: String) -> Vec<String> {
    let axes = ["x", "y", "z", "roll", "pitch", "yaw", "rx", "ry", "rz"];
    let of = |prefix: char| {
        let axis = word.strip_prefix(prefix);
        axis.filter(|axis| axes.contains(axis)).map(str::to_owned)
    };
    if let Some(axis) = of('d') {
        return vec!["d".to_owned(), axis];
    }
    if let Some(axis) = of('v') {
        return vec!["vel".to_owned(), axis];
    }
    if let Some(axis) = of('w').filter(|axis| axis.len() == 1) {
        return vec!["vel".to_owned(), format!("r{axis}")];
    }
    vec![word]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_of_names_match_their_states() {
        let core = |name: &str| ValueName::new(name).core().join(" ");
        for (action, state) in [
            ("joint_0_vel", "joint_0"),
            ("shoulder_pan.pos", "shoulder_pan"),
            ("kLeftElbow", "k_left_elbow"),
            ("qd1", "q1"),
            ("action_joint1_velocity", "observation.joint1_position"),
            ("delta_j2", "j2"),
            ("dx", "x"),
            ("ee_vx", "ee_x"),
            ("target_roll", "roll"),
        ] {
            assert_eq!(core(action), core(state), "{action} {state}");
            assert!(!core(action).is_empty(), "{action}");
        }
        assert_ne!(core("joint_0"), core("joint_1"));
        assert_eq!(core("velocity"), "");
    }

    #[test]
    fn names_tell_motions_parts_and_grippers() {
        let of = ValueName::new;
        for name in ["joint_0_vel", "qd1", "dq_3", "jointVelocity2", "vx", "wz"] {
            assert!(of(name).is_velocity() && !of(name).is_position(), "{name}");
        }
        for name in ["dx", "delta_j2", "droll", "j1_rel"] {
            assert!(of(name).is_delta() && !of(name).is_velocity(), "{name}");
        }
        for name in ["drive", "level", "elbow_delay", "value_3"] {
            assert!(!of(name).is_delta() && !of(name).is_velocity(), "{name}");
        }
        for name in ["gripper", "left_gripper.pos", "kGripper", "robotiq_grip"] {
            assert!(of(name).is_gripper(), "{name}");
        }
        for (name, part) in [
            ("ee_x", Part::Axis),
            ("dz", Part::Axis),
            ("left_tcp_yaw", Part::Turn),
            ("wx", Part::Turn),
            ("kLeftShoulderPitch", Part::Joint),
            ("kRightHandThumbBend", Part::Finger),
            ("joint_4", Part::Joint),
        ] {
            assert_eq!(of(name).part(), part, "{name}");
        }
    }
}
