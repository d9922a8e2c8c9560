//! The arm as a URDF: the kinematics of [`arm`](crate::arm), and the shapes in the pictures.
//!
//! Names are those of Interbotix's `wx250s`. As in the simulator, joints have no limits; links have no mass.

use std::fmt::Write as _;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::JOINT_NAMES;
use crate::arm::{ELBOW_OFFSET_M, FOREARM_M, HAND_M, SHOULDER_HEIGHT_M, UPPER_ARM_M};
use crate::gripper::HALF_OPENING_M;
use crate::links::{Axis, Form, Link, LinkPart, arm_parts};

/// The motion of a joint.
#[derive(Clone, Copy)]
enum Movement {
    Fixed,
    /// A rotation about an axis.
    Turns(Axis),
    /// A translation along y, between two limits \[m\].
    Slides([f64; 2]),
}

/// A joint: name, parent and child link, origin in the parent \[m\], rotation about x there \[rad\], and motion.
struct Joint<'a> {
    name: &'static str,
    parent: &'a str,
    child: &'static str,
    origin: [f64; 3],
    roll: f64,
    movement: Movement,
}

/// Speed of the fingers in the simulator \[m/s\]; URDF requires an effort too \[N\], which the simulator does not model.
const FINGER_SPEED: f64 = 0.12;
const FINGER_EFFORT: f64 = 1.0;

fn joints(base: &str) -> [Joint<'_>; 10] {
    let joint = |name, parent, child, origin, movement| Joint {
        name,
        parent,
        child,
        origin,
        roll: 0.0,
        movement,
    };
    let (shoulder, elbow) = (
        [0.0, 0.0, SHOULDER_HEIGHT_M],
        [ELBOW_OFFSET_M, 0.0, UPPER_ARM_M],
    );
    let (here, forearm, hand) = ([0.0; 3], [FOREARM_M, 0.0, 0.0], [HAND_M, 0.0, 0.0]);
    let (x, y, z) = (
        Movement::Turns(Axis::X),
        Movement::Turns(Axis::Y),
        Movement::Turns(Axis::Z),
    );
    let (out, back) = (
        Movement::Slides([0.0, HALF_OPENING_M]),
        Movement::Slides([-HALF_OPENING_M, 0.0]),
    );
    [
        joint("waist", base, "shoulder_link", shoulder, z),
        joint("shoulder", "shoulder_link", "upper_arm_link", here, y),
        joint("elbow", "upper_arm_link", "upper_forearm_link", elbow, y),
        joint(
            "forearm_roll",
            "upper_forearm_link",
            "lower_forearm_link",
            forearm,
            x,
        ),
        joint("wrist_angle", "lower_forearm_link", "wrist_link", here, y),
        joint("wrist_rotate", "wrist_link", "gripper_link", here, x),
        joint(
            "ee_gripper",
            "gripper_link",
            "ee_gripper_link",
            hand,
            Movement::Fixed,
        ),
        // The frame of `gripper::hand`.
        Joint {
            roll: std::f64::consts::FRAC_PI_2,
            ..joint(
                "hand",
                "gripper_link",
                "fingers_link",
                hand,
                Movement::Fixed,
            )
        },
        joint("left_finger", "fingers_link", "left_finger_link", here, out),
        joint(
            "right_finger",
            "fingers_link",
            "right_finger_link",
            here,
            back,
        ),
    ]
}

fn link_name(link: Link, base: &str) -> &str {
    match link {
        Link::Base => base,
        Link::Waist => "shoulder_link",
        Link::UpperArm => "upper_arm_link",
        Link::Forearm => "upper_forearm_link",
        Link::ForearmRoll => "lower_forearm_link",
        Link::Wrist => "wrist_link",
        Link::Hand => "fingers_link",
        Link::Finger(0) => "right_finger_link",
        Link::Finger(_) => "left_finger_link",
    }
}

/// The arm as a URDF with the joints [`JOINT_NAMES`](crate::JOINT_NAMES), the root link `base`, and the tool's frame
/// `ee_gripper_link`.
pub fn urdf(base: &str) -> String {
    let base = escape(base);
    let (joints, parts) = (joints(&base), arm_parts());
    let mut text = String::from("<?xml version=\"1.0\"?>\n<robot name=\"wx250s\">\n");
    for link in std::iter::once(&*base).chain(joints.iter().map(|joint| joint.child)) {
        let parts = parts
            .iter()
            .filter(|part| link_name(part.link, &base) == link);
        let visuals: String = parts.map(visual).collect();
        let line = match visuals.as_str() {
            "" => format!("  <link name=\"{link}\"/>\n"),
            visuals => format!("  <link name=\"{link}\">\n{visuals}  </link>\n"),
        };
        text.push_str(&line);
    }
    text.extend(joints.iter().map(joint_element));
    text.push_str("</robot>\n");
    text
}

/// The frame of a link in its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkFrame {
    /// The parent's name in the [`urdf`].
    pub parent: String,
    /// The link's name.
    pub link: &'static str,
    /// The link's frame in the parent's.
    pub frame: Isometry3<f64>,
}

/// The frames of the links of the [`urdf`] with the root `base`, for joints at `positions` \[rad or m\] in the order of
/// [`JOINT_NAMES`].
pub fn link_frames(base: &str, positions: &[f64; 8]) -> Vec<LinkFrame> {
    let position = |name: &str| {
        let mut all = JOINT_NAMES.iter().zip(positions);
        all.find(|(joint, _)| **joint == name)
            .map_or(0.0, |(_, position)| *position)
    };
    let of = |joint: &Joint| {
        let by = |axis: Axis| Vector3::from(unit(axis)) * position(joint.name);
        let origin = Isometry3::from_parts(
            Translation3::from(joint.origin),
            UnitQuaternion::from_euler_angles(joint.roll, 0.0, 0.0),
        );
        let moved = match joint.movement {
            Movement::Fixed => Isometry3::identity(),
            Movement::Turns(axis) => Isometry3::rotation(by(axis)),
            Movement::Slides(_) => Isometry3::from(Translation3::from(by(Axis::Y))),
        };
        LinkFrame {
            parent: joint.parent.to_owned(),
            link: joint.child,
            frame: origin * moved,
        }
    };
    joints(base).iter().map(of).collect()
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

fn joint_element(joint: &Joint) -> String {
    let Joint {
        name,
        parent,
        child,
        origin: [x, y, z],
        roll,
        movement,
    } = joint;
    let (kind, rest) = match movement {
        Movement::Fixed => ("fixed", String::new()),
        Movement::Turns(axis) => ("continuous", axis_element(*axis)),
        Movement::Slides([lower, upper]) => (
            "prismatic",
            format!(
                "{}    <limit lower=\"{lower}\" upper=\"{upper}\" velocity=\"{FINGER_SPEED}\" effort=\"{FINGER_EFFORT}\"/>\n",
                axis_element(Axis::Y)
            ),
        ),
    };
    format!(
        "  <joint name=\"{name}\" type=\"{kind}\">\n    <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>\n    \
         <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} 0 0\"/>\n{rest}  </joint>\n"
    )
}

fn axis_element(axis: Axis) -> String {
    let [x, y, z] = unit(axis);
    format!("    <axis xyz=\"{x} {y} {z}\"/>\n")
}

fn unit(axis: Axis) -> [f64; 3] {
    match axis {
        Axis::X => [1.0, 0.0, 0.0],
        Axis::Y => [0.0, 1.0, 0.0],
        Axis::Z => [0.0, 0.0, 1.0],
    }
}

/// A part as a visual element. URDF has boxes and cylinders (along z), placed by their centres.
fn visual(part: &LinkPart) -> String {
    let quarter = std::f64::consts::FRAC_PI_2;
    let (middle, [roll, pitch], geometry) = match part.form {
        Form::Cuboid { low, high } => {
            let (low, high) = (Vector3::from(low), Vector3::from(high));
            let size = high - low;
            let geometry = format!("<box size=\"{} {} {}\"/>", size.x, size.y, size.z);
            ((low + high) / 2.0, [0.0; 2], geometry)
        }
        Form::Cylinder {
            axis,
            radius,
            from,
            length,
        } => {
            let along = Vector3::from(unit(axis)).cast::<f32>();
            let turn = match axis {
                Axis::X => [0.0, quarter],
                Axis::Y => [-quarter, 0.0],
                Axis::Z => [0.0; 2],
            };
            let geometry = format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>");
            (along * (from + length / 2.0), turn, geometry)
        }
    };
    let [red, green, blue] = part.srgb;
    let mut text = String::new();
    // Writing to a string cannot fail.
    writeln!(
        text,
        "    <visual>\n      <origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} 0\"/>\n      <geometry>{geometry}</geometry>\n      \
         <material name=\"{}\"><color rgba=\"{red} {green} {blue} 1\"/></material>\n    </visual>",
        middle.x,
        middle.y,
        middle.z,
        material(part.srgb),
    )
    .ok();
    text
}

/// The name of a material, unique for its colour.
fn material(srgb: [f32; 3]) -> String {
    // Fits: colours are from 0 to 1.
    let [red, green, blue] = srgb.map(|value| (value * 255.0).round() as u8);
    format!("colour_{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::arm::{self, Joints};
    use crate::gripper;

    /// The frames of the links in a URDF text.
    fn frames(text: &str, positions: &BTreeMap<&str, f64>) -> BTreeMap<String, Isometry3<f64>> {
        let value = |line: &str, key: &str| {
            let rest = line.split_once(&format!("{key}=\""))?.1;
            Some(rest.split_once('"')?.0.to_owned())
        };
        let numbers = |text: String| {
            let numbers: Vec<f64> = text
                .split(' ')
                .map(|n| n.parse().expect("a number"))
                .collect();
            Vector3::new(numbers[0], numbers[1], numbers[2])
        };
        let mut frames = BTreeMap::from([("base_link".to_owned(), Isometry3::identity())]);
        for joint in text.split("<joint ").skip(1) {
            let body = joint.split_once("</joint>").expect("its end").0;
            let of = |tag: &str, key: &str| value(body.split_once(tag)?.1, key);
            let parent = of("<parent", "link").expect("a parent");
            let [x, y, z] = numbers(of("<origin", "xyz").expect("a place")).into();
            let rpy = numbers(of("<origin", "rpy").expect("a turn"));
            let turn = UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z);
            let origin = Isometry3::from_parts(Translation3::new(x, y, z), turn);
            let axis = of("<axis", "xyz").map_or(Vector3::zeros(), numbers);
            let position = positions
                .get(&*value(body, "name").expect("a name"))
                .copied();
            let by = axis * position.unwrap_or(0.0);
            let moved = match value(body, "type").expect("a type").as_str() {
                "fixed" => Isometry3::identity(),
                "prismatic" => Isometry3::from_parts(by.into(), UnitQuaternion::identity()),
                "continuous" => Isometry3::rotation(by),
                other => panic!("{other}"),
            };
            let frame = frames[&parent] * origin * moved;
            frames.insert(of("<child", "link").expect("a child"), frame);
        }
        frames
    }

    proptest! {
        #[test]
        fn urdf_links_match_the_simulator(
            angles in prop::array::uniform6(-1.5..1.5_f64),
            opening in 0.0..1.0_f64,
        ) {
            let links = arm::forward(&Joints(angles));
            let finger = opening * HALF_OPENING_M;
            let [waist, shoulder, elbow, roll, wrist, rotate] = angles;
            let positions = [waist, shoulder, elbow, roll, wrist, rotate, finger, -finger];
            let named: BTreeMap<_, _> = JOINT_NAMES.into_iter().zip(positions).collect();
            let frames = frames(&urdf("base_link"), &named);
            let mut told = BTreeMap::from([("base_link".to_owned(), Isometry3::identity())]);
            for LinkFrame { parent, link, frame } in link_frames("base_link", &positions) {
                told.insert(link.to_owned(), told[&parent] * frame);
            }
            prop_assert_eq!(told.len(), frames.len());
            for (name, frame) in &frames {
                let apart = told[name].to_homogeneous() - frame.to_homogeneous();
                prop_assert!(apart.amax() < 1e-9, "{name}: {apart}");
            }
            let hand = gripper::hand(&links.tool);
            for (name, expected) in [
                ("shoulder_link", links.waist),
                ("upper_arm_link", links.upper_arm),
                ("upper_forearm_link", links.forearm),
                ("lower_forearm_link", links.forearm_roll),
                ("wrist_link", links.wrist),
                ("ee_gripper_link", links.tool),
                ("fingers_link", hand),
                ("left_finger_link", hand * Translation3::new(0.0, finger, 0.0)),
                ("right_finger_link", hand * Translation3::new(0.0, -finger, 0.0)),
            ] {
                let found = frames[name];
                let apart = (found.translation.vector - expected.translation.vector).norm();
                prop_assert!(apart < 1e-9, "{name}: {apart} m");
                prop_assert!(found.rotation.angle_to(&expected.rotation) < 1e-6, "{name}");
            }
        }
    }

    #[test]
    fn urdf_has_every_part_and_joint() {
        let text = urdf("a<b");
        assert!(
            text.contains("<link name=\"a&lt;b\">") && text.contains("<parent link=\"a&lt;b\"/>")
        );
        assert_eq!(text.matches("<visual>").count(), arm_parts().len());
        for name in JOINT_NAMES {
            assert!(text.contains(&format!("<joint name=\"{name}\"")), "{name}");
        }
        // A link for each joint, and the root.
        assert_eq!(
            text.matches("<link name").count(),
            text.matches("<joint ").count() + 1
        );
    }

    #[test]
    fn cylinder_matches_its_mesh() {
        for part in arm_parts() {
            let text = visual(&part);
            let origin = text.split_once("xyz=\"").expect("a place").1;
            let origin = origin.split_once('"').expect("its end").0;
            let middle: Vec<f32> = origin
                .split(' ')
                .map(|n| n.parse().expect("a number"))
                .collect();
            for (axis, middle) in middle.into_iter().enumerate() {
                let along = part
                    .mesh
                    .vertices
                    .iter()
                    .map(|vertex| vertex.position[axis]);
                let (low, high) = along.fold((f32::MAX, f32::MIN), |(low, high), at| {
                    (low.min(at), high.max(at))
                });
                assert!((middle - (low + high) / 2.0).abs() < 1e-6, "{text}");
            }
        }
    }
}
