//! The tasks of the operator.

use nalgebra::Vector3;

use crate::object::{BOWL_FLOOR_M, Object};
use crate::world::World;

/// Position of an object relative to another in the camera's view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// To the left of it.
    Left,
    /// To the right of it.
    Right,
    /// Nearer to the viewer.
    Front,
    /// Further from the viewer.
    Behind,
    /// On top of it.
    On,
    /// On it, a mat.
    OnMat,
    /// Into it, a bowl.
    In,
}

/// Largest distance of objects beside each other, metres.
const BESIDE_M: f64 = 0.16;
/// Largest error of a height, metres.
pub const LEVEL_M: f64 = 0.012;

impl Relation {
    /// Direction from the second object to the first: components to the viewer's right and away from the viewer.
    pub fn direction(self) -> [f64; 2] {
        match self {
            Self::Left => [-1.0, 0.0],
            Self::Right => [1.0, 0.0],
            Self::Front => [0.0, -1.0],
            Self::Behind => [0.0, 1.0],
            Self::On | Self::OnMat | Self::In => [0.0, 0.0],
        }
    }

    /// Height of the first object's foot over the second's, metres.
    pub fn rise(self, other: &Object) -> f64 {
        match self {
            Self::Left | Self::Right | Self::Front | Self::Behind => 0.0,
            Self::On | Self::OnMat => other.shape.height(),
            Self::In => BOWL_FLOOR_M,
        }
    }

    /// Whether the relation holds for a viewer along `viewer`.
    fn holds(self, object: &Object, other: &Object, viewer: [Vector3<f64>; 2]) -> bool {
        let offset = object.position() - other.position();
        let apart = offset.xy().norm();
        let level = if matches!(self, Self::On | Self::OnMat | Self::In) {
            offset.z - self.rise(other)
        } else {
            // On the table or a mat, whatever the other object stands on.
            object.position().z
        };
        if level.abs() > LEVEL_M {
            return false;
        }
        match self {
            Self::On | Self::OnMat => apart < other.shape.bounding_radius(),
            Self::In => apart < 0.6 * other.shape.bounding_radius(),
            Self::Left | Self::Right | Self::Front | Self::Behind => {
                let [right, ahead] = self.direction();
                let along = offset.dot(&(viewer[0] * right + viewer[1] * ahead));
                // Within 45 degrees of the direction.
                apart < BESIDE_M && along > std::f64::consts::FRAC_1_SQRT_2 * apart
            }
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Left => "to the left of",
            Self::Right => "to the right of",
            Self::Front => "in front of",
            Self::Behind => "behind",
            Self::On => "on top of",
            Self::OnMat => "on",
            Self::In => "into",
        }
    }
}

/// A task; objects are indices into the world's objects.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Free motion.
    Explore,
    /// Move the hand over an object.
    Reach { object: usize },
    /// Lift an object.
    PickUp { object: usize },
    /// Put an object near another.
    Place {
        object: usize,
        other: usize,
        relation: Relation,
        /// To the viewer's right, and away from the viewer: horizontal unit vectors.
        viewer: [Vector3<f64>; 2],
        /// The chosen place in the base frame, metres.
        spot: Vector3<f64>,
    },
    /// Push an object over the table.
    Push {
        object: usize,
        direction_words: &'static str,
        /// Direction, a horizontal unit vector.
        direction: Vector3<f64>,
        /// To the viewer's right, and away from the viewer: horizontal unit vectors.
        viewer: [Vector3<f64>; 2],
        /// Start position, metres.
        from: Vector3<f64>,
    },
}

impl Task {
    /// The object of the task, if any.
    pub fn object(&self) -> Option<usize> {
        match self {
            Self::Explore => None,
            Self::Reach { object }
            | Self::PickUp { object }
            | Self::Place { object, .. }
            | Self::Push { object, .. } => Some(*object),
        }
    }

    /// The task in words.
    pub fn instruction(&self, world: &World) -> String {
        let name = |index: usize| {
            world
                .objects()
                .get(index)
                .map_or_else(|| "object".to_owned(), |object| object.name())
        };
        match self {
            Self::Explore => "move around freely".to_owned(),
            Self::Reach { object } => format!("move the gripper above the {}", name(*object)),
            Self::PickUp { object } => format!("pick up the {}", name(*object)),
            Self::Place {
                object,
                other,
                relation,
                ..
            } => {
                format!(
                    "put the {} {} the {}",
                    name(*object),
                    relation.words(),
                    name(*other)
                )
            }
            Self::Push {
                object,
                direction_words,
                ..
            } => {
                format!("push the {} {direction_words}", name(*object))
            }
        }
    }

    /// Whether the task is fulfilled in `world`.
    pub fn succeeded(&self, world: &World) -> bool {
        let at = |index: &usize| world.objects().get(*index).map(|object| object.position());
        match self {
            Self::Explore => true,
            Self::Reach { object } => at(object).is_some_and(|position| {
                let offset = world.tool().position - position;
                offset.xy().norm() < 0.04 && offset.z > 0.0
            }),
            Self::PickUp { object } => {
                world.held() == Some(*object)
                    && at(object).is_some_and(|position| position.z > 0.03)
            }
            Self::Place {
                object,
                other,
                relation,
                viewer,
                ..
            } => {
                let both = world
                    .objects()
                    .get(*object)
                    .zip(world.objects().get(*other));
                world.held() != Some(*object)
                    && both.is_some_and(|(object, other)| relation.holds(object, other, *viewer))
            }
            Self::Push {
                object,
                direction,
                from,
                ..
            } => at(object).is_some_and(|position| (position - from).dot(direction) > 0.02),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ToolPose;
    use crate::object::{COLOURS, Shape};

    #[test]
    fn success_depends_on_the_final_world() {
        let cylinder = Shape::Cylinder {
            radius: 0.02,
            height: 0.04,
        };
        let bowl = Shape::Bowl {
            radius: 0.05,
            height: 0.03,
        };
        let succeeded = |relation, offset: [f64; 3], other: Shape| {
            let mut object =
                Object::standing(cylinder, COLOURS[0], 0.25 + offset[0], offset[1], 0.0);
            object.pose.translation.vector.z = offset[2];
            let other = Object::standing(other, COLOURS[1], 0.25, 0.0, 0.0);
            let tool = ToolPose {
                position: Vector3::new(0.3, 0.1, 0.1),
                rpy: Vector3::zeros(),
            };
            let task = Task::Place {
                object: 0,
                other: 1,
                relation,
                viewer: [Vector3::x(), Vector3::y()],
                spot: Vector3::new(0.25, 0.0, 0.0),
            };
            task.succeeded(&World::new(vec![object, other], tool, 1.0))
        };
        assert!(succeeded(Relation::In, [0.01, 0.0, BOWL_FLOOR_M], bowl));
        assert!(!succeeded(Relation::In, [0.07, 0.0, 0.0], bowl));
        assert!(succeeded(Relation::Left, [-0.09, 0.02, 0.0], cylinder));
        assert!(!succeeded(Relation::Left, [0.09, 0.0, 0.0], cylinder));
        assert!(!succeeded(Relation::Left, [-0.09, 0.0, 0.08], cylinder));
        assert!(succeeded(Relation::On, [0.01, 0.0, 0.04], cylinder));
        assert!(!succeeded(Relation::On, [0.01, 0.0, 0.0], cylinder));
        assert!(succeeded(Relation::Behind, [0.0, 0.09, 0.0], cylinder));
        assert!(!succeeded(Relation::Front, [0.0, 0.09, 0.0], cylinder));
    }
}
