//! What is to come about in an environment, and when it has.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use nalgebra::Vector3;

use crate::error::Error;
use crate::teleop::LEVEL_M;
use crate::world::World;

/// The tool has reached a goal when it is nearer to it than this, metres: half of the largest step along an
/// axis, so that a controller that only takes whole steps can stop within it.
pub const REACH_TOLERANCE_M: f64 = 0.025;
/// An object is at its place when its foot is nearer to it than this, metres: about the radius of an object,
/// so that it covers the place. Objects start at least 0.05 m from their places.
pub const PLACE_TOLERANCE_M: f64 = 0.03;

/// What kind of goal an environment sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum GoalKind {
    /// Bring the tool over an object, 0.06 m or more from where it starts. The hand is turned and opened at
    /// the goal as at the start; only its position counts.
    Reach,
    /// Push an object 0.05 to 0.10 m over the table, along a straight line, about to the viewer's left or
    /// right or forward; seldom away, where the hand would hide it. How it gets there does not count: it may be
    /// carried.
    Push,
    /// Grasp an object, carry it 0.08 m or more to a clear place beside another one or on a mat, and let go
    /// of it. The solution lifts it; an object that was pushed there, and is not held, is there all the same.
    PickPlace,
}

impl GoalKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Reach, Self::Push, Self::PickPlace];

    /// Its name, as [`fmt::Display`] writes it and [`FromStr`] reads it.
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

/// What has to be where; positions in the base frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The tool at a position.
    Tool {
        /// The position.
        position: Vector3<f64>,
    },
    /// An object, by its index, with its foot at a place on the table.
    Object {
        /// The object.
        object: usize,
        /// The place.
        place: Vector3<f64>,
        /// Whether the hand is to pick it up and let go of it there, or only to push it.
        carried: bool,
    },
}

impl Target {
    /// The object that is to move, if it is not the hand alone.
    pub fn object(&self) -> Option<usize> {
        match *self {
            Self::Tool { .. } => None,
            Self::Object { object, .. } => Some(object),
        }
    }

    pub(super) fn is_carried(&self) -> bool {
        matches!(self, Self::Object { carried: true, .. })
    }

    /// What is still missing in `world`, metres: from the tool, or from the object's foot, to where it is to
    /// be.
    pub fn distance_m(&self, world: &World) -> f64 {
        match *self {
            Self::Tool { position } => (position - world.tool().position).norm(),
            // A world without the object never shows it at its place.
            Self::Object { object, place, .. } => world
                .objects()
                .get(object)
                .map_or(f64::INFINITY, |object| (place - object.position()).norm()),
        }
    }

    /// How small that distance has to become, metres: [`REACH_TOLERANCE_M`] or [`PLACE_TOLERANCE_M`].
    pub fn tolerance_m(&self) -> f64 {
        match self {
            Self::Tool { .. } => REACH_TOLERANCE_M,
            Self::Object { .. } => PLACE_TOLERANCE_M,
        }
    }

    /// Whether `world` is as it should be: the distance is below the tolerance, an object stands on the table
    /// or on a mat, and one that was to be let go of is not held.
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

/// The goal of an environment: what has to be where, in words, and as the world is when it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// What has to be where.
    pub target: Target,
    /// The task in English.
    pub instruction: String,
    /// The world at the end of the solution, the hand included.
    pub world: World,
    /// The camera's picture of that world, 256 by 256.
    pub picture: RgbImage,
}
