//! Objects on the table: shapes, colours and contact geometry.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};

/// Thickness of a bowl's floor, metres.
pub const BOWL_FLOOR_M: f64 = 0.006;

/// Thickness of a mat, metres: below the contact tolerance, so that hands and objects pass over it.
pub const MAT_HEIGHT_M: f64 = 0.002;

/// A shape that stands on the table; all lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A box: half lengths along its own x and y, and its height.
    Box {
        /// Half length along x.
        half_x: f64,
        /// Half length along y.
        half_y: f64,
        height: f64,
    },
    /// An upright cylinder.
    Cylinder { radius: f64, height: f64 },
    /// A ball.
    Ball { radius: f64 },
    /// An upright truncated cone.
    Cone {
        /// Radius at the foot.
        radius: f64,
        height: f64,
    },
    /// A thin round mat: a place for objects, which cannot be pushed or grasped.
    Mat { radius: f64 },
    /// An open bowl, wider than the open fingers.
    Bowl {
        /// Radius of the rim.
        radius: f64,
        height: f64,
    },
}

/// Radius of a cone's tip, as a share of its foot's.
pub(crate) const CONE_TIP: f64 = 0.3;
/// Radius of a bowl's foot, as a share of its rim's.
pub(crate) const BOWL_FOOT: f64 = 0.6;

impl Shape {
    /// Its name in instructions.
    pub fn noun(&self) -> &'static str {
        match self {
            Self::Box { .. } => "box",
            Self::Cylinder { .. } => "cylinder",
            Self::Ball { .. } => "ball",
            Self::Cone { .. } => "cone",
            Self::Bowl { .. } => "bowl",
            Self::Mat { .. } => "mat",
        }
    }

    /// Height, metres.
    pub fn height(&self) -> f64 {
        match *self {
            Self::Box { height, .. }
            | Self::Cylinder { height, .. }
            | Self::Cone { height, .. }
            | Self::Bowl { height, .. } => height,
            Self::Ball { radius } => 2.0 * radius,
            Self::Mat { .. } => MAT_HEIGHT_M,
        }
    }

    /// Radius of the circle around its footprint, metres.
    pub fn bounding_radius(&self) -> f64 {
        match *self {
            Self::Box { half_x, half_y, .. } => half_x.hypot(half_y),
            Self::Cylinder { radius, .. }
            | Self::Ball { radius }
            | Self::Cone { radius, .. }
            | Self::Mat { radius }
            | Self::Bowl { radius, .. } => radius,
        }
    }

    /// Radius of the disc that models it in contacts between objects, metres.
    pub fn contact_radius(&self) -> f64 {
        match *self {
            // Between the inscribed and the circumscribed circle.
            Self::Box { half_x, half_y, .. } => 0.5 * (half_x.max(half_y) + half_x.hypot(half_y)),
            _ => self.bounding_radius(),
        }
    }

    /// Whether another object rests on top of it.
    pub fn carries(&self) -> bool {
        matches!(
            self,
            Self::Box { .. } | Self::Cylinder { .. } | Self::Bowl { .. } | Self::Mat { .. }
        )
    }

    /// Half of its width at `level` metres over its foot, along the direction `along` (a unit vector in
    /// the object's own frame).
    pub fn half_width(&self, level: f64, along: Vector2<f64>) -> f64 {
        match *self {
            Self::Box { half_x, half_y, .. } => half_x * along.x.abs() + half_y * along.y.abs(),
            _ => self.radius_at(level),
        }
    }

    /// Radius of a round shape at `level` metres over its foot; for a box the circumscribed one.
    pub fn radius_at(&self, level: f64) -> f64 {
        let share = (level / self.height()).clamp(0.0, 1.0);
        match *self {
            Self::Box { .. } | Self::Cylinder { .. } | Self::Mat { .. } => self.bounding_radius(),
            Self::Ball { radius } => {
                // At least this, so that fingertips near the foot still touch it.
                let below = (level - radius).clamp(-0.8 * radius, 0.8 * radius);
                (radius * radius - below * below).sqrt()
            }
            Self::Cone { radius, .. } => radius * (1.0 - (1.0 - CONE_TIP) * share),
            Self::Bowl { radius, .. } => radius * (BOWL_FOOT + (1.0 - BOWL_FOOT) * share.sqrt()),
        }
    }

    /// Overlap of the shape at `level` with a disc of radius `reach` at `point` (in the object's frame, horizontal, metres): the
    /// depth, and the direction in which the *object* gives way. `None` without contact.
    ///
    pub fn overlap(
        &self,
        point: Vector2<f64>,
        reach: f64,
        level: f64,
    ) -> Option<(f64, Vector2<f64>)> {
        if let Self::Box { half_x, half_y, .. } = *self {
            let nearest = Vector2::new(
                point.x.clamp(-half_x, half_x),
                point.y.clamp(-half_y, half_y),
            );
            let gap = nearest - point;
            let distance = gap.norm();
            if distance > 1e-9 {
                return (distance < reach).then(|| (reach - distance, gap / distance));
            }
            let (inside_x, inside_y) = (half_x - point.x.abs(), half_y - point.y.abs());
            return Some(if inside_x < inside_y {
                (inside_x + reach, Vector2::new(-point.x.signum(), 0.0))
            } else {
                (inside_y + reach, Vector2::new(0.0, -point.y.signum()))
            });
        }
        let depth = self.radius_at(level) + reach - point.norm();
        (depth > 0.0).then(|| {
            let away = if point.norm() > 1e-9 {
                -point.normalize()
            } else {
                Vector2::x()
            };
            (depth, away)
        })
    }
}

/// A named colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Its name in instructions.
    pub name: &'static str,
    /// sRGB, 0 to 1.
    pub srgb: [f32; 3],
}

/// The colours of objects, different from the two fingers'.
pub const COLOURS: [Colour; 8] = [
    colour("red", [0.88, 0.12, 0.10]),
    colour("blue", [0.10, 0.28, 0.88]),
    colour("green", [0.10, 0.62, 0.20]),
    colour("yellow", [0.96, 0.80, 0.08]),
    colour("purple", [0.50, 0.16, 0.72]),
    colour("orange", [0.97, 0.47, 0.06]),
    colour("white", [0.95, 0.95, 0.95]),
    colour("black", [0.09, 0.09, 0.10]),
];

const fn colour(name: &'static str, srgb: [f32; 3]) -> Colour {
    Colour { name, srgb }
}

/// An object in the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Its shape.
    pub shape: Shape,
    /// Its colour.
    pub colour: Colour,
    /// Its frame in the base frame: the origin in the middle of its foot, z up through it.
    pub pose: Isometry3<f64>,
    /// Downward speed while it falls, m/s.
    pub(crate) fall_speed: f64,
}

impl Object {
    /// An object standing on the table at (`x`, `y`) metres, turned by `yaw` radians.
    pub fn standing(shape: Shape, colour: Colour, x: f64, y: f64, yaw: f64) -> Self {
        Self {
            shape,
            colour,
            pose: Isometry3::from_parts(
                Translation3::new(x, y, 0.0),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
            ),
            fall_speed: 0.0,
        }
    }

    /// Its name in instructions, such as `red box`.
    pub fn name(&self) -> String {
        format!("{} {}", self.colour.name, self.shape.noun())
    }

    /// Middle of the foot, metres.
    pub fn position(&self) -> Vector3<f64> {
        self.pose.translation.vector
    }

    /// Turn about the vertical, radians.
    pub fn yaw(&self) -> f64 {
        let ahead = self.pose.rotation * Vector3::x();
        ahead.y.atan2(ahead.x)
    }

    /// Height of its top, metres, while it stands.
    pub fn top(&self) -> f64 {
        self.position().z + self.shape.height()
    }

    /// Height of its lowest point at any tilt, metres.
    pub fn lowest(&self) -> f64 {
        if let Shape::Ball { radius } = self.shape {
            return (self.pose * nalgebra::Point3::new(0.0, 0.0, radius)).z - radius;
        }
        let r = self.shape.bounding_radius();
        // The lowest edge of a tilted foot: the middle minus the radius times the sine of the tilt.
        let up = self.pose.rotation * Vector3::z();
        self.position().z - r * up.xy().norm()
    }

    /// Converts a horizontal direction or offset to the object's frame.
    pub(crate) fn base_to_own(&self, horizontal: Vector2<f64>) -> Vector2<f64> {
        let (sin, cos) = self.yaw().sin_cos();
        Vector2::new(
            cos * horizontal.x + sin * horizontal.y,
            cos * horizontal.y - sin * horizontal.x,
        )
    }

    /// Converts a horizontal direction from the object's frame.
    pub(crate) fn own_to_base(&self, own: Vector2<f64>) -> Vector2<f64> {
        let (sin, cos) = self.yaw().sin_cos();
        Vector2::new(cos * own.x - sin * own.y, sin * own.x + cos * own.y)
    }
}
