//! The tasks of the operator.

use nalgebra::Vector3;

use crate::world::World;

/// Where to put one object with respect to another, as the camera sees it.
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

impl Relation {
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

/// One thing to do; objects are indices into the world's objects.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Free motion.
    Explore,
    /// Bring the hand over an object.
    Reach {
        /// The object.
        object: usize,
    },
    /// Lift an object.
    PickUp {
        /// The object.
        object: usize,
    },
    /// Put an object somewhere near another.
    Place {
        /// The object to carry.
        object: usize,
        /// The other object.
        other: usize,
        /// Where.
        relation: Relation,
        /// The spot in the base frame that was chosen for it, metres.
        spot: Vector3<f64>,
    },
    /// Push an object over the table.
    Push {
        /// The object.
        object: usize,
        /// Where to, in the viewer's words.
        direction_words: &'static str,
        /// Where to, a horizontal unit vector.
        direction: Vector3<f64>,
        /// To the viewer's right, and away from the viewer: horizontal unit vectors.
        viewer: [Vector3<f64>; 2],
        /// Where it was, metres.
        from: Vector3<f64>,
    },
}

impl Task {
    /// The object that it is about, if there is one.
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

    /// Whether the world is as the task asks.
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
            Self::Place { object, spot, .. } => {
                world.held() != Some(*object)
                    && at(object).is_some_and(|position| {
                        let offset = position - spot;
                        offset.xy().norm() < 0.04 && offset.z.abs() < 0.012
                    })
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
