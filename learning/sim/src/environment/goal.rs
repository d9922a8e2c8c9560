//! Goals, and when they are attained.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use nalgebra::Vector3;

use crate::error::Error;
use crate::teleop::LEVEL_M;
use crate::world::World;

/// Tolerance of the tool's position, metres: half of the largest step along an axis, so that a controller with whole steps
/// can stop within it.
pub const REACH_TOLERANCE_M: f64 = 0.025;
/// Tolerance of an object's foot, metres: about an object's radius, so that the object covers the place. Objects start at
/// least 0.05 m from their places.
pub const PLACE_TOLERANCE_M: f64 = 0.03;

/// The kind of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum GoalKind {
    /// Move the tool over an object, 0.06 m or more away. Only the position counts: turn and opening stay.
    Reach,
    /// Push an object 0.05 to 0.10 m over the table, roughly to the viewer's left or right or forward; rarely away, where the
    /// hand would hide it. The object may also be carried there.
    Push,
    /// Grasp an object, carry it 0.08 m or more to a clear place beside another or on a mat, and release it. The solution lifts
    /// it, but a pushed object counts too if it is not held.
    PickPlace,
}

impl GoalKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Reach, Self::Push, Self::PickPlace];

    /// The name that [`fmt::Display`] writes and [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reach => "reach",
            Self::Push => "push",
            Self::PickPlace => "pick-place",
        }
    }
}

impl fmt::Display for GoalKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FromStr for GoalKind {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == text)
            .ok_or_else(|| Error::GoalKind {
                got: text.to_owned(),
            })
    }
}

/// Target of the tool or an object; positions in the base frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The tool at a position.
    Tool {
        /// The position.
        position: Vector3<f64>,
    },
    /// The foot of an object, by index, at a place on the table.
    Object {
        /// The object.
        object: usize,
        /// The place.
        place: Vector3<f64>,
        /// Whether the hand must pick it up and release it, or push it.
        carried: bool,
    },
}

impl Target {
    /// The object to move; `None` for the tool alone.
    pub fn object(&self) -> Option<usize> {
        match *self {
            Self::Tool { .. } => None,
            Self::Object { object, .. } => Some(object),
        }
    }

    pub(super) fn is_carried(&self) -> bool {
        matches!(self, Self::Object { carried: true, .. })
    }

    /// Distance of the tool, or of the object's foot, from the target in `world`, metres.
    pub fn distance_m(&self, world: &World) -> f64 {
        match *self {
            Self::Tool { position } => (position - world.tool().position).norm(),
            // Without the object, the target is never attained.
            Self::Object { object, place, .. } => world
                .objects()
                .get(object)
                .map_or(f64::INFINITY, |object| (place - object.position()).norm()),
        }
    }

    /// Tolerance of that distance, metres: [`REACH_TOLERANCE_M`] or `PLACE_TOLERANCE_M`.
    pub fn tolerance_m(&self) -> f64 {
        match self {
            Self::Tool { .. } => REACH_TOLERANCE_M,
            Self::Object { .. } => PLACE_TOLERANCE_M,
        }
    }

    /// Whether the target is attained: the distance is below the tolerance, and an object stands on the table or a mat and is
    /// not held if it had to be released.
    pub fn met_by(&self, world: &World) -> bool {
        let stands = |object: usize| {
            let object = world.objects().get(object);
            object.is_some_and(|object| object.lowest() < LEVEL_M)
        };
        let settled = match *self {
            Self::Tool { .. } => true,
            Self::Object {
                object, carried, ..
            } => stands(object) && !(carried && world.held() == Some(object)),
        };
        settled && self.distance_m(world) < self.tolerance_m()
    }
}

/// The goal of an environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// The target.
    pub target: Target,
    /// The task in English.
    pub instruction: String,
    /// The world at the end of the solution, with the hand.
    pub world: World,
    /// The camera's picture of that world, 256 by 256.
    pub picture: RgbImage,
}
