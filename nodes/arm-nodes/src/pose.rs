//! Poses as messages.

use nalgebra::Isometry3;
use wm_msgs::geometry_msgs::{Point, Pose, Quaternion};

/// A frame in another one, as a message.
pub(crate) fn pose_message(frame: &Isometry3<f64>) -> Pose {
    let (at, turn) = (frame.translation.vector, frame.rotation);
    Pose {
        position: Point {
            x: at.x,
            y: at.y,
            z: at.z,
        },
        orientation: Quaternion {
            x: turn.i,
            y: turn.j,
            z: turn.k,
            w: turn.w,
        },
    }
}
